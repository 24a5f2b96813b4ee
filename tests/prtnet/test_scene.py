"""Skinning, normals and receivers of scenes made by hand."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse
from hypothesis import given
from hypothesis import strategies as st

import prtnet.scene
from prtnet.animation import Channel, Clip, Rig
from prtnet.errors import PrtnetError
from prtnet.scene import PointCacheScene, SkinnedScene, transformed_normals, unit

FLOAT32 = 1e-6
IDENTITY = np.eye(4)[:3]


def scene_of(positions: Any, faces: Any, normals: Any = None, **changes: Any) -> SkinnedScene:
    """A rigid scene on one joint."""
    count = len(positions)
    fields: dict[str, Any] = {
        "name": "made", "path": None, "sha256": "", "clips": (),
        "faces": np.array(faces, np.int32),
        "rig": rig_of(1), "joint_nodes": np.array([0]), "bone_joint": np.array([0]),
        "bone_inverse_bind": IDENTITY[None],
        "weights": scipy.sparse.csr_array(np.ones((count, 1))),
        "positions": np.asarray(positions, np.float32),
        "normals": None if normals is None else np.asarray(normals, np.float32),
        "morph_positions": np.zeros((0, count, 3), np.float32),
        "morph_normals": np.zeros((0, count, 3), np.float32),
    }  # fmt: skip
    return SkinnedScene(**(fields | changes))


def rig_of(nodes: int, **changes: Any) -> Rig:
    fields: dict[str, Any] = {
        "names": tuple(f"n{i}" for i in range(nodes)), "parents": np.full(nodes, -1),
        "translation": np.zeros((nodes, 3)), "rotation": np.tile([0.0, 0, 0, 1], (nodes, 1)),
        "scale": np.ones((nodes, 3)), "offset": np.tile(np.eye(4), (nodes, 1, 1)),
        "weights": np.zeros(0), "weights_of_node": {},
    }  # fmt: skip
    return Rig(**(fields | changes))


def pose_of(*matrices: Any) -> Any:
    return np.concatenate([np.asarray(m, np.float32)[:3, :4].ravel() for m in matrices])[None]


def linear(matrix: Any, offset: Any = (0, 0, 0)) -> Any:
    return np.concatenate([np.asarray(matrix, float), np.reshape(offset, (3, 1))], axis=1)


def random_scene(seed: int) -> tuple[SkinnedScene, Any]:
    rng = np.random.default_rng(seed)
    count, joints, bones, morphs = 7, 3, 4, 2
    scene = scene_of(
        rng.normal(size=(count, 3)),
        rng.integers(0, count, (5, 3)),
        unit(rng.normal(size=(count, 3))),
        rig=rig_of(joints, weights=np.zeros(morphs)),
        joint_nodes=np.arange(joints),
        bone_joint=np.array([2, 0, 1, 0]),
        bone_inverse_bind=rng.normal(size=(bones, 3, 4)),
        weights=scipy.sparse.csr_array(rng.dirichlet(np.ones(bones), count)),
        morph_positions=rng.normal(size=(morphs, count, 3)).astype(np.float32),
        morph_normals=0.1 * rng.normal(size=(morphs, count, 3)).astype(np.float32),
    )
    return scene, rng.normal(size=(3, 12 * joints + morphs)).astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_skinning_is_that_of_a_loop_over_vertices(seed: int) -> None:
    scene, poses = random_scene(seed)
    got = scene.geometry(poses)
    assert scene.normals is not None
    for p, pose in enumerate(poses.astype(float)):
        joints, morph = pose[:36].reshape(3, 3, 4), pose[36:]
        for v in range(scene.vertex_count):
            point = scene.positions[v].astype(float)
            normal = scene.normals[v].astype(float)
            for m, weight in enumerate(morph):
                point = point + weight * scene.morph_positions[m, v]
                normal = normal + weight * scene.morph_normals[m, v]
            matrix = np.zeros((4, 4))
            for b, joint in enumerate(scene.bone_joint):
                inverse = np.vstack([scene.bone_inverse_bind[b], [0, 0, 0, 1]])
                world = np.vstack([joints[joint], [0, 0, 0, 1]])
                matrix += scene.weights[v, b] * world @ inverse
            expected = (matrix @ [*point, 1])[:3]
            np.testing.assert_allclose(got.positions[p, v], expected, rtol=1e-5, atol=1e-5)
            turned = np.linalg.inv(matrix[:3, :3]).T @ normal
            turned /= np.linalg.norm(turned)
            np.testing.assert_allclose(got.normals[p, v], turned, atol=1e-4)


def test_blocks_do_not_change_the_geometry(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, poses = random_scene(1)
    whole = scene.geometry(poses)
    monkeypatch.setattr(prtnet.scene, "BLOCK_VERTICES", 1)
    parts = scene.geometry(poses)
    np.testing.assert_array_equal(whole.positions, parts.positions)
    np.testing.assert_array_equal(whole.normals, parts.normals)
    assert whole.positions.dtype == whole.normals.dtype == np.float32


matrices = st.lists(st.floats(-2, 2), min_size=9, max_size=9).map(
    lambda values: np.array(values).reshape(3, 3)
)


@given(matrices, st.integers(0, 99))
def test_normals_stay_perpendicular_and_outward(matrix: Any, seed: int) -> None:
    if abs(np.linalg.det(matrix)) < 1e-3:
        return
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3))
    inside, normal = -np.cross(a, b), np.cross(a, b)
    turned = transformed_normals(matrix, normal)
    turned /= np.linalg.norm(turned)
    assert abs(turned @ (matrix @ a)) < 1e-9 * max(1, np.linalg.norm(matrix @ a))
    assert abs(turned @ (matrix @ b)) < 1e-9 * max(1, np.linalg.norm(matrix @ b))
    assert turned @ (matrix @ inside) < 0  # what was behind the surface is behind it still


def test_normals_under_flattening_scale() -> None:
    flat = transformed_normals(np.diag([1.0, 1.0, 0.0]), np.array([0.0, 0.6, 0.8]))
    np.testing.assert_allclose(unit(flat), [0, 0, 1])
    nothing = unit(transformed_normals(np.zeros((3, 3)), np.array([0.0, 0.6, 0.8])))
    np.testing.assert_allclose(nothing, [0, 1, 0])


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1.0, 1e160, 1e300])
def test_unit_vectors_of_any_size(size: float) -> None:
    np.testing.assert_allclose(unit(size * np.array([3.0, 0.0, -4.0])), [0.6, 0, -0.8])


def test_unit_of_what_has_no_direction() -> None:
    bad = np.array([[0, 0, 0], [np.nan, 1, 0], [np.inf, 0, 0]], dtype=np.float32)
    got = unit(bad)
    np.testing.assert_array_equal(got, [[0, 1, 0]] * 3)
    assert got.dtype == np.float32


def test_transforms_that_overflow_end_in_an_error() -> None:
    scene = scene_of(np.ones((3, 3)) * 1e30, [[0, 1, 2]], np.ones((3, 3)))
    with pytest.raises(PrtnetError, match="overflow"):
        scene.geometry(pose_of(linear(1e30 * np.eye(3))))


def test_flat_shading_follows_the_pose() -> None:
    scene = scene_of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    quarter = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # about x: y becomes z
    mirror = np.diag([1, 1, -1])
    poses = np.concatenate([pose_of(linear(m)) for m in (np.eye(3), quarter, mirror)])
    normals = scene.geometry(poses).normals[:, 0]
    np.testing.assert_allclose(normals, [[0, 0, 1], [0, -1, 0], [0, 0, -1]], atol=FLOAT32)


# ------------------------------------------------------------------------------------ receivers

QUAD = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
UP = [0, 0, 1]


def test_exact_duplicates_are_one_receiver() -> None:
    positions = [QUAD[0], QUAD[1], QUAD[2], [-0.0, 0.0, 0.0], QUAD[2], QUAD[3]]
    scene = scene_of(positions, [[0, 1, 2], [3, 4, 5]], [UP] * 6)
    receivers = scene.receivers()
    assert receivers.vertex.tolist() == [0, 1, 2, 5]
    assert receivers.of_vertex.tolist() == [0, 1, 2, 0, 2, 3]
    assert receivers.side.tolist() == [1, 1, 1, 1]


def test_hard_edges_are_kept() -> None:
    positions = [QUAD[0], QUAD[1], QUAD[2], QUAD[0], QUAD[2], QUAD[3]]
    scene = scene_of(positions, [[0, 1, 2], [3, 4, 5]], [UP] * 3 + [[0, 1, 0]] * 3)
    assert len(scene.receivers()) == 6
    assert len(replace(scene, normals=None).receivers()) == 6


@pytest.mark.parametrize("what", ["weights", "morph_positions", "morph_normals"])
def test_what_moves_differently_is_not_merged(what: str) -> None:
    weights = np.array([[1.0, 0]] * 6)
    morphs = {key: np.zeros((1, 6, 3), np.float32) for key in ("morph_positions", "morph_normals")}
    if what == "weights":
        weights[3] = 0.5, 0.5
    else:
        morphs[what][0, 3, 1] = 0.5
    scene = scene_of(
        [QUAD[0], QUAD[1], QUAD[2], QUAD[0], QUAD[2], QUAD[3]], [[0, 1, 2], [3, 4, 5]], [UP] * 6,
        weights=scipy.sparse.csr_array(weights), bone_joint=np.array([0, 0]),
        bone_inverse_bind=np.stack([IDENTITY, IDENTITY]), **morphs,
    )  # fmt: skip
    assert scene.receivers().of_vertex.tolist() == [0, 1, 2, 3, 2, 4]


def test_equal_weights_stored_differently_are_equal() -> None:
    # Explicit zeros and the order of entries are no difference.
    data = np.array([0.25, 0.75, 0.75, 0.25, 0.0, 0.25, 0.75])
    columns, starts = np.array([0, 2, 2, 0, 1, 0, 2]), np.array([0, 2, 5, 7])
    weights = scipy.sparse.csr_array((data, columns, starts), shape=(3, 3))
    scene = scene_of([[0, 0, 0]] * 3, [[0, 1, 2]], [UP] * 3, weights=weights)
    assert len(scene.receivers()) == 1
    assert weights.nnz == 7  # and the scene's own weights are left as they were


def test_vertices_of_no_face_have_no_receiver() -> None:
    scene = scene_of([[9, 9, 9], *QUAD], [[1, 2, 3], [1, 3, 4]], [UP] * 5)
    receivers = scene.receivers()
    assert receivers.vertex.tolist() == [1, 2, 3, 4]
    assert receivers.of_vertex.tolist() == [0, 0, 1, 2, 3]


def test_two_sided_receivers_look_both_ways() -> None:
    scene = scene_of(QUAD, [[0, 1, 2], [0, 2, 3]], [UP] * 4)
    receivers = scene.receivers(two_sided=True)
    assert len(receivers) == 8
    assert receivers.vertex.tolist() == [0, 1, 2, 3] * 2
    assert receivers.side.tolist() == [1] * 4 + [-1] * 4
    assert receivers.of_vertex.tolist() == [0, 1, 2, 3]
    gathered = receivers.gather(scene.rest())
    np.testing.assert_array_equal(gathered.normals[0, :, 2], [1] * 4 + [-1] * 4)
    np.testing.assert_array_equal(gathered.positions[0], QUAD * 2)


# --------------------------------------------------------------------------- joints, names, hash


def test_joint_parents_skip_nodes_that_are_no_joints() -> None:
    rig = rig_of(5, parents=np.array([-1, 0, 1, 2, 0]))
    scene = scene_of(QUAD, [[0, 1, 2]], [UP] * 4, rig=rig, joint_nodes=np.array([3, 1, 4]))
    assert scene.joint_parents.tolist() == [1, -1, -1]
    assert scene.joint_names == ("n3", "n1", "n4")


def test_joint_weights_add_up_bones() -> None:
    weights = scipy.sparse.csr_array(np.array([[0.5, 0.25, 0.25]] * 4))
    scene = scene_of(
        QUAD, [[0, 1, 2]], [UP] * 4, weights=weights, rig=rig_of(2), joint_nodes=np.array([0, 1]),
        bone_joint=np.array([1, 0, 1]), bone_inverse_bind=np.stack([IDENTITY] * 3),
    )  # fmt: skip
    np.testing.assert_allclose(scene.joint_weights, [[0.25, 0.75]] * 4)


def test_clips_are_found_by_name() -> None:
    scene = scene_of(QUAD, [[0, 1, 2]], [UP] * 4, clips=(Clip("Walk", 0, 1), Clip("Run", 0, 1)))
    assert scene.clip("Run").name == "Run"
    with pytest.raises(PrtnetError, match="did you mean 'Walk'"):
        scene.clip("walk")


def test_poses_are_joint_matrices_then_morph_weights() -> None:
    rig = rig_of(2, parents=np.array([-1, 0]), translation=np.array([[1.0, 0, 0], [0, 2, 0]]),
                 weights=np.array([0.5]), weights_of_node={0: slice(0, 1)})  # fmt: skip
    morph = np.ones((1, 4, 3), np.float32)
    scene = scene_of(QUAD, [[0, 1, 2]], [UP] * 4, rig=rig, joint_nodes=np.array([1]),
                     morph_positions=morph, morph_normals=0 * morph)  # fmt: skip
    channel = Channel(1, "translation", np.array([0.0, 1]), np.array([[0.0, 2, 0], [0, 4, 0]]))
    pose = scene.poses(Clip("x", 0, 1, (channel,)), np.array([0.5]))
    assert pose.shape == (1, scene.pose_size)
    np.testing.assert_allclose(pose[0], [1, 0, 0, 1, 0, 1, 0, 3, 0, 0, 1, 0, 0.5])
    np.testing.assert_allclose(scene.geometry(pose).positions[0, 0], [1.5, 3.5, 0.5])


def test_the_mesh_hash_tells_meshes_apart() -> None:
    scene, _ = random_scene(0)
    others = [
        replace(scene, positions=scene.positions + np.float32(1e-3)),
        replace(scene, faces=scene.faces[::-1]),
        replace(scene, bone_inverse_bind=scene.bone_inverse_bind + 0.1),
        replace(scene, bone_joint=scene.bone_joint[::-1]),
        replace(scene, weights=scene.weights[::-1]),
        replace(scene, morph_positions=2 * scene.morph_positions),
        replace(scene, normals=None),
    ]
    hashes = {s.mesh_sha256 for s in (scene, *others)}
    assert len(hashes) == 1 + len(others)
    same = replace(scene, name="other", clips=(Clip("x", 0, 1),), weights=scene.weights * 1.0)
    assert same.mesh_sha256 == scene.mesh_sha256


# --------------------------------------------------------------------------------- point caches


def cache(frames: Any, faces: Any, fps: float = 2.0) -> PointCacheScene:
    frames = np.asarray(frames, np.float32)
    clip = Clip("all", 0.0, (len(frames) - 1) / fps)
    return PointCacheScene("c", None, "", np.array(faces, np.int32), (clip,), frames, fps)


RISING = np.add(QUAD, [[[0, 0, 0]], [[0, 0, 1]], [[0, 0, 4]]])


def test_poses_of_two_moments_are_blended_in_a_straight_line() -> None:
    scene = cache(RISING, [[0, 1, 2], [0, 2, 3]])
    clip = scene.clips[0]
    got = scene.blended((clip, clip), (np.zeros(1), np.ones(1)), np.array([0.25]))
    np.testing.assert_allclose(got.reshape(-1, 3), np.add(QUAD, [0, 0, 1.0]))


def test_frames_are_blended_and_held_at_the_ends() -> None:
    scene = cache(RISING, [[0, 1, 2], [0, 2, 3]])
    poses = scene.poses(scene.clips[0], np.array([-1, 0, 0.25, 0.5, 0.75, 1.0, 9.0]))
    np.testing.assert_allclose(poses[:, 2], [0, 0, 0.5, 1, 2.5, 4, 4])
    part = Clip("part", 0.5, 0.75)
    np.testing.assert_allclose(scene.poses(part, np.array([0.0, 1.0]))[:, 2], [1, 2.5])


def test_every_frame_comes_back_exactly() -> None:
    rng = np.random.default_rng(0)
    frames = rng.normal(size=(400, 3, 3)).astype(np.float32)
    scene = cache(frames, [[0, 1, 2]], fps=29.97)
    clip = scene.clips[0]
    np.testing.assert_array_equal(scene.poses(clip, clip.times(count=400)), frames.reshape(400, -1))


def test_normals_of_caches_weigh_faces_by_area() -> None:
    # A roof: vertex 0 touches a face of area ½ facing z and one of area 1 facing x.
    frames = [[[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -2]]]
    scene = cache(frames, [[0, 1, 2], [0, 2, 3]])
    normals = scene.rest().normals[0]
    np.testing.assert_allclose(normals[0], np.array([-2, 0, 1]) / np.sqrt(5), atol=FLOAT32)
    np.testing.assert_allclose(normals[[1, 3]], [[0, 0, 1], [-1, 0, 0]], atol=FLOAT32)


def test_caches_merge_only_vertices_that_move_alike() -> None:
    together = [[*QUAD, QUAD[0]], [*QUAD, QUAD[0]]]
    apart = [[*QUAD, QUAD[0]], [*QUAD, [0, 0, 1]]]
    faces = [[0, 1, 2], [4, 2, 3]]
    assert cache(together, faces).receivers().of_vertex.tolist() == [0, 1, 2, 3, 0]
    assert len(cache(apart, faces).receivers()) == 5


def test_caches_keep_vertices_apart_whose_faces_part_later() -> None:
    """A seam in a sheet that starts flat: the normals beside it differ once the sheet is folded."""
    folded = np.array([*QUAD, QUAD[0], QUAD[2]], dtype=np.float32)
    flat = folded.copy()
    folded[3, 2] = 1
    receivers = cache([flat, folded], [[0, 1, 2], [4, 5, 3]]).receivers()
    assert len(receivers) == 6


def test_another_run_of_a_simulation_is_the_same_mesh() -> None:
    faces = [[0, 1, 2], [0, 2, 3]]
    assert cache(RISING, faces).mesh_sha256 == cache(RISING[1:] * 2, faces).mesh_sha256
    assert cache(RISING, faces).mesh_sha256 != cache(RISING, faces[:1]).mesh_sha256
    assert cache(RISING, faces).mesh_sha256 != cache(RISING[:, [0, 1, 2, 3, 0]], faces).mesh_sha256
