"""The wrinkle model of "LDPRT" (Sloan, Luna and Snyder 2005) section 4.2: a sinusoidal groove.

The groove runs along y; x goes across it, from 0 to 1 over its width, and the surface beside it is
flat. Its transfer depends on x and on the depth d alone, so one small map holds all grooves:
column c of W is x = c / (W − 1), row r of H is d = r / (H − 1) of the deepest, both ends included.
A wrinkle on a surface is then a pair of numbers a point: how far it is from the groove's edge, and
how deep the groove is there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["Wrinkle"]


@dataclass(frozen=True)
class Wrinkle:
    """A family of grooves.

    Attributes:
        width: of the groove, metres.
        deepest: depth of the last row, metres.
        columns: W, places across the groove.
        rows: H, depths.
    """

    width: float = 0.01
    deepest: float = 0.01
    columns: int = 32
    rows: int = 32

    def __post_init__(self) -> None:
        """Raise ValueError for a family that has no two grooves, or none at all."""
        if not (0 < self.width < math.inf and 0 < self.deepest < math.inf):
            raise ValueError("a wrinkle has a width and a depth above 0")
        if min(self.columns, self.rows) < 2:
            raise ValueError("a wrinkle's map has at least two columns and two rows")

    @property
    def depths(self) -> FloatArray:
        """Depth of every row, metres, (H,)."""
        return np.linspace(0.0, self.deepest, self.rows)

    def heights(self, x: FloatArray, depth: FloatArray | float) -> FloatArray:
        """Height (...) over the flat surface, metres, at x (...) in widths; 0 outside [0, 1]."""
        inside = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
        return -0.5 * np.asarray(depth) * (1.0 - np.cos(2.0 * math.pi * inside))

    def normals(self, x: FloatArray, depth: FloatArray | float) -> FloatArray:
        """Unit normals (..., 3) in the frame of the flat surface."""
        inside = np.clip(np.asarray(x, dtype=np.float64), 0.0, 1.0)
        slope = -math.pi * np.asarray(depth) / self.width * np.sin(2.0 * math.pi * inside)
        up = 1.0 / np.sqrt(1.0 + slope * slope)
        return np.stack([-slope * up, np.zeros_like(up), up], axis=-1)

    def coordinates(self, across: FloatArray, depth: FloatArray) -> FloatArray:
        """Texture coordinates (..., 2) in [0, 1] of places on a surface.

        Bilinear sampling there, between the centres of texels, interpolates the map. Beside the
        groove the coordinates stay at its edge, which is as good as flat.

        Args:
            across: metres from the groove's left edge, (...).
            depth: of the groove there, metres, (...); deeper than the deepest is the deepest.
        """
        x = np.clip(np.asarray(across, dtype=np.float64) / self.width, 0.0, 1.0)
        d = np.clip(np.asarray(depth, dtype=np.float64) / self.deepest, 0.0, 1.0)
        u = (x * (self.columns - 1) + 0.5) / self.columns
        v = (d * (self.rows - 1) + 0.5) / self.rows
        return np.stack(np.broadcast_arrays(u, v), axis=-1)
