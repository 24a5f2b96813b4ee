from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from data_gen.procedural import arm
from prtnet.frames import FrameField, orthonormal_frames, rest_tangents
from prtnet.scene import PointCacheScene, Scene, SkinnedScene
from prtnet.tangents import seamed, smoothed, surface_graph
from tests.data_gen.meshes import cache

numbers = st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, 1.0, 1e-30, 1e30]))


def sheet(frames: int = 4, size: int = 12) -> PointCacheScene:
    """A square sheet that rolls up."""
    x, y = np.meshgrid(np.linspace(0, 1, size), np.linspace(0, 1, size), indexing="ij")
    x, y = x.ravel(), y.ravel()
    motion = []
    for bend in np.linspace(0.01, 2.0, frames):
        motion.append(np.stack([np.sin(bend * x) / bend, (1 - np.cos(bend * x)) / bend, y], 1))
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + size + 1, corner + size], axis=1)
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return cache(np.stack(motion), faces)


@pytest.fixture(scope="module", params=["skinned", "cache"])
def scene(request: pytest.FixtureRequest) -> Scene:
    return arm() if request.param == "skinned" else sheet()


def field_of(scene: Scene, two_sided: bool = False) -> FrameField:
    receivers = scene.receivers(two_sided)
    return FrameField(scene, receivers, rest_tangents(scene, receivers))


def poses_of(scene: Scene, count: int = 3) -> np.ndarray:
    return scene.poses(scene.clips[0], scene.clips[0].times(count=count))


