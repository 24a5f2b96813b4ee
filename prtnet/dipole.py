"""Multiple scattering under a surface: the dipole of Jensen, Marschner, Levoy and Hanrahan [1].

    R_d(r) = α'/4π Σ_{z = z_r, z_v} z (σ_tr + 1/d) e^{−σ_tr d} / d²,  d² = r² + z²

is the light that leaves at a distance r for a unit of light that enters (1/m²). Its integral over
a disc has a closed form, and so has that over the plane, the diffuse reflectance. Fresnel factors
of light and view at the surface are left out: what is simulated stays diffuse. Reflection on the
inside is in the boundary's A.

[1] "A Practical Model for Subsurface Light Transport", SIGGRAPH 2001, section 2.3 and figure 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError, nearest_name

__all__ = ["MATERIALS", "Medium", "medium_named"]

MILLIMETRE = 1e-3


@dataclass(frozen=True)
class Medium:
    """What scatters.

    Attributes:
        scattering: reduced scattering coefficient σ_s', 1/m.
        absorption: σ_a, 1/m.
        index: of refraction η.
    """

    scattering: float
    absorption: float
    index: float = 1.3

    def __post_init__(self) -> None:
        """Refuse what no medium has."""
        numbers = (self.scattering, self.absorption, self.index)
        if not all(math.isfinite(one) for one in numbers) or not (
            self.scattering > 0 and self.absorption >= 0 and 1 <= self.index <= 3
        ):
            raise PrtnetError(
                "--subsurface",
                "needs scattering above 0, absorption of at least 0 and an index from 1 to 3",
            )

    @property
    def extinction(self) -> float:
        """Reduced extinction σ_t', 1/m."""
        return self.scattering + self.absorption

    @property
    def albedo(self) -> float:
        """Reduced albedo α'."""
        return self.scattering / self.extinction

    @property
    def transport(self) -> float:
        """Effective transport coefficient σ_tr, 1/m: light fades by e over 1/σ_tr."""
        return math.sqrt(3.0 * self.absorption * self.extinction)

    @property
    def boundary(self) -> float:
        """A of the boundary condition, from the diffuse Fresnel reflectance F_dr."""
        eta = self.index
        inside = -1.440 / eta**2 + 0.710 / eta + 0.668 + 0.0636 * eta
        if eta == 1.0:
            inside = 0.0  # the fit gives 0.0016
        return (1.0 + inside) / (1.0 - inside)

    @property
    def depths(self) -> tuple[float, float]:
        """Of the real source below the surface, z_r, and the virtual one above it, z_v; metres."""
        real = 1.0 / self.extinction
        return real, real * (1.0 + 4.0 / 3.0 * self.boundary)

    def reflectance(self) -> float:
        """R_d over the whole plane, in closed form [1, section 2.4]."""
        root = math.sqrt(3.0 * (1.0 - self.albedo))
        inner = math.exp(-4.0 / 3.0 * self.boundary * root)
        return 0.5 * self.albedo * (1.0 + inner) * math.exp(-root)

    def profile(self, distance: FloatArray) -> FloatArray:
        """R_d (...) of distances (...) in metres."""
        r2 = np.asarray(distance, dtype=np.float64) ** 2
        total = np.zeros_like(r2)
        for z in self.depths:
            d = np.sqrt(r2 + z * z)
            total += z * (self.transport + 1.0 / d) * np.exp(-self.transport * d) / (d * d)
        return self.albedo / (4.0 * math.pi) * total

    def beyond(self, radius: FloatArray) -> FloatArray:
        """∫ R_d over the plane outside of discs with these radii (...), metres.

        r dr = d dd turns each pole's integral into −z [e^{−σ_tr d} / d].
        """
        r2 = np.asarray(radius, dtype=np.float64) ** 2
        total = np.zeros_like(r2)
        for z in self.depths:
            d = np.sqrt(r2 + z * z)
            total += z * np.exp(-self.transport * d) / d
        return 0.5 * self.albedo * total

    def within(self, radius: FloatArray) -> FloatArray:
        """∫ R_d over discs with these radii (...), metres."""
        return float(self.beyond(np.zeros(()))) - self.beyond(radius)

    def reach(self, share: float) -> float:
        """The radius of the disc outside of which ``share`` of the reflectance leaves, metres."""
        goal = share * float(self.beyond(np.zeros(())))
        low, high = 0.0, self.depths[0]
        while float(self.beyond(np.asarray(high))) > goal:
            low, high = high, 2.0 * high
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (
                (middle, high) if float(self.beyond(np.asarray(middle))) > goal else (low, middle)
            )
        return high


def measured(scattering: float, absorption: float, index: float = 1.3) -> Medium:
    """A medium of [1, figure 5], whose numbers are per millimetre, of green light."""
    return Medium(scattering / MILLIMETRE, absorption / MILLIMETRE, index)


MATERIALS: dict[str, Medium] = {
    "apple": measured(2.39, 0.0034),
    "chicken": measured(0.21, 0.077),
    "cream": measured(5.47, 0.0028),
    "ketchup": measured(0.07, 0.97),
    "marble": measured(2.62, 0.0041, 1.5),
    "milk": measured(3.21, 0.0024),
    "potato": measured(0.70, 0.0090),
    "skimmed-milk": measured(1.22, 0.0025),
    "skin": measured(0.88, 0.17),
}


def medium_named(text: str) -> Medium:
    """A material of the list, or ``SCATTERING/ABSORPTION`` or ``…/…/INDEX``, per millimetre.

    Raises:
        PrtnetError: it is neither, or no medium has such numbers.
    """
    if text in MATERIALS:
        return MATERIALS[text]
    try:
        numbers = [float(part) for part in text.split("/")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        what = f"'{text}' is neither a medium nor SCATTERING/ABSORPTION per millimetre"
        raise PrtnetError("--subsurface", f"{what}; {nearest_name(text, MATERIALS)}")
    return measured(*numbers)
