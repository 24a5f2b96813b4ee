"""Scenes written as .glb and read back."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse

from data_gen.gltf_writer import write_glb
from data_gen.readers import read_scene
from prtnet.animation import Channel, Clip
from prtnet.errors import PrtnetError
from prtnet.scene import SkinnedScene
from tests.gltf_builder import Reference, unpack
from tests.small_scene import small_scene

FLOAT32 = 1e-6  # keys and matrices are stored as float32


def round_trip(scene: SkinnedScene, path: Path) -> SkinnedScene:
    write_glb(scene, path)
    result = read_scene(path)
    assert isinstance(result, SkinnedScene)
    return result


def assert_same_motion(a: SkinnedScene, b: SkinnedScene) -> None:
    assert [clip.name for clip in a.clips] == [clip.name for clip in b.clips]
    np.testing.assert_array_equal(a.faces, b.faces)
    for one, other in zip(a.clips, b.clips, strict=True):
        times = one.times(count=7)
        left, right = (s.geometry(s.poses(c, times)) for s, c in ((a, one), (b, other)))
        size = np.ptp(left.positions[0], axis=0).max()
        np.testing.assert_allclose(left.positions, right.positions, atol=FLOAT32 * size)
        np.testing.assert_allclose(left.normals, right.normals, atol=2e-5)


@pytest.mark.parametrize("flat", [False, True])
def test_round_trip(tmp_path: Path, flat: bool) -> None:
    scene = small_scene(flat)
    again = round_trip(scene, tmp_path / "x.glb")
    assert_same_motion(scene, again)
    assert (again.normals is None) == flat
    assert again.joint_names == scene.joint_names
    assert again.rig.weights_of_node == {0: slice(0, 2)}
    # A model trained on a scene made by code also fits the file written of it.
    assert again.mesh_sha256 == scene.mesh_sha256
    assert len(again.receivers()) == len(scene.receivers())


@pytest.mark.parametrize("name", ["fox", "arm"])
def test_round_trip_of_sample_files(tmp_path: Path, shared_data: Path, name: str) -> None:
    scene = read_scene(shared_data / f"{name}.glb")
    assert isinstance(scene, SkinnedScene)
    assert_same_motion(scene, round_trip(scene, tmp_path / "x.glb"))


def test_the_slow_reference_reads_the_file_alike(tmp_path: Path) -> None:
    scene = small_scene()
    write_glb(scene, tmp_path / "x.glb")
    geometry = scene.geometry(scene.poses(scene.clips[0], np.array([0.3])))
    corner = scene.faces.ravel()
    expected = Reference(tmp_path / "x.glb").corners(0, 0.3)
    np.testing.assert_allclose(geometry.positions[0, corner], expected[:, :3], atol=1e-5)
    np.testing.assert_allclose(geometry.normals[0, corner], expected[:, 3:], atol=1e-5)


def test_six_weights_two_bind_matrices_and_a_sheared_node(tmp_path: Path) -> None:
    scene = small_scene()
    rng = np.random.default_rng(4)
    inverse = np.tile(np.eye(4)[:3], (6, 1, 1)) + 0.1 * rng.normal(size=(6, 3, 4))
    offset = scene.rig.offset.copy()
    offset[0, 0, 1] = 0.5  # the root's: only its morph weights are animated
    scene = replace(
        scene,
        rig=replace(scene.rig, offset=offset),
        bone_joint=np.array([0, 1, 0, 1, 1, 0]),
        bone_inverse_bind=inverse,
        weights=scipy.sparse.csr_array(rng.dirichlet(np.ones(6), 8)),
    )
    again = round_trip(scene, tmp_path / "x.glb")
    assert_same_motion(scene, again)
    assert again.joint_count == 6  # each further matrix of a joint needs a node


def test_the_file_keeps_the_rules_of_alignment(tmp_path: Path) -> None:
    write_glb(small_scene(), tmp_path / "x.glb")
    data = (tmp_path / "x.glb").read_bytes()
    assert struct.unpack_from("<I", data, 8)[0] == len(data)
    assert len(data) % 4 == 0
    document, binary = unpack(data)
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0
        assert view["byteOffset"] + view["byteLength"] <= len(binary)
    position = document["accessors"][
        document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    ]
    assert (position["min"], position["max"]) == ([0, 0, 0], [2, 2, 2])


def test_what_does_not_fit_one_mesh_is_refused(tmp_path: Path) -> None:
    scene = small_scene()
    two = replace(scene, rig=replace(scene.rig, weights_of_node={0: slice(0, 1), 1: slice(1, 2)}))
    with pytest.raises(PrtnetError, match="several meshes"):
        write_glb(two, tmp_path / "x.glb")
    offset = scene.rig.offset.copy()
    offset[1, 0, 1] = 0.5
    with pytest.raises(PrtnetError, match="'low'"):
        write_glb(replace(scene, rig=replace(scene.rig, offset=offset)), tmp_path / "x.glb")
    assert not list(tmp_path.iterdir())


def test_equal_arrays_are_stored_once(tmp_path: Path) -> None:
    scene = small_scene()
    write_glb(scene, tmp_path / "one.glb")
    channel = scene.clips[0].channels[0]
    more = Channel(2, "rotation", channel.times, channel.values)
    clips = (*scene.clips, Clip("three", 0.0, 1.0, (channel, more)))
    write_glb(replace(scene, clips=clips), tmp_path / "two.glb")
    one, two = (unpack((tmp_path / f"{n}.glb").read_bytes())[1] for n in ("one", "two"))
    assert len(one) == len(two)
