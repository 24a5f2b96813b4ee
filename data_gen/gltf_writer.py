"""Skinned scenes as glTF 2.0 binary files [1]: one mesh, one skin, all clips.

[1] glTF 2.0 specification, Khronos Group.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.gltf_document import BINARY_CHUNK, JSON_CHUNK, MAGIC
from prtnet.animation import Clip, Rig
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.files import writing
from prtnet.scene import SkinnedScene, influences

__all__ = ["write_glb"]

FLOAT, UNSIGNED_SHORT, UNSIGNED_INT = 5126, 5123, 5125
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
VERTICES, INDICES = 34962, 34963  # what a buffer view is for
CHANNEL_SIZES = {"translation": 3, "rotation": 4, "scale": 3, "weights": 1}


class Writer:
    """A glTF document in the making: accessors are appended to one buffer."""

    def __init__(self) -> None:
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []
        self.data = bytearray()
        self._known: dict[tuple[bytes, int, int | None], int] = {}

    def accessor(
        self, values: FloatArray | IntArray, size: int, code: int = FLOAT, target: int | None = None
    ) -> int:
        """Append elements of ``size`` components; equal arrays are stored once."""
        dtype = {FLOAT: "<f4", UNSIGNED_SHORT: "<u2", UNSIGNED_INT: "<u4"}[code]
        rows = np.ascontiguousarray(values, dtype=dtype).reshape(-1, size)
        data = rows.tobytes()
        key = (data, size, target)
        if key not in self._known:
            view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data)}
            view["byteLength"] = len(data)
            if target is not None:
                view["target"] = target
            self._known[key] = len(self.accessors)
            self.accessors.append(
                {
                    "bufferView": len(self.views),
                    "componentType": code,
                    "count": len(rows),
                    "type": KINDS[size],
                    "min": rows.min(axis=0).tolist(),
                    "max": rows.max(axis=0).tolist(),
                }
            )
            self.views.append(view)
            self.data += data  # elements of 4, 8, … bytes: the next one is aligned
        return self._known[key]

    def file(self, document: dict[str, Any]) -> bytes:
        """The whole ``.glb``."""
        document = document | {
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.data)}],
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = b"".join(
            struct.pack("<II", len(chunk), kind) + chunk
            for chunk, kind in ((text, JSON_CHUNK), (bytes(self.data), BINARY_CHUNK))
        )
        return MAGIC + struct.pack("<II", 2, 12 + len(chunks)) + chunks


def write_glb(scene: SkinnedScene, path: str | Path) -> None:
    """Write a skinned scene as ``.glb``.

    All of it becomes one mesh with one skin. Joints that have several inverse bind matrices get a
    child node for each further one, so reading the file back can give more joints.

    Raises:
        PrtnetError: the file cannot be written, or the scene does not fit one mesh: morph targets
            on several nodes, or a node with both a matrix and an animation.
    """
    if len(scene.rig.weights_of_node) > 1:
        raise PrtnetError(path, "cannot hold morph targets of several meshes; merge them first")
    writer = Writer()
    channels = [channel for clip in scene.clips for channel in clip.channels]
    animated = {channel.node for channel in channels if channel.path != "weights"}
    nodes = rig_nodes(scene.rig, animated, path)
    skin = {
        "joints": bone_nodes(scene, nodes),
        "inverseBindMatrices": writer.accessor(column_major(scene.bone_inverse_bind), 16),
    }
    mesh: dict[str, Any] = {"name": scene.name, "primitives": [primitive(scene, writer)]}
    if scene.morph_count:
        mesh["weights"] = np.asarray(scene.rig.weights, dtype=float).tolist()
        owner = nodes[next(iter(scene.rig.weights_of_node))]
    else:
        owner = {"name": scene.name}
        nodes.append(owner)
    owner.update(mesh=0, skin=0)
    below = {child for node in nodes for child in node.get("children", ())}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": "prtnet"},
        "scene": 0,
        "scenes": [{"nodes": [index for index in range(len(nodes)) if index not in below]}],
        "nodes": nodes,
        "meshes": [mesh],
        "skins": [skin],
    }
    if scene.clips:
        document["animations"] = [animation(clip, writer) for clip in scene.clips]
    with writing(path) as partial:
        partial.write_bytes(writer.file(document))


def rig_nodes(rig: Rig, animated: set[int], path: str | Path) -> list[dict[str, Any]]:
    """The rig's nodes as JSON."""
    nodes: list[dict[str, Any]] = []
    local = rig.local_matrices(rig.rest())[0]
    for index, name in enumerate(rig.names):
        node: dict[str, Any] = {"name": name}
        if np.array_equal(rig.offset[index], np.eye(4)):
            for key in ("translation", "rotation", "scale"):
                node[key] = np.asarray(getattr(rig, key)[index], dtype=float).tolist()
        elif index in animated:
            raise PrtnetError(path, f"cannot hold the node '{name}': a matrix that is animated")
        else:
            node["matrix"] = local[index].T.ravel().tolist()
        nodes.append(node)
    for index, parent in enumerate(rig.parents):
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(index)
    return nodes


