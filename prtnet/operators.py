"""Linear operators on spherical-harmonic vectors in a receiver's local frame (normal = +z)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from prtnet.sh import triple_product

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray

__all__ = ["cosine_matrix"]


@lru_cache
def cosine_matrix(order: int) -> FloatArray:
    """C with C·v the coefficients of v(s)·max(s_z, 0): visibility → diffuse transfer × π.

    C_ij = Σ_k c_k Γ_ijk over the 2n − 1 bands that a product of two order-n functions reaches, so
    light·(C v) = ∫ light(s) v(s) max(s_z, 0) ds exactly, for light and visibility of order n.

    Args:
        order: number of bands n.

    Returns:
        Symmetric (n², n²) float64, read-only.
    """
    cosine = np.zeros((2 * order - 1) ** 2)
    for band in range(2 * order - 1):
        cosine[band * band + band] = _clamped_cosine(band)
    matrix = triple_product(order, order, 2 * order - 1) @ cosine
    matrix.flags.writeable = False
    return matrix


def _clamped_cosine(band: int) -> float:
    """∫ max(z, 0) y_l0 (Ramamoorthi and Hanrahan, "Irradiance Environment Maps", 2001, eq. 8)."""
    scale = math.sqrt((2 * band + 1) * math.pi)
    if band == 1:
        return scale / 3.0
    if band % 2:
        return 0.0
    sign = -1.0 if band % 4 == 0 else 1.0
    return scale * sign * math.comb(band, band // 2) / (2**band * (band + 2) * (band - 1))
