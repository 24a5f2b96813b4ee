"""Pictures of the whole sphere, equirectangular: radiance by direction and its coefficients.

An equirectangular picture wraps the world as in three.js and the glTF sample viewer: its top row is
+y, and from its left edge to its right one columns look along −x, −z (a quarter), +x (the middle),
+z (three quarters) and −x again. A texel (row r, column c) of an H × W picture looks along

    (−sin θ cos φ, cos θ, −sin θ sin φ),   θ = π (r + ½)/H,   φ = 2π (c + ½)/W.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.sh import bands, evaluate
from prtnet.sh_rotation import rotate

__all__ = ["Picture", "project_equirectangular"]

BLOCK = 64  # rows of a picture at a time


@dataclass(frozen=True)
class Picture:
    """A light given by texels.

    Attributes:
        texels: radiance, linear RGB, (H, W, 3).
    """

    texels: FloatArray

    def radiance(self, directions: FloatArray) -> FloatArray:
        """At unit directions (N, 3): (N, 3), bilinear between the middles of texels.

        Columns go round; beyond the middles of the first and last row the row goes on to the pole.
        """
        height, width = self.texels.shape[:2]
        x, y, z = np.asarray(directions, dtype=np.float64).T
        row = np.arctan2(np.hypot(x, z), y) * (height / math.pi) - 0.5
        column = np.arctan2(-z, -x) * (width / (2.0 * math.pi)) - 0.5
        top, left = np.floor(row), np.floor(column)
        result: FloatArray = np.zeros((len(row), self.texels.shape[2]))
        for r, row_share in ((top, 1.0 - (row - top)), (top + 1.0, row - top)):
            r = np.clip(r, 0, height - 1).astype(np.int64)
            for c, share in ((left, 1.0 - (column - left)), (left + 1.0, column - left)):
                texel = self.texels[r, c.astype(np.int64) % width]
                result += (row_share * share)[:, None] * texel
        return result

    def harmonics(self, order: int) -> FloatArray:
        """Coefficients (n², 3) float64, each texel of constant radiance."""
        return project_equirectangular(self.texels, order)


def project_equirectangular(picture: FloatArray, order: int) -> FloatArray:
    """SH coefficients of a picture of the whole sphere, each texel of constant radiance.

    Seen along the vertical axis the basis is a product Θ(θ)·{cos, sin}(|m|φ), so the picture is
    integrated along rows, then down the columns, and the result turned upright. The integrals over
    φ are exact and those over θ good to rounding (four Gauss points a row).

    Args:
        picture: radiance, (H, W, C), laid out as this module says.
        order: number of bands n.

    Returns:
        (n², C) float64.
    """
    height, width = picture.shape[:2]
    m = np.arange(-(order - 1), order)
    edges = 2 * math.pi / width * np.arange(width + 1)
    # The azimuth of the basis is −φ: ∫cos(mφ) = sin(mφ)/m, and ∫sin(−|m|φ) = cos(mφ)/|m|.
    angle = np.abs(m)[:, None] * edges
    integral = np.where(m[:, None] < 0, np.cos(angle), np.sin(angle))
    integral = np.where(m[:, None] == 0, edges, integral / np.maximum(np.abs(m), 1)[:, None])
    row_integral = np.diff(integral, axis=1)
    rows = np.concatenate(  # [H, 2n−1, C]
        [row_integral @ picture[first : first + BLOCK] for first in range(0, height, BLOCK)]
    )

    nodes, weights = np.polynomial.legendre.leggauss(4)
    heights = np.cos(math.pi / height * np.arange(height + 1))  # cos θ of the rows' edges
    middle, half = (heights[:-1] + heights[1:]) / 2, (heights[:-1] - heights[1:]) / 2
    z = middle[:, None] + half[:, None] * nodes
    meridian = np.stack([np.sqrt(np.maximum(1 - z * z, 0)), np.zeros_like(z), z], axis=-1)
    polar = np.einsum("hqi,q,h->hi", evaluate(meridian, order), weights, half)  # [H, n²], m ≥ 0

    band = bands(order)
    index_m = np.arange(order * order) - band * (band + 1)
    theta = polar[:, band * (band + 1) + np.abs(index_m)]
    lying = np.einsum("hi,hic->ic", theta, rows[:, index_m + order - 1])
    # The columns are where the basis' own x (azimuth 0), y and z (the pole) lie in the world.
    upright = np.array([[-1.0, 0, 0], [0, 0, 1], [0, 1, 0]])
    return rotate(lying.T, upright).T
