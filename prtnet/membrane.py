"""A thin membrane that lets light through: "LDPRT" (Sloan, Luna and Snyder 2005), eq. 22–23.

    g(s) = s·n above the horizon, −α s·n below it

for a transparency α ≤ 1: one zonal lobe about the normal, so nothing needs fitting. Exit radiance
is albedo / π times it.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.transfer import Patch, TransferField
from prtnet.zh import Lobes

__all__ = ["membrane_field", "membrane_lobes"]


def membrane_lobes(transparency: FloatArray | float, order: int, albedo: float = 1.0) -> Lobes:
    """The lobe of every point in its own frame, one each, by [eq. 23].

    Args:
        transparency: α in [0, 1], (...).
        order: bands n.
        albedo: the part of light that is sent on.

    Returns:
        Axes (..., 1, 3), all +z, and coefficients (..., 1, n), float64: of exit radiance, so
        [eq. 23], which has 1/π in it already, times the albedo.

    Raises:
        ValueError: α or the albedo is outside of [0, 1].
    """
    alpha = np.asarray(transparency, dtype=np.float64)
    if not ((alpha >= 0) & (alpha <= 1)).all() or not 0 <= albedo <= 1:
        raise ValueError("transparency and albedo must be in [0, 1]")
    coefficients = np.zeros((*alpha.shape, 1, order))
    for band in range(order):
        if band == 1:
            coefficients[..., 0, band] = 2.0 / 3.0 * (1.0 - alpha)
        elif band % 2 == 0:
            half = band // 2
            share = math.comb(band, half) / 2.0**band  # l! / (2^l (l/2)!²)
            sign = -1.0 if half % 2 == 0 else 1.0
            factor = 2.0 * sign * share / ((band + 2) * (band - 1))
            coefficients[..., 0, band] = factor * (1.0 + alpha)
    axes = np.broadcast_to([0.0, 0.0, 1.0], (*alpha.shape, 1, 3))
    return Lobes(axes, albedo * coefficients)


def membrane_field(
    transparency: FloatArray, size: tuple[float, float], order: int, albedo: float = 1.0
) -> TransferField:
    """A flat patch with a translucency map.

    Args:
        transparency: α of every texel, (H, W); row 0 is at y = 0.
        size: metres along x and y.
        order: bands n.
        albedo: the part of light that is sent on.

    Raises:
        ValueError: α or the albedo is outside of [0, 1].
    """
    alpha = np.asarray(transparency, dtype=np.float64)
    vectors = membrane_lobes(alpha, order, albedo).harmonics().reshape(alpha.size, 1, -1)
    up = np.broadcast_to(np.array([0, 0, 1], dtype=np.float32), (*alpha.shape, 3))
    layout = Patch(np.zeros(alpha.shape, dtype=np.float32), up.copy(), size)
    facts = {"simulated": "membrane", "albedo": float(albedo),
             "transparency": [float(alpha.min()), float(alpha.max())]}  # fmt: skip
    return TransferField(vectors.astype(np.float32), layout, metadata=facts)
