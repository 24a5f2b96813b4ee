"""Damaged, hostile and absurd glTF files: each ends in a usable scene or in one line of error."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_gen.gltf_writer import write_glb
from data_gen.readers import read_scene
from tests.gltf_builder import Builder, pack, unpack
from tests.hard_cases.measured import refuses, says
from tests.small_scene import small_scene

Edit = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("small") / "x.glb"
    write_glb(small_scene(), path)
    return path.read_bytes()


def refused(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with refuses() as caught:
        read_scene(path)
    assert caught.value.subject == str(path)
    return caught.value.message


def attribute(document: dict[str, Any], name: str) -> dict[str, Any]:
    primitive = document["meshes"][0]["primitives"][0]
    accessor: dict[str, Any] = document["accessors"][primitive["attributes"][name]]
    return accessor


EDITS: dict[str, tuple[Edit, str]] = {
    "draco": (
        lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]),
        "KHR_draco_mesh_compression",
    ),
    "meshopt": (
        lambda d: d.update(extensionsRequired=["EXT_meshopt_compression"]),
        "EXT_meshopt_compression",
    ),
    "draco where not required": (
        lambda d: d["meshes"][0]["primitives"][0].update(
            extensions={"KHR_draco_mesh_compression": {}}
        ),
        "compressed",
    ),
    "glTF 1": (lambda d: d["asset"].update(version="1.0"), "glTF 2.0"),
    "no asset": (lambda d: d.pop("asset"), "glTF 2.0"),
    "no meshes": (lambda d: d["nodes"][0].pop("mesh"), "no triangles"),
    "empty scene": (lambda d: d["scenes"][0].update(nodes=[]), "no triangles"),
    "points only": (lambda d: d["meshes"][0]["primitives"][0].update(mode=0), "no triangles"),
    "no buffers": (lambda d: d.update(buffers=[]), "'buffer' is 0"),
    "short buffer": (lambda d: d["buffers"][0].update(byteLength=10**12), "of its 1000000000000"),
    "view outside": (lambda d: d["bufferViews"][0].update(byteOffset=10**9), "reaches byte"),
    "view of no buffer": (lambda d: d["bufferViews"][0].update(buffer=1), "only 1"),
    "many vertices": (lambda d: attribute(d, "POSITION").update(count=10**9), "over 4194304"),
    "many normals": (lambda d: attribute(d, "NORMAL").update(count=10**9), "do not fit"),
    "many zeros": (
        lambda d: [
            attribute(d, "NORMAL").pop("bufferView"),
            attribute(d, "NORMAL").update(count=10**12),
        ],
        "claims 1000000000000 elements",
    ),
    "many sparse": (
        lambda d: attribute(d, "POSITION").update(sparse={"count": 10**12}), "only 9",
    ),
    "no vertices": (lambda d: attribute(d, "POSITION").update(count=0), "one or more"),
    "half a vertex": (lambda d: attribute(d, "POSITION").update(count=7.5), "whole number"),
    "negative": (lambda d: attribute(d, "POSITION").update(count=-8), "whole number"),
    "boolean": (lambda d: attribute(d, "POSITION").update(count=True), "whole number"),
    "vertices of two": (lambda d: attribute(d, "POSITION").update(type="VEC2"), "of type VEC3"),
    "unknown numbers": (lambda d: attribute(d, "POSITION").update(componentType=5130), "5130"),
    "fewer normals": (lambda d: attribute(d, "NORMAL").update(count=7), "has 7 vertices"),
    "fewer weights": (lambda d: attribute(d, "WEIGHTS_0").update(count=7), "differ in length"),
    "float joints": (lambda d: attribute(d, "JOINTS_0").update(componentType=5126), ""),
    "overlapping": (lambda d: d["bufferViews"][0].update(byteStride=4), "an element takes"),
    "fewer joints": (lambda d: d["skins"][0].update(joints=[1]), "a vertex follows number 1"),
    "no joints": (lambda d: d["skins"][0].update(joints=[]), "no joints"),
    "joint outside": (lambda d: d["skins"][0].update(joints=[1, 77]), "is 77"),
    "one bind matrix": (
        lambda d: d["accessors"][d["skins"][0]["inverseBindMatrices"]].update(count=1),
        "2 joints but 1 inverse",
    ),
    "cycle": (lambda d: d["nodes"][2].update(children=[0]), "its own ancestor"),
    "two parents": (lambda d: d["nodes"][0].update(children=[1, 2]), "two parents"),
    "own child": (lambda d: d["nodes"][2].update(children=[2]), ""),
    "twice a child": (lambda d: d["nodes"][0].update(children=[1, 1]), "two parents"),
    "child outside": (lambda d: d["nodes"][2].update(children=[3]), "only 3"),
    "children text": (lambda d: d["nodes"][2].update(children="12"), "must be a list"),
    "nodes object": (lambda d: d.update(nodes={}), "must be a list"),
    "node null": (lambda d: d["nodes"].__setitem__(0, None), "must be a JSON object"),
    "scene outside": (lambda d: d.update(scene=4), "'scene' is 4"),
    "huge translation": (lambda d: d["nodes"][1].update(translation=[1e300, 0, 0]), "finite"),
    "huge integer": (lambda d: d["nodes"][1].update(translation=[10**400, 0, 0]), "finite"),
    "two numbers": (lambda d: d["nodes"][1].update(translation=[1, 0]), "3 numbers"),
    "text for number": (lambda d: d["nodes"][1].update(scale=["1", 1, 1]), "finite numbers"),
    "matrix beside": (lambda d: d["nodes"][1].update(matrix=np.eye(4).ravel().tolist()), "both"),
    "morph weights": (lambda d: d["nodes"][0].update(weights=[1.0]), "must hold 2 numbers"),
    "interpolation": (
        lambda d: d["animations"][0]["samplers"][0].update(interpolation="BEZIER"), "BEZIER",
    ),
    "sampler outside": (
        lambda d: d["animations"][0]["channels"][0].update(sampler=9), "'sampler' is 9",
    ),
    "no target": (lambda d: d["animations"][0]["channels"][0].pop("target"), "'target' is missing"),
    "cubic of linear": (
        lambda d: d["animations"][0]["samplers"][0].update(interpolation="CUBICSPLINE"),
        "for 3 keys",
    ),
    "http": (lambda d: d["buffers"][0].update(uri="http://example.org/a.bin"), "beside this one"),
    "absolute": (lambda d: d["buffers"][0].update(uri="/etc/hostname"), "beside this one"),
    "no such file": (lambda d: d["buffers"][0].update(uri="gone.bin"), ""),
    "bad base64": (lambda d: d["buffers"][0].update(uri="data:;base64,abc"), "base64"),
    "plain data": (lambda d: d["buffers"][0].update(uri="data:,hello"), "base64"),
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_one_line_for_every_mistake(tmp_path: Path, small: bytes, name: str) -> None:
    edit, message = EDITS[name]
    document, data = unpack(small)
    edit(document)
    path = tmp_path / "x.glb"
    path.write_bytes(pack(json.dumps(document).encode(), data))
    with refuses() as caught:
        read_scene(path)
    says(str(caught.value), message)


def test_missing_external_buffers_are_named(tmp_path: Path, small: bytes) -> None:
    document, data = unpack(small)
    document["buffers"][0]["uri"] = "gone.bin"
    (tmp_path / "x.glb").write_bytes(pack(json.dumps(document).encode(), data))
    with refuses(match=r"gone\.bin"):
        read_scene(tmp_path / "x.glb")


def test_every_truncation(tmp_path: Path, small: bytes) -> None:
    for length in range(0, len(small), 13):
        refused(tmp_path / "x.glb", small[:length])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"", "JSON"),
        (b"[]", "not an object"),
        (b"\xff\xfe", "JSON"),
        (b'{"asset":' + b"[" * 100000, "JSON"),
        (b'{"asset": {"version": "2.0"}, "scene": ' + b"9" * 5000 + b"}", "JSON"),
        (b'{"asset": {"version": "2.0"}}', "no triangles"),
        (b"<html>not found</html>", "JSON"),
    ],
    ids=["empty", "list", "no text", "deep", "long number", "bare", "html"],
)
def test_other_documents(tmp_path: Path, text: bytes, message: str) -> None:
    says(refused(tmp_path / "x.gltf", text), message)


def test_other_files(tmp_path: Path) -> None:
    for name in ("x.glb", "x.gltf", "x.npz"):
        with refuses(match=r"cannot be read|does not exist"):
            read_scene(tmp_path / name)
        (tmp_path / name).mkdir()
        with refuses():
            read_scene(tmp_path / name)
    with refuses(match=r"\.glb, \.gltf, \.npz"):
        read_scene(tmp_path / "x.fbx")
    says(refused(tmp_path / "old.glb", b"glTF\x01" + bytes(30)), "version 1")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize(
    "where", ["POSITION", "NORMAL", "WEIGHTS_0", "input", "output", "inverseBindMatrices"]
)
def test_numbers_that_are_not_finite(tmp_path: Path, small: bytes, where: str, bad: float) -> None:
    document, data = unpack(small)
    if where in ("input", "output"):
        index = document["animations"][0]["samplers"][0][where]
    elif where == "inverseBindMatrices":
        index = document["skins"][0][where]
    else:
        index = document["meshes"][0]["primitives"][0]["attributes"][where]
    view = document["bufferViews"][document["accessors"][index]["bufferView"]]
    damaged = bytearray(data)
    damaged[view["byteOffset"] : view["byteOffset"] + 4] = np.float32(bad).tobytes()
    text = json.dumps(document).encode()
    says(refused(tmp_path / "x.glb", pack(text, bytes(damaged))), "not finite")


def test_index_and_key_times_out_of_range(tmp_path: Path) -> None:
    def build(indices: Any, times: Any) -> bytes:
        b = Builder()
        b.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], indices)
        b.json["nodes"] = [{"mesh": 0}]
        b.clip((0, "scale", times, np.ones((len(times), 3)), "LINEAR"))
        return b.glb(tmp_path / "y.glb").read_bytes()

    path = tmp_path / "x.glb"
    says(refused(path, build([0, 1, 3], [0, 1])), "only 3 vertices")
    says(refused(path, build([0, 1], [0, 1])), "whole triangles")
    says(refused(path, build([0, 1, 2], [0, 2, 1])), "backwards")
    says(refused(path, build([0, 1, 2], [0, 1e6])), "beyond")
    path.write_bytes(build([0, 0, 0], [0, 1]))  # no area: rays cope with it
    assert len(read_scene(path).faces) == 1


def test_transforms_that_overflow_together(tmp_path: Path) -> None:
    b = Builder()
    b.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    depth = 12
    b.json["nodes"] = [{"mesh": 0, "scale": [1e38] * 3}]
    b.json["nodes"] += [{"children": [i], "scale": [1e38] * 3} for i in range(depth)]
    b.json["scenes"] = [{"nodes": [depth]}]
    says(refused(tmp_path / "x.glb", b.glb(tmp_path / "y.glb").read_bytes()), "overflow")


def test_many_copies_do_not_exhaust_memory(tmp_path: Path) -> None:
    b = Builder()
    b.mesh(np.zeros((30000, 3)))
    b.json["nodes"] = [{"mesh": 0}] * 1000
    b.json["scenes"] = [{"nodes": list(range(1000))}]
    says(refused(tmp_path / "x.glb", b.glb(tmp_path / "y.glb").read_bytes()), "vertices")


def test_many_morph_targets_do_not_exhaust_memory(tmp_path: Path) -> None:
    b = Builder()
    primitive = b.mesh(np.zeros((30000, 3)))
    primitive["targets"] = [{}] * 3000
    b.json["nodes"] = [{"mesh": 0}]
    says(refused(tmp_path / "x.glb", b.glb(tmp_path / "y.glb").read_bytes()), "morph targets")


def test_a_deep_hierarchy_is_no_recursion(tmp_path: Path) -> None:
    b = Builder()
    b.mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    b.json["nodes"] = [{"children": [i + 1], "translation": [1, 0, 0]} for i in range(3000)]
    b.json["nodes"].append({"mesh": 0})
    scene = read_scene(b.glb(tmp_path / "x.glb"))
    assert scene.rest().positions[0, 0, 0] == 3000.0
