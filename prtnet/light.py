"""A light as coefficients, from its name or file: what commands need of ``prtnet.environment``.

Papers:
    [1] Sloan, "Stupid Spherical Harmonics (SH) Tricks", 2008.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.environment import environment

__all__ = ["load_light"]


def load_light(name_or_path: str | Path, order: int = 4, dering: float = 0.0) -> FloatArray:
    """A light of a name or from a file.

    Args:
        name_or_path: one of ``PRESETS``, or an equirectangular picture twice as wide as high,
            Radiance ``.hdr`` or OpenEXR ``.exr``.
        order: number of bands n.
        dering: γ of the window 1/(1 + γ(l(l+1))²) [1]: above 0 it takes the ripples off a small
            bright source, at the price of a softer light. 0.01 is mild, 0.1 strong.

    Returns:
        Linear RGB radiance coefficients (n², 3) float32, world frame (right-handed, y up).

    Raises:
        PrtnetError: no such light, or the file cannot be used.
    """
    return environment(name_or_path).harmonics(order, dering).astype(np.float32)
