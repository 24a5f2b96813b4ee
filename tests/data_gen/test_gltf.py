"""glTF reading: agreement with a slow reading of the specification, and every known pitfall."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_gen.readers import read_scene, require_clips
from prtnet.errors import PrtnetError
from prtnet.scene import SkinnedScene
from tests.gltf_builder import Builder, Reference

TRIANGLE = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
UP = [[0.0, 0.0, 1.0]]
FLOAT32_POSITION = 2e-6  # of the scene's size: joint matrices of a pose are float32


def read(path: Path) -> SkinnedScene:
    scene = read_scene(path)
    assert isinstance(scene, SkinnedScene)
    return scene


def at(scene: SkinnedScene, time: float, clip: int = 0) -> Any:
    geometry = scene.geometry(scene.poses(scene.clips[clip], np.array([time])))
    return geometry.positions[0], geometry.normals[0]


def skinned(joints: Any = None, weights: Any = None, **skin: Any) -> Builder:
    """A triangle on a skin of two joints: node 1 at rest, node 2 moved by (0, 0, 5)."""
    b = Builder()
    b.mesh(
        TRIANGLE,
        JOINTS_0=b.accessor([[0, 1, 0, 0]] * 3, "u1") if joints is None else joints(b),
        WEIGHTS_0=b.accessor([[0.5, 0.5, 0, 0]] * 3) if weights is None else weights(b),
        NORMAL=b.accessor(UP * 3),
    )
    b.json["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"name": "still"},
        {"name": "moved", "translation": [0, 0, 5]},
    ]
    b.json["scenes"] = [{"nodes": [0, 1, 2]}]
    b.json["skins"] = [{"joints": [1, 2], **skin}]
    return b


def random_character(seed: int) -> Builder:
    """Two skins that share joints with other bind matrices, a rigid mesh, morphs, eight weights,
    joints under a node that is none, a matrix node, and all three interpolations."""
    rng = np.random.default_rng(seed)
    b = Builder()

    def vertices(count: int, sets: int) -> dict[str, Any]:
        weights = rng.dirichlet(np.ones(4 * sets), count).astype("f4")
        normals = rng.normal(size=(count, 3))
        skin = {}
        for n in range(sets):
            skin[f"JOINTS_{n}"] = b.accessor(rng.integers(0, 3, (count, 4)), "u1", stride=8)
            skin[f"WEIGHTS_{n}"] = b.accessor(weights[:, 4 * n : 4 * n + 4])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return {"NORMAL": b.accessor(normals), **skin}

    def matrices() -> int:
        m = np.tile(np.eye(4), (3, 1, 1))
        m[:, :3] += 0.2 * rng.normal(size=(3, 3, 4))
        return b.accessor(m.transpose(0, 2, 1).reshape(3, 16))

    for count, sets, morphs in ((5, 2, 2), (4, 1, 0), (6, 0, 1)):
        primitive = b.mesh(
            rng.normal(size=(count, 3)), rng.integers(0, count, 9), **vertices(count, sets)
        )
        targets = [
            {key: b.accessor(0.3 * rng.normal(size=(count, 3))) for key in ("POSITION", "NORMAL")}
            for _ in range(morphs)
        ]
        if targets:
            primitive["targets"] = targets
    b.json["meshes"][0]["weights"] = [0.25, -0.5]

    def trs() -> dict[str, Any]:
        rotation = rng.normal(size=4)
        return {
            "translation": rng.normal(size=3).tolist(),
            "rotation": (rotation / np.linalg.norm(rotation)).tolist(),
            "scale": rng.uniform(0.5, 1.5, 3).tolist(),
        }

    shear = np.eye(4)
    shear[0, 1], shear[:3, 3] = 0.7, (1, 2, 3)
    b.json["nodes"] = [
        {"name": "armature", "children": [2, 6, 7], **trs()},
        {"mesh": 0, "skin": 0, "children": [], **trs()},
        {"name": "a", "children": [3], **trs()},
        {"name": "between", "children": [4], "matrix": shear.T.ravel().tolist()},
        {"name": "b", "children": [5], **trs()},
        {"name": "c", **trs()},
        {"name": "rigid", "mesh": 2, **trs()},
        {"mesh": 1, "skin": 1},
    ]
    b.json["scenes"] = [{"nodes": [0, 1]}]
    b.json["skins"] = [
        {"joints": [2, 4, 5], "inverseBindMatrices": matrices()},
        {"joints": [5, 2, 4], "inverseBindMatrices": matrices()},
    ]
    keys = np.sort(rng.uniform(0, 2, 4))
    b.clip(
        (0, "rotation", keys, rng.normal(size=(4, 3, 4)), "CUBICSPLINE"),
        (2, "rotation", keys[1:], unit_rows(rng.normal(size=(3, 4))), "LINEAR"),
        (4, "translation", keys, rng.normal(size=(4, 3)), "STEP"),
        (5, "scale", keys, rng.uniform(0.5, 2, (4, 3)), "LINEAR"),
        (6, "translation", keys, rng.normal(size=(4, 3, 3)), "CUBICSPLINE"),
        (1, "weights", keys, rng.normal(size=(4, 2)), "LINEAR"),
        (6, "weights", keys, rng.normal(size=(4, 3, 1)), "CUBICSPLINE"),
    )
    return b


def unit_rows(rows: Any) -> Any:
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def assert_agrees(path: Path, clip: int, time: float) -> None:
    scene = read(path)
    positions, normals = at(scene, time, clip)
    expected = Reference(path).corners(clip, time)
    size = np.ptp(expected[:, :3], axis=0).max()
    mirrored = scene.faces  # corners of turned faces come the other way round
    got = np.concatenate([positions[mirrored], normals[mirrored]], axis=2)
    expected = expected.reshape(-1, 3, 6)
    straight = np.abs(got - expected)[..., :3].max(axis=(1, 2))
    turned = np.abs(got[:, ::-1] - expected)[..., :3].max(axis=(1, 2))
    expected = np.where((turned < straight)[:, None, None], expected[:, ::-1], expected)
    np.testing.assert_allclose(got[..., :3], expected[..., :3], atol=FLOAT32_POSITION * size)
    sign = np.sign(np.sum(got[..., 3:] * expected[..., 3:], axis=-1, keepdims=True))
    assert (sign > 0).all()
    np.testing.assert_allclose(got[..., 3:], expected[..., 3:], atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_random_characters_agree_with_the_slow_reference(tmp_path: Path, seed: int) -> None:
    path = random_character(seed).glb(tmp_path / "x.glb")
    for time in (0.0, 0.7, 1.234, 3.0):
        assert_agrees(path, 0, time)


@pytest.mark.parametrize(("name", "clip", "time"), [("arm", 0, 1.3), ("robot", 6, 0.41)])
def test_sample_files_agree_with_the_slow_reference(
    shared_data: Path, name: str, clip: int, time: float
) -> None:
    assert_agrees(shared_data / f"{name}.glb", clip, time)


def test_human_stands_on_the_floor(shared_data: Path) -> None:
    scene = read(shared_data / "human.glb")
    assert [clip.name for clip in scene.clips] == ["RangeOfMotion", "Walk", "Playground_A"]
    assert scene.joint_count == 31
    assert scene.joint_names[0] == "Hips"
    for positions in (scene.rest().positions[0], at(scene, 0.0)[0]):
        assert np.ptp(positions[:, 1]) == pytest.approx(1.69, abs=0.01)
        assert positions[:, 1].min() == pytest.approx(0.0, abs=0.01)
    walk = scene.clip("Walk")
    lowest = scene.geometry(scene.poses(walk, walk.times(count=12))).positions[..., 1].min(axis=1)
    assert np.abs(lowest).max() < 0.012


def test_fox_has_neither_normals_nor_indices(shared_data: Path) -> None:
    scene = read(shared_data / "fox.glb")
    assert scene.normals is None
    assert len(scene.receivers()) == 3 * len(scene.faces) == scene.vertex_count
    positions, normals = at(scene, 0.3)
    edges = positions[scene.faces[:, 1:]] - positions[scene.faces[:, :1]]
    cosines = np.einsum("tej,tj->te", edges, normals[scene.faces[:, 0]])
    assert np.abs(cosines).max() < 1e-3 * np.abs(edges).max()


# ---------------------------------------------------------------------------------------- skins


def test_missing_inverse_bind_matrices_are_the_identity(tmp_path: Path) -> None:
    rest = read(skinned().glb(tmp_path / "x.glb")).rest()
    np.testing.assert_allclose(rest.positions[0], np.add(TRIANGLE, [0, 0, 2.5]))


@pytest.mark.parametrize(
    ("weights", "height"),
    [
        (lambda b: b.accessor([[51, 204, 0, 0]] * 3, "u1", normalized=True), 4.0),
        (lambda b: b.accessor([[51, 204, 0, 0]] * 3, "u1"), 4.0),
        (lambda b: b.accessor([[13107, 52428, 0, 0]] * 3, "u2", normalized=True), 4.0),
        (lambda b: b.accessor([[0.1, 0.3, 0, 0]] * 3), 3.75),
        (lambda b: b.accessor([[2.0, 6.0, -4.0, 0]] * 3), 3.75),
        (lambda b: b.accessor([[0.0, 0.0, 0, 0]] * 3), 0.0),
        (lambda b: b.accessor([[0.25, 0.25, 0.25, 0.25]] * 3, stride=20), 1.25),
    ],
    ids=["bytes", "bytes not marked", "shorts", "short sum", "negative", "zero", "padded"],
)
def test_weights(tmp_path: Path, weights: Any, height: float) -> None:
    scene = read(skinned(weights=weights).glb(tmp_path / "x.glb"))
    np.testing.assert_allclose(np.asarray(scene.weights.sum(axis=1)), 1.0, atol=1e-6)
    np.testing.assert_allclose(scene.rest().positions[0, :, 2], height, atol=1e-6)


def test_padded_joints_and_the_joints_of_no_weight(tmp_path: Path) -> None:
    b = skinned(
        joints=lambda b: b.accessor([[1, 0, 200, 0]] * 3, "u1", stride=12),
        weights=lambda b: b.accessor([[1.0, 0, 0, 0]] * 3),
    )
    assert read(b.glb(tmp_path / "x.glb")).rest().positions[0, 0, 2] == pytest.approx(5.0)


def test_a_second_set_of_weights_counts(tmp_path: Path) -> None:
    b = skinned(weights=lambda b: b.accessor([[0.5, 0, 0, 0]] * 3))
    attributes = b.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["JOINTS_1"] = b.accessor([[1, 0, 0, 0]] * 3, "u2")
    attributes["WEIGHTS_1"] = b.accessor([[0.5, 0, 0, 0]] * 3)
    rest = read(b.glb(tmp_path / "x.glb")).rest()
    np.testing.assert_allclose(rest.positions[0, :, 2], 2.5)


def test_a_primitive_without_joints_hangs_on_the_node_of_its_skinned_mesh(tmp_path: Path) -> None:
    b = skinned()
    attributes = b.json["meshes"][0]["primitives"][0]["attributes"]
    bare = {key: attributes[key] for key in ("POSITION", "NORMAL")}
    b.json["meshes"][0]["primitives"].append({"attributes": bare})
    rest = read(b.glb(tmp_path / "x.glb")).rest().positions[0]
    np.testing.assert_allclose(rest[3:], np.add(TRIANGLE, 9))
    np.testing.assert_allclose(rest[:3], np.add(TRIANGLE, [0, 0, 2.5]))


def test_the_node_of_a_skinned_mesh_does_not_move_it(tmp_path: Path) -> None:
    b = skinned()
    b.clip((0, "translation", [0, 1], [[0, 0, 0], [7, 7, 7]], "LINEAR"))
    positions, _ = at(read(b.glb(tmp_path / "x.glb")), 1.0)
    np.testing.assert_allclose(positions, np.add(TRIANGLE, [0, 0, 2.5]))


def test_skins_that_share_joint_and_matrix_share_the_bone(tmp_path: Path) -> None:
    b = skinned()
    b.json["skins"].append({"joints": [2, 1]})
    b.json["nodes"].append({"mesh": 0, "skin": 1})
    b.json["scenes"][0]["nodes"].append(3)
    scene = read(b.glb(tmp_path / "x.glb"))
    assert scene.joint_names == ("still", "moved")
    assert len(scene.bone_joint) == 2
    assert len(scene.receivers()) == 3  # both meshes move alike
    assert scene.vertex_count == 6


# ------------------------------------------------------------------------------ nodes and scenes


def rigid(**node: Any) -> Builder:
    b = Builder()
    b.mesh(TRIANGLE, NORMAL=b.accessor(UP * 3))
    b.json["nodes"] = [{"mesh": 0, **node}]
    return b


def test_a_mesh_without_skin_hangs_on_its_node_and_can_be_there_twice(tmp_path: Path) -> None:
    b = rigid()
    b.json["nodes"].append({"mesh": 0, "translation": [0, 0, 3], "name": "copy"})
    b.json["scenes"][0]["nodes"] = [0, 1]
    b.clip((1, "translation", [0, 2], [[0, 0, 3], [0, 0, 5]], "LINEAR"))
    scene = read(b.glb(tmp_path / "x.glb"))
    assert scene.joint_names == ("node_0", "copy")
    np.testing.assert_allclose(at(scene, 1.0)[0][:, 2], [0, 0, 0, 4, 4, 4])


def test_only_the_default_scene_counts(tmp_path: Path) -> None:
    b = rigid()
    b.json["nodes"].append({"mesh": 0})
    b.json["scenes"] = [{"nodes": [0]}, {"nodes": [0, 1]}]
    assert len(read(b.glb(tmp_path / "x.glb")).faces) == 1
    b.json["scene"] = 1
    assert len(read(b.glb(tmp_path / "x.glb")).faces) == 2
    del b.json["scene"], b.json["scenes"]
    assert len(read(b.glb(tmp_path / "x.glb")).faces) == 2


def test_children_may_come_before_their_parents(tmp_path: Path) -> None:
    b = rigid(translation=[1, 0, 0])
    b.json["nodes"].append({"translation": [0, 10, 0], "children": [0]})
    b.json["scenes"][0]["nodes"] = [1]
    np.testing.assert_allclose(read(b.glb(tmp_path / "x.glb")).rest().positions[0, 0], [1, 10, 0])


def test_a_node_given_as_a_matrix_keeps_its_shear(tmp_path: Path) -> None:
    matrix = np.eye(4)
    matrix[0, 1], matrix[1, 3] = 2.0, 7.0
    rest = read(rigid(matrix=matrix.T.ravel().tolist()).glb(tmp_path / "x.glb")).rest()
    np.testing.assert_allclose(rest.positions[0, 2], [2, 8, 0])


@pytest.mark.parametrize("with_normals", [True, False])
def test_mirrored_faces_stay_outward(tmp_path: Path, with_normals: bool) -> None:
    b = rigid(scale=[1, 1, -1])
    if not with_normals:
        del b.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    scene = read(b.glb(tmp_path / "x.glb"))
    rest = scene.rest()
    p = rest.positions[0, scene.faces[0]]
    np.testing.assert_allclose(rest.normals[0], [[0, 0, -1]] * 3)
    np.testing.assert_allclose(np.cross(p[1] - p[0], p[2] - p[0]), [0, 0, -1])


def test_flat_faces_that_a_clip_mirrors_stay_outward(tmp_path: Path) -> None:
    b = rigid()
    del b.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]
    b.clip((0, "scale", [0, 1], [[1, 1, 1], [1, 1, -1]], "STEP"))
    scene = read(b.glb(tmp_path / "x.glb"))
    np.testing.assert_allclose(at(scene, 0.0)[1], [[0, 0, 1]] * 3)
    np.testing.assert_allclose(at(scene, 1.0)[1], [[0, 0, -1]] * 3)


def test_names_are_made_and_made_unique(tmp_path: Path) -> None:
    b = rigid(name="x")
    b.json["nodes"].append({"name": "x"})
    for extra in ({"name": "go"}, {"name": "go"}, {}, {"name": "go_2"}, {"name": "a\ud800"}):
        b.clip((0, "scale", [0], [[1, 1, 1]], "LINEAR"), **extra)
    scene = read(b.glb(tmp_path / "x.glb"))
    names = [clip.name for clip in scene.clips]
    assert names == ["go", "go_2", "animation_2", "go_2_2", "a?"]
    assert scene.rig.names == ("x", "x_2")


# ------------------------------------------------------------------------------------- geometry


def test_faces_without_normals_are_flat_beside_others_that_have_them(tmp_path: Path) -> None:
    b = rigid()
    corner = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    b.mesh(corner, [0, 1, 2, 0, 2, 3])
    b.json["meshes"][0]["primitives"] += b.json["meshes"][1]["primitives"]
    scene = read(b.glb(tmp_path / "x.glb"))
    assert scene.normals is not None
    assert scene.vertex_count == 3 + 6
    np.testing.assert_allclose(scene.normals[3:], [[0, 0, 1]] * 3 + [[1, 0, 0]] * 3)


@pytest.mark.parametrize(
    ("mode", "indices", "faces"),
    [
        (4, None, [[0, 1, 2], [3, 4, 5]]),
        (4, [0, 1, 2, 0, 2, 5], [[0, 1, 2], [0, 2, 5]]),
        (5, [0, 1, 2, 3, 4], [[0, 1, 2], [1, 3, 2], [2, 3, 4]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
        (6, None, [[1, 2, 0], [2, 3, 0], [3, 4, 0], [4, 5, 0]]),
    ],
)
def test_lists_strips_and_fans(tmp_path: Path, mode: int, indices: Any, faces: Any) -> None:
    b = Builder()
    primitive = b.mesh(np.arange(18).reshape(6, 3) ** 2, indices, NORMAL=b.accessor(UP * 6))
    primitive["mode"] = mode
    b.json["nodes"] = [{"mesh": 0}]
    assert read(b.glb(tmp_path / "x.glb")).faces.tolist() == faces


def test_points_and_lines_are_left_out(tmp_path: Path) -> None:
    b = rigid()
    b.json["meshes"][0]["primitives"].append({**b.json["meshes"][0]["primitives"][0], "mode": 1})
    assert read(b.glb(tmp_path / "x.glb")).vertex_count == 3


def test_quantised_vertices(tmp_path: Path) -> None:
    b = rigid(scale=[0.5, 0.5, 0.5])
    b.json["extensionsRequired"] = b.json["extensionsUsed"] = ["KHR_mesh_quantization"]
    attributes = b.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["POSITION"] = b.accessor([[0, 0, 0], [-8, 0, 0], [0, 6, 0]], "i2", stride=8)
    attributes["NORMAL"] = b.accessor([[0, 0, 127], [127, 0, 0], [0, -128, 0]], "i1", stride=4,
                                      normalized=True)  # fmt: skip
    scene = read(b.glb(tmp_path / "x.glb"))
    np.testing.assert_allclose(scene.rest().positions[0], [[0, 0, 0], [-4, 0, 0], [0, 3, 0]])
    assert scene.normals is not None
    np.testing.assert_allclose(scene.normals, [[0, 0, 1], [1, 0, 0], [0, -1, 0]])
    attributes["POSITION"] = b.accessor([[0, 0, 0], [-128, 0, 0], [0, 127, 0]], "i1", stride=4,
                                        normalized=True)  # fmt: skip
    rest = read(b.glb(tmp_path / "x.glb")).rest().positions[0]
    np.testing.assert_allclose(rest, [[0, 0, 0], [-0.5, 0, 0], [0, 0.5, 0]])


def test_normals_are_made_unit(tmp_path: Path) -> None:
    b = rigid()
    attributes = b.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["NORMAL"] = b.accessor([[0, 0, 3], [0, 0.1, 0], [0, 0, 0]])
    scene = read(b.glb(tmp_path / "x.glb"))
    assert scene.normals is not None
    np.testing.assert_allclose(scene.normals, [[0, 0, 1], [0, 1, 0], [0, 1, 0]])


def sparse(b: Builder, slots: list[int], values: Any) -> dict[str, Any]:
    return {
        "count": len(slots),
        "indices": {"bufferView": b.view(np.array(slots, "<u2").tobytes()), "componentType": 5123},
        "values": {"bufferView": b.view(np.array(values, "<f4").tobytes())},
    }


def test_sparse_accessors(tmp_path: Path) -> None:
    b = rigid()
    primitive = b.json["meshes"][0]["primitives"][0]
    accessor = b.json["accessors"][primitive["attributes"]["POSITION"]]
    accessor["sparse"] = sparse(b, [2], [[5, 6, 7]])
    b.json["accessors"].append(
        {"componentType": 5126, "count": 3, "type": "VEC3",
         "sparse": sparse(b, [0, 1], [[1, 0, 0], [0, 1, 0]])}
    )  # fmt: skip
    primitive["targets"] = [{"POSITION": len(b.json["accessors"]) - 1}]
    b.json["nodes"][0]["weights"] = [2.0]
    rest = read(b.glb(tmp_path / "x.glb")).rest().positions[0]
    np.testing.assert_allclose(rest, [[2, 0, 0], [1, 2, 0], [5, 6, 7]])
    accessor["sparse"] = sparse(b, [3], [[5, 6, 7]])
    with pytest.raises(PrtnetError, match="index 3 but there are only 3"):
        read(b.glb(tmp_path / "x.glb"))


def test_buffers_inside_and_beside_the_file(tmp_path: Path) -> None:
    whole = read(rigid().glb(tmp_path / "x.glb"))
    assert whole.sha256 == hashlib.sha256((tmp_path / "x.glb").read_bytes()).hexdigest()
    inside = read(rigid().gltf(tmp_path / "inside.gltf"))
    beside = read(rigid().gltf(tmp_path / "beside.gltf", "the data.bin"))
    for scene in (inside, beside):
        assert scene.mesh_sha256 == whole.mesh_sha256
    b = rigid()
    b.data[-1] ^= 1  # only the file beside differs, but it is part of the scene
    assert read(b.gltf(tmp_path / "beside.gltf", "the data.bin")).sha256 != beside.sha256


# ------------------------------------------------------------------------- morphs and animations


def test_default_morph_weights_of_node_before_mesh(tmp_path: Path) -> None:
    b = rigid()
    b.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": b.accessor([[0, 0, 1]] * 3)}]
    assert read(b.glb(tmp_path / "x.glb")).rest().positions[0, 0, 2] == 0.0
    b.json["meshes"][0]["weights"] = [0.25]
    assert read(b.glb(tmp_path / "x.glb")).rest().positions[0, 0, 2] == 0.25
    b.json["nodes"][0]["weights"] = [0.75]
    scene = read(b.glb(tmp_path / "x.glb"))
    assert scene.rest().positions[0, 0, 2] == 0.75
    assert scene.pose_size == 12 + 1


def test_morph_weights_belong_to_the_node_not_the_mesh(tmp_path: Path) -> None:
    b = rigid()
    b.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": b.accessor([[0, 0, 1]] * 3)}]
    b.json["nodes"].append({"mesh": 0})
    b.json["scenes"][0]["nodes"] = [0, 1]
    b.clip((1, "weights", [0, 1], [0, 4], "LINEAR"))
    scene = read(b.glb(tmp_path / "x.glb"))
    assert scene.morph_count == 2
    np.testing.assert_allclose(at(scene, 0.5)[0][:, 2], [0, 0, 0, 2, 2, 2])


def test_normalised_integers_in_animations(tmp_path: Path) -> None:
    b = rigid()
    quarter = round(32767 * np.sqrt(0.5))
    half_turn = b.accessor([[0, 0, 0, 32767], [0, 0, quarter, quarter]], "i2", normalized=True)
    b.clip((0, "rotation", [0, 1], half_turn, "LINEAR"))
    positions, _ = at(read(b.glb(tmp_path / "x.glb")), 1.0)
    np.testing.assert_allclose(positions[1], [0, 1, 0], atol=1e-4)


def test_keys_at_equal_times_are_a_jump(tmp_path: Path) -> None:
    b = rigid()
    values = [[0, 0, 0], [1, 0, 0], [5, 0, 0], [6, 0, 0], [9, 0, 0]]
    b.clip((0, "translation", [0, 1, 1, 2, 2], values, "LINEAR"))
    scene = read(b.glb(tmp_path / "x.glb"))
    found = [at(scene, time)[0][0, 0] for time in (0.5, 0.999, 1.0, 1.5, 2.0, 3.0)]
    np.testing.assert_allclose(found, [0.5, 0.999, 5, 5.5, 9, 9], atol=1e-5)


def test_clips_of_no_length_and_of_nothing(tmp_path: Path) -> None:
    b = rigid()
    b.clip((0, "translation", [0.5], [[0, 0, 2]], "LINEAR"), name="pose")
    b.clip((0, "pointer", [0.5], [[0, 0, 2]], "LINEAR"), name="extension")
    b.clip((0, "weights", [0.5], [1.0], "LINEAR"), name="no targets")
    scene = read(b.glb(tmp_path / "x.glb"))
    assert [(clip.name, clip.start, clip.end) for clip in scene.clips] == [("pose", 0.5, 0.5)]
    assert len(scene.clips[0].times(fps=30)) == 1
    np.testing.assert_allclose(at(scene, 0.0)[0][:, 2], 2.0)


def test_scenes_without_clips_are_read_but_do_not_generate(tmp_path: Path) -> None:
    scene = read(rigid().glb(tmp_path / "x.glb"))
    assert scene.clips == ()
    with pytest.raises(PrtnetError, match="has no animation"):
        require_clips(scene)
