"""Environment lights as spherical-harmonic coefficients of radiance: named presets and HDR files.

An equirectangular picture wraps the world as in three.js and the glTF sample viewer: its top row is
+y, and from its left edge to its right one columns look along −x, −z (a quarter), +x (the middle),
+z (three quarters) and −x again. A texel (row r, column c) of an H × W picture looks along

    (−sin θ cos φ, cos θ, −sin θ sin φ),   θ = π (r + ½)/H,   φ = 2π (c + ½)/W.

Papers:
    [1] Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps",
        2001.
    [2] Sloan, "Stupid Spherical Harmonics (SH) Tricks", 2008.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError, nearest_name
from prtnet.hdr import read_hdr
from prtnet.sh import bands, evaluate, project_function, window
from prtnet.sh_rotation import rotate

__all__ = ["PRESETS", "load_light", "project_equirectangular"]


@dataclass(frozen=True)
class Lamp:
    """A soft round source: radiance ``colour · exp(sharpness · (cos angle − 1))``.

    Attributes:
        azimuth: degrees from +z (in front of a character) towards +x (its left).
        elevation: degrees above the horizon.
        sharpness: 8 is a large softbox; beyond 20 order 4 cannot hold it without ripples.
        colour: peak radiance, linear RGB.
    """

    azimuth: float
    elevation: float
    sharpness: float
    colour: tuple[float, float, float]

    def radiance(self, directions: FloatArray) -> FloatArray:
        """At unit directions (N, 3): (N, 3)."""
        azimuth, elevation = math.radians(self.azimuth), math.radians(self.elevation)
        flat = math.cos(elevation)
        axis = [math.sin(azimuth) * flat, math.sin(elevation), math.cos(azimuth) * flat]
        return np.exp(self.sharpness * (directions @ axis - 1.0))[:, None] * np.array(self.colour)


@dataclass(frozen=True)
class Preset:
    """Lamps, and a dome that goes smoothly from nadir over horizon to zenith; linear RGB."""

    lamps: tuple[Lamp, ...]
    zenith: tuple[float, float, float]
    horizon: tuple[float, float, float]
    nadir: tuple[float, float, float]

    def radiance(self, directions: FloatArray) -> FloatArray:
        """At unit directions (N, 3): (N, 3)."""
        up = directions[:, 1:2]
        zenith, horizon, nadir = (np.array(c) for c in (self.zenith, self.horizon, self.nadir))
        dome = horizon + np.where(up > 0, (zenith - horizon) * up, (horizon - nadir) * up)
        return dome + sum(lamp.radiance(directions) for lamp in self.lamps)


PRESETS = {
    "studio": Preset(
        lamps=(
            Lamp(-40.0, 45.0, 7.0, (5.4, 4.9, 4.2)),
            Lamp(95.0, 5.0, 5.0, (0.3, 0.42, 0.62)),
            Lamp(150.0, 40.0, 7.0, (1.3, 1.5, 1.9)),
        ),
        zenith=(0.12, 0.13, 0.15),
        horizon=(0.09, 0.09, 0.1),
        nadir=(0.05, 0.045, 0.04),
    ),
    "sky": Preset(
        lamps=(Lamp(-50.0, 55.0, 8.0, (5.6, 5.0, 4.0)),),
        zenith=(0.16, 0.32, 0.68),
        horizon=(0.34, 0.44, 0.6),
        nadir=(0.18, 0.15, 0.11),
    ),
    "sunset": Preset(
        lamps=(
            Lamp(-65.0, 14.0, 7.0, (6.4, 3.0, 1.15)),
            Lamp(-65.0, 5.0, 3.0, (0.8, 0.3, 0.15)),
        ),
        zenith=(0.12, 0.16, 0.38),
        horizon=(0.3, 0.22, 0.3),
        nadir=(0.08, 0.06, 0.06),
    ),
    "overcast": Preset(  # the CIE overcast sky: the zenith three times as bright as the horizon
        lamps=(),
        zenith=(1.2, 1.24, 1.3),
        horizon=(0.4, 0.413, 0.433),
        nadir=(0.12, 0.12, 0.11),
    ),
    "top": Preset(
        lamps=(Lamp(0.0, 90.0, 6.0, (5.0, 4.9, 4.7)),),
        zenith=(0.1, 0.1, 0.11),
        horizon=(0.08, 0.08, 0.09),
        nadir=(0.03, 0.03, 0.03),
    ),
    "window": Preset(
        lamps=(Lamp(-75.0, 15.0, 6.0, (4.6, 4.9, 5.4)),),
        zenith=(0.07, 0.07, 0.07),
        horizon=(0.08, 0.07, 0.06),
        nadir=(0.06, 0.05, 0.04),
    ),
}

HDR_SUFFIXES = (".hdr", ".pic", ".rgbe")
BRIGHTEST = 1e30  # products with transfer must still be 32-bit floats
BLOCK = 64  # rows of a picture at a time


def load_light(name_or_path: str | Path, order: int = 4, dering: float = 0.0) -> FloatArray:
    """A light of a name or from a Radiance .hdr file.

    Args:
        name_or_path: one of ``PRESETS``, or an equirectangular picture twice as wide as high.
        order: number of bands n.
        dering: γ of the window 1/(1 + γ(l(l+1))²) [2]: above 0 it takes the ripples off a small
            bright source, at the price of a softer light. 0.01 is mild, 0.1 strong.

    Returns:
        Linear RGB radiance coefficients (n², 3) float32, world frame (right-handed, y up).

    Raises:
        PrtnetError: no such light, or the file cannot be used.
    """
    name = str(name_or_path)
    if name in PRESETS:
        light = project_function(PRESETS[name].radiance, order)
    elif Path(name).suffix.lower() in HDR_SUFFIXES or Path(name).exists():
        light = project_equirectangular(equirectangular(name), order)
    else:
        known = nearest_name(name, PRESETS)
        raise PrtnetError("--light", f"'{name}' is neither a file nor a preset; {known}")
    if not np.abs(light).max() < BRIGHTEST:
        raise PrtnetError(name, "is too bright to compute with; scale it down")
    return (light * window(order, dering)[:, None]).astype(np.float32)


def equirectangular(path: str) -> FloatArray:
    """The picture of a file, checked to be a whole sphere."""
    picture = read_hdr(path)
    height, width = picture.shape[:2]
    if width != 2 * height:
        raise PrtnetError(path, f"is {width}x{height}; a light must be twice as wide as high")
    return picture


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
