"""Octahedral maps of the sphere: a square of N² cells with vertices at their corners.

The place (u, v) in [−1, 1]² is the direction of (u, v, 1 − |u| − |v|), folded outwards beyond
|u| + |v| = 1. Either half of a side is the same edge of the octahedron: a table of all (N + 1)²
corners is looked up without knowing where a face ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["Grid", "grid_of", "looked_up", "points"]


def points(u: FloatArray, v: FloatArray) -> FloatArray:
    """Points (…, 3) of the octahedron |x| + |y| + |z| = 1 at places of its map.

    At a distance r from the middle a unit of the map's area has a solid angle of r⁻³.
    """
    z = 1.0 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0.0)
    return np.stack([u - np.copysign(fold, u), v - np.copysign(fold, v), z], axis=-1)


def looked_up(where: FloatArray, cells: int) -> tuple[IntArray, FloatArray]:
    """Of directions (3, K) float32 the corners of their cells, and what those weigh: both (4, K).

    Corners are counted row · (N + 1) + column, rows along v. Directions may have any length but 0.
    """
    x, y, z = where
    scale = np.float32(1.0) / (np.abs(x) + np.abs(y) + np.abs(z))
    x, y, folded = x * scale, y * scale, z < 0.0
    half, one = np.float32(cells / 2), np.float32(1.0)
    u = np.where(folded, np.copysign(one - np.abs(y), x), x)
    v = np.where(folded, np.copysign(one - np.abs(x), y), y)
    u, v = (u + one) * half, (v + one) * half
    column = np.minimum(u.astype(np.int32), cells - 1)
    row = np.minimum(v.astype(np.int32), cells - 1)
    u, v = u - column.astype(np.float32), v - row.astype(np.float32)
    both = u * v
    first = row * np.int32(cells + 1) + column
    weights = np.stack([one - u - v + both, u - both, v - both, both])
    return first + np.array([[0], [1], [cells + 1], [cells + 2]], dtype=np.int32), weights


@dataclass(frozen=True, eq=False)
class Grid:
    """The corners of N² cells as a closed mesh.

    Attributes:
        vertex: of every corner, ((N + 1)²,): those of a side come twice, of a corner four times.
        places: unit vertices (V, 3), N² + 2 of them.
        faces: triangles (2 N², 3): nearly equilateral, cut along the edges of the octahedron.
    """

    vertex: IntArray
    places: FloatArray
    faces: IntArray


@lru_cache(maxsize=2)
def grid_of(cells: int) -> Grid:
    """The grid of N² cells.

    Raises:
        ValueError: N is odd: edges of the octahedron would cross cells.
    """
    if cells < 2 or cells % 2:
        raise ValueError(f"an octahedral grid has an even number of cells a side, not {cells}")
    half, line = cells // 2, np.arange(cells + 1)
    row, column = np.meshgrid(line, line, indexing="ij")
    side = np.isin(row, (0, cells)), np.isin(column, (0, cells))
    same_row = np.where(side[1], half + np.abs(row - half), row)
    same_column = np.where(side[0], half + np.abs(column - half), column)
    corner = side[0] & side[1]
    first = np.where(corner, (cells + 1) ** 2 - 1, same_row * (cells + 1) + same_column)
    kept, vertex = np.unique(first, return_inverse=True)
    vertex = vertex.reshape(cells + 1, cells + 1)
    v, u = (index / half - 1.0 for index in divmod(kept, cells + 1))
    places = points(u, v)
    a, b, c, d = vertex[:-1, :-1], vertex[:-1, 1:], vertex[1:, :-1], vertex[1:, 1:]
    falls = (row[:-1, :-1] < half) == (column[:-1, :-1] < half)  # cut from b to c
    first_half = np.where(falls, (a, b, c), (a, b, d))
    second_half = np.where(falls, (b, d, c), (a, d, c))
    faces = np.concatenate([one.reshape(3, -1).T for one in (first_half, second_half)])
    unit = places / np.linalg.norm(places, axis=1, keepdims=True)
    return Grid(vertex.ravel(), unit, faces.astype(np.int32))
