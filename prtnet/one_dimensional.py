"""The material ``lobe``: a 1D BRDF, a Phong lobe about the mirrored view [1].

It is symmetric about one axis and holds the cosine of the rendering equation already. Visibility as
zonal lobes gets into the frame of that axis by turning theirs, so nothing is tabulated, and the
exponent may change from frame to frame: ``runtime.one_dimensional``.

Papers:
    [1] Nowrouzezahrai, Kalogerakis, Simari and Fiume, "Shadowed Relighting of Dynamic Geometry with
        1D BRDFs", 2008, section 4.
    [2] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, TINY, colour, layered, mirrored
from prtnet.errors import PrtnetError

__all__ = ["OneDimensional"]

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class OneDimensional(BRDF):
    """A normalised Phong lobe over a diffuse, translucent membrane; linear RGB, or greys.

    No light is made where the three together are at most 1. As a BRDF it is what the front
    reflects, and not reciprocal.

    Attributes:
        diffuse: part of the light from the front that leaves the front diffusely.
        specular: part that the lobe about the mirrored view reflects.
        exponent: of the lobe, any real α ≥ 0.
        transmitted: part of the light from behind that leaves the front; the α of [2, eq. 22]
            times its albedo.
    """

    name: ClassVar[str] = "lobe"
    diffuse: Colour | float = 0.3
    specular: Colour | float = 0.4
    exponent: float = 20.0
    transmitted: Colour | float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no surface has."""
        super().__post_init__()
        if (np.asarray(self.transmitted) > 1.0).any():
            raise PrtnetError(f"BRDF {self.name}", "transmitted must be at most 1")

    @property
    def lets_light_through(self) -> bool:
        """Whether any light from behind leaves the front."""
        return bool(np.any(self.transmitted))

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """As of any BRDF: its cosine is taken out again."""
        cosine = (light * mirrored(view)).sum(axis=-1)
        with np.errstate(under="ignore"):
            lobe = np.where(cosine > 0.0, np.maximum(cosine, 0.0) ** self.exponent, 0.0)
        lobe = lobe * ((self.exponent + 1.0) / (2.0 * math.pi)) / np.maximum(light[..., 2], TINY)
        return layered(self.diffuse, colour(self.specular) * lobe[..., None])
