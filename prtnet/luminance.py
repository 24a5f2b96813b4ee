"""How bright a colour is."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["REC709", "luminance"]

REC709 = np.array([0.2126, 0.7152, 0.0722])
"""Shares of linear red, green and blue in relative luminance, in double precision."""


def luminance(linear: FloatArray) -> FloatArray:
    """Relative luminance (...) of linear Rec. 709 RGB (..., 3), in its precision."""
    return linear @ REC709.astype(linear.dtype)
