"""Octahedral maps of the sphere: a square of N² cells with vertices at their corners.

The place (u, v) in [−1, 1]² is the direction of (u, v, 1 − |u| − |v|), folded outwards beyond
|u| + |v| = 1. Either half of a side is the same edge of the octahedron: a table of all (N + 1)²
corners is looked up without knowing where a face ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from prtnet.array_library import Array, library
from prtnet.arrays import FloatArray, IntArray

__all__ = ["Grid", "grid_of", "looked_up", "points"]


def points(u: FloatArray, v: FloatArray) -> FloatArray:
    """Points (…, 3) of the octahedron |x| + |y| + |z| = 1 at places of its map.

    At a distance r from the middle a unit of the map's area has a solid angle of r⁻³.
    """
    z = 1.0 - np.abs(u) - np.abs(v)
    fold = np.maximum(-z, 0.0)
    return np.stack([u - np.copysign(fold, u), v - np.copysign(fold, v), z], axis=-1)


def looked_up(where: Array, cells: int) -> tuple[Any, Array]:
    """Of directions (3, K) float32 the corners of their cells, and what those weigh: both (4, K).

    Corners are counted row · (N + 1) + column, rows along v. Directions may have any length but 0.
    Arrays of NumPy or torch.
    """
    xp = library(where)
    x, y, z = where
    scale = 1.0 / (abs(x) + abs(y) + abs(z))
    x, y, folded = x * scale, y * scale, z < 0.0
    u = xp.where(folded, xp.copysign(1.0 - abs(y), x), x)
    v = xp.where(folded, xp.copysign(1.0 - abs(x), y), y)
    u, v = (u + 1.0) * (cells / 2), (v + 1.0) * (cells / 2)
    column = xp.clip(xp.floor(u), None, cells - 1)
    row = xp.clip(xp.floor(v), None, cells - 1)
    u, v = u - column, v - row
    both = u * v
    first = xp.asarray(row, dtype=xp.int32) * (cells + 1) + xp.asarray(column, dtype=xp.int32)
    weights = xp.stack([1.0 - u - v + both, u - both, v - both, both])
    return xp.stack([first, first + 1, first + (cells + 1), first + (cells + 2)]), weights


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
