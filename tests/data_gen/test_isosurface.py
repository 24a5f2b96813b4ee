import numpy as np
import pytest

from data_gen.decimation import independent, mesh_edges
from data_gen.isosurface import fill_checkerboards, polygonise
from data_gen.skin_weights import bone_heat, strongest


def sphere(points):
    return np.linalg.norm(points, axis=1) - 0.3


def torus(points):
    """Its ring lies in the plane z = 0; x = 0 cuts it in two circles."""
    ring = np.hypot(points[:, 0], points[:, 1]) - 0.3
    return np.hypot(ring, points[:, 2]) - 0.1


def apart(points):
    """Two balls, mirror images, which the plane x = 0 does not meet."""
    return (
        np.linalg.norm(np.abs(points) * (1, 0, 0) + points * (0, 1, 1) - (0.2, 0, 0), axis=1) - 0.1
    )


@pytest.fixture(params=[(sphere, 2), (torus, 0), (apart, 4)], ids=["sphere", "torus", "apart"])
def solid(request):
    field, euler = request.param
    mesh = polygonise(field, np.array([0, -0.45, -0.35]), np.array([0.45] * 3), 0.03, 0.08)
    return field, euler, *mesh


def test_mesh_is_closed_and_of_the_right_topology(solid):
    _, euler, vertices, faces, _ = solid
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys, back = edges @ (len(vertices), 1), edges @ (1, len(vertices))
    assert len(set(keys)) == len(keys)
    assert set(keys) == set(back)
    assert len(vertices) - len(edges) // 2 + len(faces) == euler


def test_vertices_lie_on_the_surface_and_normals_point_out(solid):
    field, _, vertices, faces, normals = solid
    assert np.abs(field(vertices)).max() < 1e-5
    step = 1e-4
    np.testing.assert_allclose(field(vertices + step * normals) / step, 1, atol=0.02)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.sum(np.cross(b - a, c - a) * normals[faces].mean(axis=1), axis=1).min() > 0


def test_mesh_is_symmetric_and_coarse(solid):
    _, _, vertices, faces, _ = solid
    rows = {tuple(v) for v in np.round(vertices, 6) + 0.0}
    assert rows == {tuple(v) for v in np.round(vertices * (-1, 1, 1), 6) + 0.0}
    edges = vertices[faces] - vertices[np.roll(faces, 1, axis=1)]
    assert np.median(np.linalg.norm(edges, axis=-1)) > 0.045  # the grid's cells are 0.03


def test_no_face_of_the_grid_keeps_diagonal_signs():
    values = fill_checkerboards(np.random.default_rng(0).normal(size=(6, 7, 8)))
    for axis in range(3):
        inside = np.moveaxis(values, axis, 0) < 0
        a, b, c, d = inside[:, :-1, :-1], inside[:, 1:, :-1], inside[:, 1:, 1:], inside[:, :-1, 1:]
        assert not np.any((a == c) & (b == d) & (a != b))


def test_heat_of_two_bones_meets_halfway():
    vertices, faces, _ = polygonise(
        lambda p: np.linalg.norm(p - np.clip(p * (1, 0, 0), -0.4, 0.4), axis=1) - 0.1,
        np.array([0, -0.2, -0.2]), np.array([0.6, 0.2, 0.2]), 0.03, 0.05,
    )  # fmt: skip
    bones = np.array([[[-0.4, 0, 0], [0, 0, 0]], [[0, 0, 0], [0.4, 0, 0]]])
    weights = bone_heat(vertices, faces, bones, np.array([0, 1]), 1.0)
    x = vertices[:, 0]
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-9)
    assert weights.min() > -1e-3
    assert weights[x > 0.35, 1].min() > 0.95
    np.testing.assert_allclose(weights[x == 0], 0.5, atol=1e-6)
    # Along a tube of radius r the heat obeys w'' = (w - source) / r², so w = 1 - exp(-x/r) / 2.
    tube = (x > 0) & (x < 0.3)
    np.testing.assert_allclose(weights[tube, 1], 1 - np.exp(-x[tube] / 0.1) / 2, atol=0.03)


def test_strongest_keeps_four_and_is_continuous():
    weights = np.array([[0.30, 0.25, 0.20, 0.15, 0.10], [0.5, 0.5, 0, 0, 0]])
    kept = strongest(weights).toarray()
    np.testing.assert_allclose(kept[0], np.array([20, 15, 10, 5, 0]) / 50, atol=1e-6)
    np.testing.assert_allclose(kept[1], [0.5, 0.5, 0, 0, 0], atol=1e-6)
    assert np.count_nonzero(strongest(np.full((1, 5), 0.2) + np.eye(5)[:1] * 1e-3).toarray()) == 1


def test_coarsening_as_far_as_it_goes_keeps_the_topology():
    box = np.array([0, -0.45, -0.35]), np.array([0.45] * 3)
    vertices, faces, _ = polygonise(torus, *box, 0.03, 1.0)
    assert len(vertices) < 100
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert set(uses) == {2}
    assert len(vertices) - len(uses) + len(faces) == 0


def test_chosen_edges_touch_no_neighbours_of_each_other():
    _, faces, _ = polygonise(sphere, np.array([0, -0.35, -0.35]), np.array([0.35] * 3), 0.05, 0.06)
    count = faces.max() + 1
    edges, _ = mesh_edges(faces, np.zeros(count, dtype=bool))
    cost = np.random.default_rng(1).random(len(edges))
    chosen = independent(edges, cost, count)
    assert chosen[np.argmin(cost)]
    assert chosen.sum() > 5
    owner = np.full(count, -1)
    owner[edges[chosen]] = np.arange(chosen.sum())[:, None]
    a, b = owner[edges].T
    assert np.all((a == b) | (a < 0) | (b < 0))
