"""Triangles of a glTF mesh [1, section 3.7]: one primitive as plain arrays.

[1] glTF 2.0 specification, Khronos Group.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.gltf_buffers import Buffers
from data_gen.gltf_document import Element
from prtnet.arrays import FloatArray, IntArray
from prtnet.scene import face_normals, unit

__all__ = ["Primitive", "read_primitive", "vertex_bound"]

TRIANGLES, STRIP, FAN = 4, 5, 6
ROUNDING = 1e-6  # what is one to float32 stays as it is, so that a file written again is the same
DRACO = "KHR_draco_mesh_compression"


@dataclass(frozen=True, eq=False)
class Primitive:
    """Triangles and their vertices in the mesh's own space.

    Attributes:
        positions: (V, 3) float64.
        normals: unit, (V, 3); None where the file has none.
        faces: (T, 3) int64.
        joints, weights: influences, (V, K) each: joints are slots of the skin; weights are not
            negative and sum to one. None where the file has none.
        targets: offsets of positions and normals (2, V, 3) of every morph target.
    """

    positions: FloatArray
    normals: FloatArray | None
    faces: IntArray
    joints: IntArray | None
    weights: FloatArray | None
    targets: tuple[FloatArray, ...]

    def unshared(self) -> Primitive:
        """The same triangles, no two sharing a vertex."""
        corner = self.faces.ravel()
        return Primitive(
            self.positions[corner],
            None if self.normals is None else self.normals[corner],
            np.arange(len(corner)).reshape(-1, 3),
            None if self.joints is None else self.joints[corner],
            None if self.weights is None else self.weights[corner],
            tuple(target[:, corner] for target in self.targets),
        )

    def flat_normals(self) -> FloatArray:
        """The faces' normals at their vertices, (V, 3), of a primitive that shares none."""
        return np.repeat(unit(face_normals(self.positions, self.faces)), 3, axis=0)


def vertex_bound(element: Element, buffers: Buffers) -> int:
    """At most how many vertices a primitive comes to, before any is read."""
    attributes = element.required("attributes")
    count = buffers.count(attributes, "POSITION")
    if "NORMAL" in attributes:
        return count
    if "indices" in element:
        count = max(count, buffers.count(element, "indices"))
    return count if element.integer("mode", TRIANGLES) == TRIANGLES else 3 * count


def read_primitive(element: Element, buffers: Buffers) -> Primitive | None:
    """The primitive as triangles; None for points and lines.

    Triangles of no area are kept.

    Raises:
        PrtnetError: an accessor is damaged or does not fit the others.
    """
    mode = element.integer("mode", TRIANGLES)
    if mode not in (TRIANGLES, STRIP, FAN):
        return None
    attributes = element.required("attributes")
    extensions = element.child("extensions")
    if extensions is not None and DRACO in extensions:
        element.fail(f"is compressed ({DRACO})", "export it without compression")
    positions = buffers.floats(attributes, "POSITION", "VEC3")
    count = len(positions)
    normals = None
    if "NORMAL" in attributes:
        given = vectors(attributes, "NORMAL", buffers, count)
        long = np.abs(np.linalg.norm(given, axis=1, keepdims=True) - 1.0) > ROUNDING
        normals = np.where(long, unit(given), given)
    joints, weights = influences(attributes, buffers, count)
    targets = tuple(
        np.stack(
            [vectors(target, name, buffers, count) for name in ("POSITION", "NORMAL")],
            dtype=np.float32,
            casting="same_kind",
        )
        for target in element.children("targets")
    )
    faces = triangles(element, buffers, mode, count)
    return Primitive(positions, normals, faces, joints, weights, targets)


def vectors(attributes: Element, key: str, buffers: Buffers, count: int) -> FloatArray:
    """An attribute of ``count`` three-vectors (V, 3); zeros where there is none."""
    if key not in attributes:
        return np.zeros((count, 3))
    values = buffers.floats(attributes, key, "VEC3", integers_normalised=key == "NORMAL")
    if len(values) != count:
        attributes.fail(f"{key} has {len(values)} vertices but POSITION has {count}")
    return values


def influences(
    attributes: Element, buffers: Buffers, count: int
) -> tuple[IntArray | None, FloatArray | None]:
    """Skin slots and weights of all sets (V, 4·sets).

    Negative weights count as zero, and weights are scaled to sum to one. A vertex whose weights
    are all zero follows the first joint it names, as in common viewers.
    """
    joints: list[IntArray] = []
    weights: list[FloatArray] = []
    while f"JOINTS_{len(joints)}" in attributes:
        n = len(joints)
        joints.append(buffers.integers(attributes, f"JOINTS_{n}", "VEC4"))
        weights.append(buffers.floats(attributes, f"WEIGHTS_{n}", "VEC4", integers_normalised=True))
        if len(joints[n]) != count or len(weights[n]) != count:
            attributes.fail(f"JOINTS_{n}, WEIGHTS_{n} and POSITION differ in length")
    if not joints:
        return None, None
    weight = np.maximum(np.concatenate(weights, axis=1), 0.0)
    total = weight.sum(axis=1)
    weight[total == 0, 0] = 1.0
    kept = (total == 0) | (np.abs(total - 1.0) <= ROUNDING)
    return np.concatenate(joints, axis=1), weight / np.where(kept, 1.0, total)[:, None]


def triangles(element: Element, buffers: Buffers, mode: int, count: int) -> IntArray:
    """Faces (T, 3) of a list, strip or fan of triangles."""
    if "indices" in element:
        corners = buffers.integers(element, "indices", "SCALAR")[:, 0]
        if corners.max() >= count:
            element.fail(f"index {corners.max()} but there are only {count} vertices")
    else:
        corners = np.arange(count)
    if mode == TRIANGLES:
        if len(corners) % 3:
            element.fail(f"{len(corners)} corners do not make whole triangles")
        return corners.reshape(-1, 3)
    first = np.arange(max(len(corners) - 2, 0))
    if mode == STRIP:  # every second triangle is wound the other way
        odd = first % 2
        return corners[np.stack([first, first + 1 + odd, first + 2 - odd], axis=1)]
    return corners[np.stack([first + 1, first + 2, np.zeros_like(first)], axis=1)]
