"""Ways to look at a character: what is shaded, with which visibility, under which light.

Windows and pictures without one draw the same of these.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.zh import Lobes, exact_lobes, relative_error
from prtnet.zh_fit import fewest_lobes, fit_lobes
from runtime.one_dimensional import above_horizon
from runtime.picture import colour_map

__all__ = [
    "cut_lobes",
    "cut_visibility",
    "heat_colours",
    "lobes_of",
    "open_visibility",
    "shaded_lobes",
    "white_light",
]

FEW_LOBES = 3  # of a colour
LOBE_ERROR = 1e-3  # relative, of the light


def lobes_of(light: FloatArray, count: int | None) -> Lobes:
    """Lobes of a light (n², 3).

    Args:
        light: coefficients of radiance.
        count: so many of each colour; 0 for as many as hold it exactly; None for the fewest that
            hold it to ``LOBE_ERROR``, or exactly if that takes more than ``FEW_LOBES``.
    """
    if count == 0:
        return exact_lobes(light.T)
    if count is not None:
        return fit_lobes(light.T, count)
    found = fewest_lobes(light.T, FEW_LOBES, LOBE_ERROR)
    return found if relative_error(light.T, found) <= LOBE_ERROR else exact_lobes(light.T)


def cut_lobes(lobes: Lobes, order: int) -> Lobes:
    """Lobes of so many bands; 0 for all there are."""
    if order == 0:
        return lobes
    kept = np.arange(lobes.coefficients.shape[-1]) < order
    return Lobes(lobes.axes, lobes.coefficients * kept)


def cut_visibility(visibility: FloatArray, order: int) -> FloatArray:
    """Visibility (V, n²) of so many bands, the others zero; 0 for all there are."""
    if order == 0 or order**2 >= visibility.shape[-1]:
        return visibility
    return np.where(np.arange(visibility.shape[-1]) < order**2, visibility, np.float32(0.0))


def open_visibility(count: int, order: int) -> FloatArray:
    """Of so many receivers that nothing hides anything from, (V, n²)."""
    visibility = np.zeros((count, order**2), dtype=np.float32)
    visibility[:, 0] = math.sqrt(4.0 * math.pi)
    return visibility


def shaded_lobes(visibility: Lobes | FloatArray, order: int) -> Lobes:
    """What a 1D BRDF is shaded with: visibility above the horizon alone, as lobes.

    Args:
        visibility: lobes (V, c), or coefficients (V, n²), which 2n − 1 lobes hold exactly.
        order: bands that are shown; 0 for all.
    """
    given = visibility if isinstance(visibility, Lobes) else exact_lobes(visibility)
    return cut_lobes(above_horizon(given), order)


def white_light(order: int) -> Lobes:
    """Radiance 1 from everywhere, as lobes of three colours."""
    return exact_lobes(np.repeat(open_visibility(1, order), 3, axis=0).astype(np.float64))


def heat_colours(errors: FloatArray, top: float) -> FloatArray:
    """Linear colours (V, 3) of vertex errors (V,), fractions; ``top`` per cent is the brightest."""
    encoded = colour_map(100.0 * errors / top) / 255.0
    return np.asarray(encoded**2.2, dtype=np.float32)
