"""Named lights: soft lamps, discs and a dome of sky and ground, all known in closed form.

Every part is a zonal lobe (``prtnet.zh``), so its coefficients of any order are exact however
small and bright it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial import legendre

from prtnet.arrays import FloatArray
from prtnet.zh import Lobes

__all__ = ["PRESETS", "Disc", "Lamp", "Preset"]

Colour = tuple[float, float, float]


def direction_of(azimuth: float, elevation: float) -> FloatArray:
    """The unit vector (3,) at degrees from +z towards +x, and degrees above the horizon."""
    around, up = math.radians(azimuth), math.radians(elevation)
    flat = math.cos(up)
    return np.array([math.sin(around) * flat, math.sin(up), math.cos(around) * flat])


@dataclass(frozen=True)
class Lamp:
    """A soft round source: radiance ``colour · exp(sharpness · (cos angle − 1))``.

    Attributes:
        azimuth: degrees from +z (in front of a character) towards +x (its left).
        elevation: degrees above the horizon.
        sharpness: 8 is a large softbox; beyond 20 order 4 cannot hold it without ripples. Half the
            peak is left at about 67/√sharpness degrees from the middle.
        colour: peak radiance, linear RGB.
    """

    azimuth: float
    elevation: float
    sharpness: float
    colour: Colour

    def radiance(self, directions: FloatArray) -> FloatArray:
        """At unit directions (N, 3): (N, 3)."""
        away = directions @ direction_of(self.azimuth, self.elevation) - 1.0
        return np.exp(self.sharpness * away)[:, None] * np.array(self.colour)

    def zonal(self, order: int) -> FloatArray:
        """g*_l of a peak of 1, (n,): 2π∫e^(κ(z − 1)) P_l(z) dz = 4π e^(−κ) i_l(κ), i_l spherical.

        The modified Bessel function comes scaled by e^(−κ), so that no sharpness overflows.
        """
        from scipy.special import ive

        bessel = ive(np.arange(order) + 0.5, self.sharpness)
        return np.asarray(4.0 * math.pi * math.sqrt(math.pi / (2.0 * self.sharpness)) * bessel)


@dataclass(frozen=True)
class Disc:
    """A round light of even radiance with a soft rim.

    Attributes:
        azimuth: degrees from +z towards +x.
        elevation: degrees above the horizon.
        inner: angle from its middle, in degrees, up to which it is as bright as there.
        outer: angle at which nothing is left; in between smooth in the cosine.
        colour: radiance, linear RGB.
    """

    azimuth: float
    elevation: float
    inner: float
    outer: float
    colour: Colour

    def profile(self, cosine: FloatArray) -> FloatArray:
        """The share of the radiance at cosines of the angle to its middle."""
        inner, outer = (math.cos(math.radians(angle)) for angle in (self.inner, self.outer))
        t = np.clip((cosine - outer) / (inner - outer), 0.0, 1.0)
        return np.asarray(t * t * (3.0 - 2.0 * t))

    def radiance(self, directions: FloatArray) -> FloatArray:
        """At unit directions (N, 3): (N, 3)."""
        cosine = directions @ direction_of(self.azimuth, self.elevation)
        return self.profile(cosine)[:, None] * np.array(self.colour)

    def zonal(self, order: int) -> FloatArray:
        """g*_l of a radiance of 1, (n,)."""
        edges = [math.cos(math.radians(angle)) for angle in (self.outer, self.inner, 0.0)]
        return sum(
            (zonal_integral(self.profile, low, high, order) for low, high in pairwise(edges)),
            np.zeros(order),
        )


def zonal_integral(
    profile: Callable[[FloatArray], FloatArray], low: float, high: float, order: int
) -> FloatArray:
    """g*_l = 2π∫profile(z) P_l(z) dz, (n,), between heights where the profile is a cubic: exact."""
    nodes, weights = legendre.leggauss(order // 2 + 2)
    z = (low + high) / 2.0 + (high - low) / 2.0 * nodes
    weighted = math.pi * (high - low) * weights * profile(z)
    return np.asarray(weighted @ legendre.legvander(z, order - 1))


@dataclass(frozen=True)
class Preset:
    """Lamps, and a dome that goes smoothly from nadir over horizon to zenith; linear RGB."""

    lamps: tuple[Lamp | Disc, ...]
    zenith: Colour
    horizon: Colour
    nadir: Colour

    def radiance(self, directions: FloatArray) -> FloatArray:
        """At unit directions (N, 3): (N, 3)."""
        up = directions[:, 1:2]
        zenith, horizon, nadir = (np.array(c) for c in (self.zenith, self.horizon, self.nadir))
        dome = horizon + np.where(up > 0, (zenith - horizon) * up, (horizon - nadir) * up)
        return dome + sum(lamp.radiance(directions) for lamp in self.lamps)

    def harmonics(self, order: int) -> FloatArray:
        """Exact coefficients (n², 3) float64."""
        axes = [direction_of(lamp.azimuth, lamp.elevation) for lamp in self.lamps]
        zonal = [np.outer(lamp.colour, lamp.zonal(order)) for lamp in self.lamps]
        # The dome mixes the horizon with the zenith or the nadir by the sine of the elevation.
        above = zonal_integral(lambda z: z, 0.0, 1.0, order)
        below = zonal_integral(lambda z: -z, -1.0, 0.0, order)
        everywhere = zonal_integral(np.ones_like, -1.0, 1.0, order)
        axes.append(np.array([0.0, 1.0, 0.0]))
        zonal.append(
            np.outer(self.zenith, above)
            + np.outer(self.nadir, below)
            + np.outer(self.horizon, everywhere - above - below)
        )
        lobes = Lobes(np.stack(axes), np.stack(zonal, axis=1))  # coefficients [3, N, n]
        return lobes.harmonics().T


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
    "sun": Preset(  # 3° across; order 4 rings without deringing
        lamps=(Lamp(-35.0, 50.0, 2000.0, (1650.0, 1500.0, 1270.0)),),
        zenith=(0.2, 0.36, 0.72),
        horizon=(0.5, 0.58, 0.7),
        nadir=(0.2, 0.18, 0.15),
    ),
    "area": Preset(  # a round ceiling light
        lamps=(Disc(0.0, 90.0, 25.0, 40.0, (4.2, 4.0, 3.7)),),
        zenith=(0.06, 0.06, 0.07),
        horizon=(0.1, 0.1, 0.1),
        nadir=(0.07, 0.06, 0.05),
    ),
}
