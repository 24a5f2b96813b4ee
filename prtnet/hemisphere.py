"""Maps of the square [−1, 1]² to the upper hemisphere, for tables of directions.

The *concentric* map preserves area: every cell sees the same solid angle (Shirley and Chiu 1997,
square to disc; z = 1 − r², disc to hemisphere). The *parabolic* one (Heidrich and Seidel 1998) is
the mirror image in a paraboloid; the corners of its square are below the horizon.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["Mapping", "cells", "directions", "places"]

Mapping = Literal["concentric", "parabolic"]


def directions(places: FloatArray, mapping: Mapping) -> tuple[FloatArray, FloatArray]:
    """Unit directions (…, 3) of places (…, 2), and the solid angle (…) that a unit of area has.

    On the parabolic map that is 0 where a direction is below the horizon.
    """
    places = np.asarray(places, dtype=np.float64)
    x, y = places[..., 0], places[..., 1]
    if mapping == "parabolic":
        r2 = x * x + y * y
        up = 2.0 / (1.0 + r2)
        out = np.stack([x * up, y * up, up - 1.0], axis=-1)
        return out, np.where(r2 < 1.0, up * up, 0.0)
    wide = np.abs(x) >= np.abs(y)
    radius = np.where(wide, x, y)
    safe = np.where(radius == 0.0, 1.0, radius)
    angle = math.pi / 4.0 * np.where(wide, y, x) / safe
    angle = np.where(wide, angle, math.pi / 2.0 - angle)
    r2 = radius * radius
    across = radius * np.sqrt(2.0 - r2)  # the sine
    out = np.stack([across * np.cos(angle), across * np.sin(angle), 1.0 - r2], axis=-1)
    return out, np.full(out.shape[:-1], math.pi / 2.0)


def places(directions: FloatArray, mapping: Mapping) -> FloatArray:
    """The inverse for directions (…, 3) above the horizon: places (…, 2)."""
    d = np.asarray(directions, dtype=np.float64)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    if mapping == "parabolic":
        return d[..., :2] / (1.0 + z)[..., None]
    radius = np.sqrt(np.clip(1.0 - z, 0.0, 1.0))
    angle = np.arctan2(y, x)
    angle = np.where(angle < -math.pi / 4.0, angle + 2.0 * math.pi, angle)
    quarter = np.floor((angle + math.pi / 4.0) / (math.pi / 2.0))
    off = (angle - quarter * (math.pi / 2.0)) * (4.0 / math.pi) * radius
    side = quarter.astype(np.int64) % 4
    sides = [(radius, off), (-off, radius), (-radius, -off), (off, -radius)]
    return np.stack([np.choose(side, [pair[axis] for pair in sides]) for axis in range(2)], axis=-1)


def cells(size: int, samples: int, mapping: Mapping) -> tuple[FloatArray, FloatArray]:
    """Directions (size², samples², 3) within the cells of a table, and their solid angles.

    Args:
        size: cells a side; cell (row, column) is at index row · size + column, its row along y.
        samples: a side of each cell, at regular places.
        mapping: of the table.

    Returns:
        Directions, and the solid angle (size², samples²) that each stands for: 2π in all.
    """
    count = size * samples
    line = (2.0 * np.arange(count) + 1.0) / count - 1.0
    grid = np.stack(np.meshgrid(line, line), axis=-1)  # [y, x, 2]
    grid = grid.reshape(size, samples, size, samples, 2).swapaxes(1, 2)
    out, area = directions(grid.reshape(size * size, samples * samples, 2), mapping)
    return out, area * (2.0 / count) ** 2
