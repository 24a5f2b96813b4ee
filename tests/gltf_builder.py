"""glTF files of every shape for the readers' tests, and a slow reading of them to compare with."""

from __future__ import annotations

import base64
import functools
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

CODES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Builder:
    """A glTF document as a plain dictionary, and a buffer that arrays are added to."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
            "buffers": [],
        }

    def view(self, data: bytes, stride: int | None = None) -> int:
        self.data += bytes(-len(self.data) % 4)
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data)}
        if stride:
            view["byteStride"] = stride
        self.data += data
        self.json["bufferViews"].append(view)
        return len(self.json["bufferViews"]) - 1

    def accessor(
        self, values: Any, dtype: str = "f4", *, stride: int | None = None, **extra: Any
    ) -> int:
        array = np.asarray(values, dtype="<" + dtype)
        array = array.reshape(len(array), -1)
        rows = [row.tobytes() for row in array]
        data = b"".join(row.ljust(stride or 0, b"\xcc") for row in rows)
        self.json["accessors"].append(
            {
                "bufferView": self.view(data, stride),
                "componentType": CODES[dtype],
                "count": len(array),
                "type": KINDS[array.shape[1]],
                **extra,
            }
        )
        return len(self.json["accessors"]) - 1

    def mesh(self, positions: Any, indices: Any = None, **attributes: Any) -> dict[str, Any]:
        """Append a mesh of one primitive; returns the primitive."""
        primitive: dict[str, Any] = {
            "attributes": {"POSITION": self.accessor(positions), **attributes}
        }
        if indices is not None:
            primitive["indices"] = self.accessor(indices, "u2")
        self.json["meshes"].append({"primitives": [primitive]})
        return primitive

    def clip(self, *channels: tuple[int, str, Any, Any, str], **extra: Any) -> None:
        """Append an animation of (node, path, times, values or accessor, interpolation)."""
        samplers, targets = [], []
        for node, path, times, values, mode in channels:
            if not isinstance(values, int):
                array = np.asarray(values, dtype=float)
                size = {"rotation": 4, "weights": 1}.get(path, 3)
                values = self.accessor(array.reshape(-1, size))
            samplers.append(
                {"input": self.accessor(times), "output": values, "interpolation": mode}
            )
            target = {"node": node, "path": path}
            targets.append({"sampler": len(samplers) - 1, "target": target})
        animation = {"samplers": samplers, "channels": targets, **extra}
        self.json.setdefault("animations", []).append(animation)

    def glb(self, path: Path) -> Path:
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        path.write_bytes(pack(json.dumps(self.json).encode(), bytes(self.data)))
        return path

    def gltf(self, path: Path, external: str | None = None) -> Path:
        """With the buffer as a data: address, or in a file of its own."""
        buffer: dict[str, Any] = {"byteLength": len(self.data)}
        if external is None:
            text = base64.b64encode(bytes(self.data)).decode()
            buffer["uri"] = "data:application/octet-stream;base64," + text
        else:
            (path.parent / external).write_bytes(bytes(self.data))
            buffer["uri"] = external.replace(" ", "%20")
        path.write_text(json.dumps(self.json | {"buffers": [buffer]}))
        return path


def pack(text: bytes, data: bytes) -> bytes:
    """A .glb of JSON and binary chunk."""
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def unpack(glb: bytes) -> tuple[dict[str, Any], bytes]:
    """JSON and binary chunk of a .glb."""
    length = struct.unpack_from("<I", glb, 12)[0]
    return json.loads(glb[20 : 20 + length]), glb[28 + length :]


class Reference:
    """Poses a .glb one number at a time, straight from the specification.

    It knows LINEAR, STEP and CUBICSPLINE, skins and morph targets of float vertices with indices,
    one vertex after the other; nothing here is shared with the reader.
    """

    def __init__(self, path: Path) -> None:
        self.json, self.data = unpack(path.read_bytes())

    @functools.cache  # noqa: B019 - a few small files in a test
    def rows(self, index: int) -> list[list[float]]:
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        letter = {5121: "B", 5123: "H", 5125: "I", 5126: "f"}[accessor["componentType"]]
        size = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        row = struct.Struct(f"<{size}{letter}")
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        stride = view.get("byteStride", row.size)
        return [
            list(row.unpack_from(self.data, start + i * stride)) for i in range(accessor["count"])
        ]

    def properties(self, clip: int, time: float) -> dict[tuple[int, str], list[float]]:
        animation, result = self.json["animations"][clip], {}
        for channel in animation["channels"]:
            sampler = animation["samplers"][channel["sampler"]]
            keys = [row[0] for row in self.rows(sampler["input"])]
            flat = [x for row in self.rows(sampler["output"]) for x in row]
            path, mode = channel["target"]["path"], sampler.get("interpolation", "LINEAR")
            result[channel["target"]["node"], path] = interpolate(keys, flat, time, path, mode)
        return result

    def corners(self, clip: int, time: float) -> NDArray[np.float64]:
        """Position and normal of every corner of every triangle, (T·3, 6), nodes by level."""
        moved = self.properties(clip, time)
        nodes = self.json["nodes"]
        parent = {c: i for i, node in enumerate(nodes) for c in node.get("children", [])}
        order = [i for i in range(len(nodes)) if i not in parent]
        for i in order:
            order.extend(nodes[i].get("children", []))

        @functools.cache
        def world(i: int) -> NDArray[np.float64]:
            node = nodes[i]
            if "matrix" in node:
                local = np.array(node["matrix"], dtype=float).reshape(4, 4).T
            else:
                t, r, s = (
                    moved.get((i, key), node.get(key, rest))
                    for key, rest in (
                        ("translation", [0, 0, 0]),
                        ("rotation", [0, 0, 0, 1]),
                        ("scale", [1, 1, 1]),
                    )
                )
                local = np.eye(4)
                local[:3, :3] = [[rotate(r, e)[k] * s[j] for j, e in enumerate(np.eye(3))]
                                 for k in range(3)]  # fmt: skip
                local[:3, 3] = t
            return world(parent[i]) @ local if i in parent else local

        result = []
        for i in order:
            if "mesh" not in nodes[i]:
                continue
            mesh = self.json["meshes"][nodes[i]["mesh"]]
            weights = moved.get((i, "weights"), nodes[i].get("weights", mesh.get("weights", [])))
            for primitive in mesh["primitives"]:
                result += self.primitive(primitive, nodes[i], weights, world, i)
        return np.array(result)

    def primitive(self, primitive: Any, node: Any, weights: Any, world: Any, i: int) -> Any:
        attributes = {k: self.rows(a) for k, a in primitive["attributes"].items() if k[:3] != "TEX"}
        if "skin" in node:
            skin = self.json["skins"][node["skin"]]
            inverse = [np.array(m).reshape(4, 4).T for m in self.rows(skin["inverseBindMatrices"])]
            bones = [world(j) @ m for j, m in zip(skin["joints"], inverse, strict=True)]
        vertices = []
        for v, position in enumerate(attributes["POSITION"]):
            point = np.array([*position, 1.0])
            normal = np.array(attributes["NORMAL"][v])
            for w, target in zip(weights, primitive.get("targets", []), strict=True):
                point[:3] += w * np.array(self.rows(target["POSITION"])[v])
                normal = normal + w * np.array(self.rows(target["NORMAL"])[v])
            matrix = world(i)
            if "skin" in node:
                pairs = [
                    (j, w)
                    for n in (0, 1)
                    if f"JOINTS_{n}" in attributes
                    for j, w in zip(
                        attributes[f"JOINTS_{n}"][v], attributes[f"WEIGHTS_{n}"][v], strict=True
                    )
                ]
                matrix = sum(w * bones[int(j)] for j, w in pairs)
            turned = np.linalg.inv(matrix[:3, :3]).T @ normal
            vertices.append([*(matrix @ point)[:3], *(turned / np.linalg.norm(turned))])
        return [vertices[int(row[0])] for row in self.rows(primitive["indices"])]


def rotate(q: Any, v: Any) -> NDArray[np.float64]:
    """v + 2w(u × v) + 2u × (u × v), q = (u, w) normalised."""
    q = np.array(q, dtype=float) / np.linalg.norm(q)
    u, w = q[:3], q[3]
    return v + 2 * w * np.cross(u, v) + 2 * np.cross(u, np.cross(u, v))


def interpolate(keys: Any, flat: Any, time: float, path: str, mode: str) -> list[float]:
    """glTF 2.0 specification, appendix C, for one time."""
    cubic = mode == "CUBICSPLINE"
    values = np.array(flat).reshape(len(keys), 3 if cubic else 1, -1)
    centre = 1 if cubic else 0
    if time <= keys[0]:
        return values[0, centre]
    if time >= keys[-1]:
        return values[-1, centre]
    k = max(i for i, key in enumerate(keys) if key <= time)
    d = keys[k + 1] - keys[k]
    t = (time - keys[k]) / d
    a, b = values[k, centre], values[k + 1, centre]
    if mode == "STEP":
        return a
    if cubic:
        return (
            (2 * t**3 - 3 * t**2 + 1) * a
            + d * (t**3 - 2 * t**2 + t) * values[k, 2]
            + (-2 * t**3 + 3 * t**2) * b
            + d * (t**3 - t**2) * values[k + 1, 0]
        )
    if path == "rotation":
        dot = float(np.dot(a, b))
        angle = np.arccos(min(abs(dot), 1.0))
        if angle < 1e-5:
            return (1 - t) * a + t * np.sign(dot) * b
        sign = 1.0 if dot >= 0 else -1.0
        return (np.sin((1 - t) * angle) * a + sign * np.sin(t * angle) * b) / np.sin(angle)
    return (1 - t) * a + t * b
