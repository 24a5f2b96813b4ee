"""Normals and areas of the points of a mesh, from its triangles."""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.scene import unit

__all__ = ["solid_faces", "vertex_areas", "vertex_normals"]

FLAT = 1e-12  # a triangle's height over its length, squared, below which it is a line


def solid_faces(positions: FloatArray, faces: IntArray) -> BoolArray:
    """Which triangles (T, 3) have an area, (T,)."""
    edges = corner_edges(positions, faces)
    normal = np.cross(edges[:, 0], -edges[:, 2])
    longest = np.einsum("tci,tci->tc", edges, edges).max(axis=1)
    return np.asarray(np.einsum("ti,ti->t", normal, normal) > FLAT * longest**2)


def corner_edges(positions: FloatArray, faces: IntArray) -> FloatArray:
    """From each corner of a triangle to the next, (T, 3, 3) float64."""
    corners = np.asarray(positions, dtype=np.float64)[faces]
    return np.roll(corners, -1, axis=1) - corners


def vertex_areas(positions: FloatArray, faces: IntArray) -> FloatArray:
    """A third of the area of the triangles around each vertex, (V,): together the whole area."""
    edges = corner_edges(positions, faces)
    normal = np.cross(edges[:, 0], -edges[:, 2])
    area = np.sqrt(np.einsum("ti,ti->t", normal, normal)) / 6.0
    return np.bincount(faces.ravel(), np.repeat(area, 3), len(positions)).astype(np.float64)


def vertex_normals(positions: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (V, 3): of the triangles around each vertex, by their angles there.

    How the surface is cut into triangles does not matter, nor that one of them is endless.
    """
    edges = unit(corner_edges(positions, faces))
    normal = unit(np.cross(edges[:, 0], -edges[:, 2]))
    cosine = -np.einsum("tci,tci->tc", edges, np.roll(edges, 1, axis=1))
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    total = np.stack(
        [
            np.bincount(faces.ravel(), (angle * normal[:, axis, None]).ravel(), len(positions))
            for axis in range(3)
        ],
        axis=1,
    ).astype(np.float64)
    total[np.einsum("vi,vi->v", total, total) < (1e-9 * math.pi) ** 2] = 0.0
    return unit(total)
