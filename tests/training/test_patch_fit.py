from __future__ import annotations

import math

import numpy as np

from tests.cloth import folding_sheet, sheet_faces, surroundings_of
from tests.data_gen.meshes import cache
from training.patch_fit import spread_seeds
from training.surface_walk import SurfaceWalk, edge_graph


def flat_frames(count):
    return np.tile(np.eye(3), (count, 1, 1))


def grid(width, height, step):
    x, y = np.meshgrid(np.arange(width) * step, np.arange(height) * step)
    return np.stack([x.ravel(), -y.ravel(), np.zeros(x.size)], axis=1)


def test_walks_on_a_flat_sheet_end_at_their_goals():
    points, faces = grid(20, 20, 0.1), sheet_faces(20, 20)
    goals = np.array([0.3 + 0.2j, -0.5 - 0.41j, 0.04 + 0.03j])
    ends = SurfaceWalk(points, edge_graph(points, faces), flat_frames(400))(goals)
    middle = 10 * 20 + 10
    wanted = points[middle, 0] + 1j * points[middle, 1] + goals
    arrived = points[ends[middle], 0] + 1j * points[ends[middle], 1]
    np.testing.assert_allclose(arrived, np.round(wanted / 0.1) * 0.1, atol=1e-9)
    assert ends[0, 0] == 3  # the upper edge stops a walk upwards
    assert ends[0, 1] == 80  # and the left one a walk to the left


def test_walks_on_a_roll_are_those_on_the_sheet_unrolled():
    flat, faces = grid(40, 15, 0.1), sheet_faces(40, 15)
    angle = flat[:, 0] / 0.9  # more than half a turn
    zero, one = np.zeros(len(angle)), np.ones(len(angle))
    rolled = np.stack([0.9 * np.sin(angle), flat[:, 1], 0.9 * np.cos(angle)], axis=1)
    tangent = np.stack([np.cos(angle), zero, -np.sin(angle)], axis=1)
    normal = np.stack([np.sin(angle), zero, np.cos(angle)], axis=1)
    up = np.stack([zero, one, zero], axis=1)
    goals = np.array([1.2 + 0.0j, 0.9 + 0.5j, -0.7 - 0.3j, -1.1j])
    frames = np.stack([tangent, up, normal], axis=-1)
    walks = SurfaceWalk(rolled, edge_graph(rolled, faces), frames)(goals)
    plain = SurfaceWalk(flat, edge_graph(flat, faces), flat_frames(len(flat)))(goals)
    off = np.linalg.norm(flat[walks] - flat[plain], axis=-1)
    assert np.mean(off < 1e-9) > 0.9  # a chord is a little shorter than its arc
    assert off.max() < 0.15
    turned = frames @ np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1.0]])  # other tangents
    again = SurfaceWalk(rolled, edge_graph(rolled, faces), turned)(goals * (0.6 - 0.8j))
    assert np.mean(again == walks) > 0.97


def test_patches_near_a_receiver_and_its_own_cover_the_sheet_once():
    scene = folding_sheet(20, 16)
    seen, _, _ = surroundings_of(scene, levels=(3, 12, 50), refined=1.0)
    assert len(np.unique(seen.patch)) == 65
    for level in range(2):  # nested
        for patch in np.unique(seen.patch[level + 1]):
            assert len(np.unique(seen.patch[level][seen.patch[level + 1] == patch])) == 1
    levels_seen = set()
    for receiver, near in enumerate(seen.near):
        near = near[near >= 0]
        covered = np.isin(seen.patch, near).sum(axis=0)
        own = seen.patch[-1] == seen.patch[-1][seen.vertex[receiver]]
        np.testing.assert_array_equal(covered, (~own).astype(int))
        levels_seen |= {int(np.flatnonzero((seen.patch == p).any(axis=1))[0]) for p in near}
    assert levels_seen == {0, 1, 2}
    assert math.isclose(seen.area.sum(), seen.size**2, rel_tol=1e-5)


def test_near_patches_are_finer_than_far_ones():
    scene = folding_sheet(24, 24)
    seen, _, _ = surroundings_of(scene, levels=(8, 24, 80), refined=0.3)
    rest = scene.frames[0]
    for receiver in (0, 200, 400):
        near = seen.near[receiver][seen.near[receiver] >= 0]
        centre = np.stack([rest[(seen.patch == p).any(axis=0)].mean(axis=0) for p in near])
        distance = np.linalg.norm(centre - rest[seen.vertex[receiver]], axis=1)
        level = np.searchsorted(seen.patch.max(axis=1), near)
        mean = [distance[level == k].mean() for k in np.unique(level)]
        assert len(mean) == 3
        assert mean[0] > mean[1] > mean[2]


def test_seeds_spread_over_every_part():
    faces = np.concatenate([sheet_faces(5, 5), sheet_faces(5, 5) + 25])
    points = np.concatenate([grid(5, 5, 1.0), grid(5, 5, 1.0) + 50.0])
    seeds = spread_seeds(edge_graph(points, faces), np.arange(50), 8)
    assert len(np.unique(seeds)) == 8
    assert (seeds < 25).sum() == 4


def test_parts_that_do_not_hang_together_see_each_other():
    above = folding_sheet(6, 6).frames
    frames = np.concatenate([above, above + np.array([0, 0.3, 0], dtype=np.float32)], axis=1)
    faces = sheet_faces(6, 6)
    scene = cache(frames, np.concatenate([faces, faces + 36]))
    seen, _, _ = surroundings_of(scene)
    assert np.isfinite(seen(frames.reshape(len(frames), -1))).all()
    covered = np.isin(seen.patch, seen.near[0][seen.near[0] >= 0]).any(axis=0)
    assert covered[36:].all()


def test_a_mesh_with_fewer_vertices_than_patches():
    seen, _, _ = surroundings_of(folding_sheet(3, 3), levels=(16, 64, 256))
    assert int(seen.patch.max()) < 3 * 9
    assert np.isfinite(seen(folding_sheet(3, 3).frames.reshape(4, -1))).all()
