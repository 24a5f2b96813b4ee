"""Linear operators on spherical-harmonic vectors in a receiver's local frame (normal = +z)."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from prtnet.phong import phong_matrix

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray

__all__ = ["cosine_matrix"]


@lru_cache
def cosine_matrix(order: int) -> FloatArray:
    """C with C·v the coefficients of v(s)·max(s_z, 0): visibility → diffuse transfer × π.

    The Phong operator of exponent 1: light·(C v) = ∫ light(s) v(s) max(s_z, 0) ds exactly, for
    light and visibility of order n.

    Args:
        order: number of bands n.

    Returns:
        Symmetric (n², n²) float64, read-only.
    """
    matrix = phong_matrix(np.float64(1.0), order)
    matrix.flags.writeable = False
    return matrix