def turned(scene: Scene, poses: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """The same poses, all of the scene turned about the origin."""
    if isinstance(scene, SkinnedScene):
        return (turn @ scene.joint_matrices(poses)).reshape(len(poses), -1).astype(np.float32)
    return (poses.reshape(len(poses), -1, 3) @ turn.T).reshape(len(poses), -1).astype(np.float32)


@given(arrays(np.float64, (4, 3), elements=numbers), arrays(np.float64, (4, 3), elements=numbers))
@settings(max_examples=200)
def test_any_input_gives_right_handed_orthonormal_frames(tangents, normals) -> None:
    frames = orthonormal_frames(tangents, normals)
    products = frames.swapaxes(1, 2) @ frames
    np.testing.assert_allclose(products, np.tile(np.eye(3), (4, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)


@given(arrays(np.float64, 3, elements=st.floats(-1, 1)), st.integers(0, 1000))
@settings(max_examples=50)
def test_tangents_along_the_normal_are_no_trouble(noise, seed) -> None:
    normal = Rotation.random(rng=seed).as_matrix()[0]
    for tangent in (normal, -3 * normal, normal + 1e-9 * noise, np.zeros(3)):
        frame = orthonormal_frames(tangent, normal)
        np.testing.assert_allclose(frame.T @ frame, np.eye(3), atol=1e-9)
        np.testing.assert_allclose(frame[:, 2], normal, atol=1e-12)


def test_gram_schmidt_keeps_the_normal_and_the_side_of_the_tangent() -> None:
    frame = orthonormal_frames(np.array([2.0, 0.0, 5.0]), np.array([0.0, 0.0, 3.0]))
    np.testing.assert_allclose(frame, np.eye(3))


def test_rest_tangents_are_unit_and_tangential(scene: Scene) -> None:
    receivers = scene.receivers()
    tangents = rest_tangents(scene, receivers)
    assert tangents.dtype == np.float32
    normals = receivers.gather(scene.rest()).normals[0]
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(np.sum(tangents * normals, axis=1), 0.0, atol=1e-6)


def test_frames_at_rest_have_the_rest_tangents(scene: Scene) -> None:
    receivers = scene.receivers()
    tangents = rest_tangents(scene, receivers)
    rest = scene.rest_pose() if isinstance(scene, SkinnedScene) else scene.frames[:1].reshape(1, -1)
    frames = FrameField(scene, receivers, tangents).frames(rest)[0]
    np.testing.assert_allclose(frames[..., 0], tangents, atol=1e-4)


def test_frames_are_orthonormal_and_keep_the_posed_normals(scene: Scene) -> None:
    field, poses = field_of(scene), poses_of(scene)
    surface = field.receivers.gather(scene.geometry(poses))
    frames = field.frames(poses, surface)
    assert frames.dtype == np.float32
    np.testing.assert_allclose(
        frames.swapaxes(-1, -2) @ frames, np.broadcast_to(np.eye(3), frames.shape), atol=1e-6
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-5)
    np.testing.assert_allclose(frames[..., 2], surface.normals, atol=1e-6)
    np.testing.assert_array_equal(frames, field.frames(poses))


def test_frames_turn_with_the_scene(scene: Scene) -> None:
    field, poses = field_of(scene), poses_of(scene)
    turn = Rotation.random(rng=5).as_matrix()
    np.testing.assert_allclose(
        field.frames(turned(scene, poses, turn)), turn @ field.frames(poses), atol=2e-4
    )


def test_backs_have_the_same_tangent_and_the_opposite_normal(scene: Scene) -> None:
    frames = field_of(scene, two_sided=True).frames(poses_of(scene))
    front, back = np.split(frames, 2, axis=1)
    np.testing.assert_allclose(back[..., 0], front[..., 0], atol=1e-6)
    np.testing.assert_allclose(back[..., 1:], -front[..., 1:], atol=1e-6)


def test_a_stretch_carries_tangents_as_it_carries_the_surface() -> None:
    """An affine motion of a plane: the carried tangent is the matrix times the tangent."""
    flat = sheet(frames=1)
    stretch = np.array([[2.0, 0.4, 0.3], [0.0, 1.0, 0.0], [0.5, 0.2, 0.7]])
    start = flat.frames[0] * [1, 0, 1]
    scene = cache(np.stack([start, start @ stretch.T]), flat.faces)
    receivers = scene.receivers()
    tangents = rest_tangents(scene, receivers)
    frames = FrameField(scene, receivers, tangents).frames(scene.frames[1:].reshape(1, -1))[0]
    expected = tangents @ stretch.T
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(frames[..., 0], expected, atol=1e-5)


def test_bind_tangents_are_what_an_engine_would_skin() -> None:
    scene = arm(segments=12)
    field, poses = field_of(scene), poses_of(scene)
    assert field.bind_tangents is not None
    linear = scene.vertex_matrices(poses)[:, field.receivers.vertex, :, :3]
    skinned = np.einsum("pvij,vj->pvi", linear, field.bind_tangents)
    normals = field.receivers.gather(scene.geometry(poses)).normals
    frames = orthonormal_frames(skinned, normals)
    np.testing.assert_allclose(field.frames(poses), frames, atol=1e-6)


def test_frames_are_smooth_over_the_surface(scene: Scene) -> None:
    """Neighbours rarely differ, but for the singular points a closed surface must have."""
    field, poses = field_of(scene), poses_of(scene)
    frames = field.frames(poses)
    corners = field.receivers.of_vertex[scene.faces]
    alike = np.sum(frames[:, corners[:, 0], :, 0] * frames[:, corners[:, 1], :, 0], axis=-1)
    assert np.mean(alike < np.cos(np.radians(30))) < 0.03


def strip() -> tuple[scipy.sparse.csr_array, np.ndarray, np.ndarray]:
    """Neighbours, clusters and normals of a flat sheet cut in two along x, the first larger."""
    scene = sheet(frames=1, size=16)
    receivers = scene.receivers()
    points = scene.frames[0] * np.array([1, 0, 1])
    normals = np.tile([0.0, 1.0, 0.0], (len(points), 1))
    graph = surface_graph(scene.faces, receivers, points, normals)
    return graph, (points[:, 0] > 0.6).astype(int), normals


def test_clusters_agree_on_the_sign_of_their_axes() -> None:
    graph, labels, normals = strip()
    axes = np.stack([np.eye(3), -np.eye(3)])
    tangents = seamed(graph, labels, axes, normals)
    np.testing.assert_allclose(np.abs(np.mean(tangents, axis=0)).max(), 1.0)


def test_clusters_take_axes_in_the_surface_and_along_their_neighbours() -> None:
    """The first has one axis in the plane; of the other's two, the better one is taken."""
    graph, labels, normals = strip()
    first = Rotation.from_rotvec([0, 0, 0.7]).as_matrix().T  # z stays in the plane
    second = Rotation.from_rotvec([0, 0.2, 0]).as_matrix().T
    tangents = seamed(graph, labels, np.stack([first, second]), normals)
    np.testing.assert_allclose(np.abs(tangents[labels == 0] @ [0, 0, 1]), 1.0)
    np.testing.assert_allclose(np.abs(tangents @ [0, 0, 1]) > 0.97, True)


def test_smoothing_spreads_a_seam() -> None:
    graph, labels, normals = strip()
    turn = np.radians(60.0) * labels
    before = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    i, j = graph.tocoo().coords

    def worst(t: np.ndarray) -> float:
        return float(np.degrees(np.arccos(np.sum(t[i] * t[j], axis=1).clip(-1, 1))).max())

    assert worst(before) == pytest.approx(60.0)
    assert worst(smoothed(graph, before, normals)) < 10.0


def test_frames_do_not_depend_on_the_bind_space() -> None:
    """The same character modelled lying on its side and bound from there."""
    scene = arm(segments=12)
    turn = Rotation.random(rng=3).as_matrix()
    bind = scene.bone_inverse_bind.astype(np.float64).copy()
    bind[..., :3] = bind[..., :3] @ turn
    side = dataclasses.replace(
        scene,
        bone_inverse_bind=bind,
        positions=scene.positions @ turn,
        normals=scene.normals @ turn,
    )
    tangents = rest_tangents(scene, scene.receivers())
    frames = [FrameField(s, s.receivers(), tangents).frames(poses_of(scene)) for s in (scene, side)]
    np.testing.assert_allclose(frames[1], frames[0], atol=1e-4)


def test_graph_links_neighbours_and_twins_across_soft_edges() -> None:
    """Two triangles with a split edge, folded by 60° and by 120°."""
    for fold, linked in ((60.0, True), (120.0, False)):
        c, s = np.cos(np.radians(fold)), np.sin(np.radians(fold))
        a = np.array([[0, 0, 0], [0, 0, 1], [-1, 0, 0]], dtype=float)
        b = np.array([[0, 0, 1], [0, 0, 0], [c, s, 0]])
        normals = np.repeat([[0, 1.0, 0], [-s, c, 0]], 3, axis=0)
        scene = cache(np.concatenate([a, b])[None], np.arange(6).reshape(2, 3))
        receivers = scene.receivers()
        graph = surface_graph(scene.faces, receivers, np.concatenate([a, b]), normals).toarray()
        assert graph[0, 1] > 0
        assert (graph[0, 4] > 0) == linked
        np.testing.assert_allclose(graph.sum(axis=1), 1.0)


def test_scenes_with_still_and_useless_geometry() -> None:
    """Degenerate faces, a zero normal, clusters of one vertex: finite frames."""
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 0], [0, 0, 0], [0, 1, 0]], float)
    scene = cache(np.tile(points, (3, 1, 1)), np.array([[0, 1, 2], [3, 4, 5]]))
    frames = field_of(scene).frames(poses_of(scene))
    assert np.isfinite(frames).all()
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-5)
