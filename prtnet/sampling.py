"""Random choice with a density that is known: points of the square, lines, tables, caps.

Whatever draws comes with the density of what it draws, so that several ways to draw can be combined
[1]. Random numbers u are in [0, 1).

[1] Veach, Guibas. "Optimally combining sampling techniques for Monte Carlo rendering". 1995.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["Cells", "around", "cosine_hemisphere", "lattice", "linear", "shares"]

MOST = 1.0 - 2.0**-32  # of a random number: so that adding the index of a row stays below the next


def lattice(count: int) -> FloatArray:
    """The Fibonacci lattice of the unit square, (count, 2): even in both numbers, and together."""
    index = np.arange(count)
    turn = (3.0 - math.sqrt(5.0)) / 2.0
    return np.stack([(index + 0.5) / count, index * turn % 1.0], axis=1)


def shares(weights: FloatArray, total: int) -> IntArray:
    """Whole numbers (N,), in all ``total``, as weights (N,) are; of every one at least 1.

    So in all more than ``total`` where that is less than N.
    """
    count = len(weights)
    spare = max(total - count, 0)
    exact = (
        spare * weights / weights.sum() if weights.sum() > 0.0 else np.full(count, spare / count)
    )
    found = np.floor(exact).astype(np.int64)
    rest = np.argsort(found - exact, kind="stable")[: spare - found.sum()]
    found[rest] += 1
    return found + 1


def linear(first: FloatArray, last: FloatArray, u: FloatArray) -> FloatArray:
    """Draw t (N,) in [0, 1] with a density as first · (1 − t) + last · t, both (N,), at least 0.

    Where both are 0 it is even.
    """
    total = first + last
    below = first + np.sqrt((1.0 - u) * first**2 + u * last**2)
    return np.where(total > 0.0, u * total / np.where(below > 0.0, below, 1.0), u)


def around(drop: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Directions (…, 3) about +z, of ``drop`` = 1 − cos of the angle from it, and azimuth."""
    sine = np.sqrt(np.maximum(drop * (2.0 - drop), 0.0))
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1.0 - drop], axis=-1)


def cosine_hemisphere(u: FloatArray) -> FloatArray:
    """Draw directions (N, 3) above z = 0 with the density z/π, from u (N, 2)."""
    return around(1.0 - np.sqrt(1.0 - u[:, 0]), 2.0 * math.pi * u[:, 1])


class Cells:
    """Cells of tables, drawn as often as their weights say: first a row, then a cell of it.

    Args:
        weights: (T, R, C) of T tables, at least 0. A table without weight is drawn from evenly.
    """

    def __init__(self, weights: FloatArray) -> None:
        tables, rows, columns = weights.shape
        flat = np.asarray(weights, dtype=np.float64).reshape(tables * rows, columns)
        self.shape = (tables, rows, columns)
        self._rows = ramps(flat.sum(axis=1).reshape(tables, rows))
        self._columns = ramps(flat)

    def draw(self, table: IntArray, u: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
        """Row and column (N,) in tables (N,), of u (N, 2), and the random numbers left (N, 2).

        The first number chooses the row, the second the column.
        """
        row, first = invert(self._rows, table, u[:, 0])
        column, second = invert(self._columns, table * self.shape[1] + row, u[:, 1])
        return row, column, np.stack([first, second], axis=1)

    def probability(self, table: IntArray, row: IntArray, column: IntArray) -> FloatArray:
        """(N,) how likely a cell is: exactly as ``draw`` has it."""
        line = table * self.shape[1] + row
        return steps(self._rows, table, row) * steps(self._columns, line, column)


def ramps(weights: FloatArray) -> FloatArray:
    """Cumulative shares (N, C + 1) of every row of weights (N, C), from N's index to the next."""
    total = weights.sum(axis=1)
    ramp = np.zeros((len(weights), weights.shape[1] + 1))
    np.cumsum(weights, axis=1, out=ramp[:, 1:])
    ramp[total == 0.0] = np.arange(weights.shape[1] + 1)
    # What ends with the row's total ends at one: rounding must leave no gap for nothing to be in.
    ramp /= ramp[:, -1:]
    ramp += np.arange(len(weights))[:, None]
    return ramp


def invert(ramp: FloatArray, line: IntArray, u: FloatArray) -> tuple[IntArray, FloatArray]:
    """The cell of lines (N,) that u (N,) falls in, and where within it."""
    size = ramp.shape[1]
    value = line + np.minimum(u, MOST)
    place = np.searchsorted(ramp.ravel(), value, side="right") - 1
    low, high = ramp.ravel()[place], ramp.ravel()[place + 1]
    return place - line * size, np.clip((value - low) / (high - low), 0.0, MOST)


def steps(ramp: FloatArray, line: IntArray, cell: IntArray) -> FloatArray:
    """The share (N,) of cells of lines, both (N,)."""
    return ramp[line, cell + 1] - ramp[line, cell]