def bone_nodes(scene: SkinnedScene, nodes: list[dict[str, Any]]) -> list[int]:
    """A node of its own for every bone: a skin may name each node once."""
    result: list[int] = []
    for joint in scene.bone_joint:
        node = int(scene.joint_nodes[joint])
        if node in result:
            nodes[node].setdefault("children", []).append(len(nodes))
            nodes.append({"name": f"{nodes[node]['name']} bone {len(nodes)}"})
            node = len(nodes) - 1
        result.append(node)
    return result


def column_major(matrices: FloatArray) -> FloatArray:
    """Matrices (B, 3, 4) as glTF stores them: whole and by columns, (B, 16)."""
    whole = np.tile(np.eye(4), (len(matrices), 1, 1))
    whole[:, :3] = matrices
    return whole.transpose(0, 2, 1).reshape(-1, 16)


def primitive(scene: SkinnedScene, writer: Writer) -> dict[str, Any]:
    """The scene's triangles."""
    attributes = {"POSITION": writer.accessor(scene.positions, 3, target=VERTICES)}
    if scene.normals is not None:
        attributes["NORMAL"] = writer.accessor(scene.normals, 3, target=VERTICES)
    bones, weights = influences(scene.weights)
    spare = -bones.shape[1] % 4
    bones, weights = (np.pad(array, ((0, 0), (0, spare))) for array in (bones, weights))
    for part in range(bones.shape[1] // 4):
        four = slice(4 * part, 4 * part + 4)
        attributes[f"JOINTS_{part}"] = writer.accessor(
            bones[:, four], 4, UNSIGNED_SHORT, target=VERTICES
        )
        attributes[f"WEIGHTS_{part}"] = writer.accessor(weights[:, four], 4, target=VERTICES)
    result: dict[str, Any] = {
        "attributes": attributes,
        "indices": writer.accessor(scene.faces, 1, UNSIGNED_INT, target=INDICES),
    }
    if scene.morph_count:
        offsets = {"POSITION": scene.morph_positions}
        if scene.normals is not None:
            offsets["NORMAL"] = scene.morph_normals
        result["targets"] = [
            {key: writer.accessor(o[m], 3, target=VERTICES) for key, o in offsets.items()}
            for m in range(scene.morph_count)
        ]
    return result


def animation(clip: Clip, writer: Writer) -> dict[str, Any]:
    """A clip as JSON, a sampler for every channel."""
    samplers, channels = [], []
    for channel in clip.channels:
        size = CHANNEL_SIZES[channel.path]
        samplers.append(
            {
                "input": writer.accessor(channel.times, 1),
                "output": writer.accessor(channel.values, size),
                "interpolation": channel.interpolation,
            }
        )
        target = {"node": int(channel.node), "path": channel.path}
        channels.append({"sampler": len(samplers) - 1, "target": target})
    return {"name": clip.name, "samplers": samplers, "channels": channels}
