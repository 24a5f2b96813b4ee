"""Reflectance: analytic BRDFs and measured ones, in the local frame (normal = +z, tangent = +x).

``brdf(light, view)`` takes unit directions that point away from the surface and returns f (…, 3) of
linear RGB in 1/sr, **without** the cosine; zero where either direction is below the horizon. Every
model is reciprocal. It reflects no more light than it receives where its diffuse and specular parts
are together at most 1; Schlick's does even then where it is seen at a grazing angle.
"""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError

__all__ = [
    "BRDF",
    "GGX",
    "AshikhminShirley",
    "BlinnPhong",
    "CookTorrance",
    "Lambert",
    "Phong",
    "Schlick",
    "albedo",
    "half_vector",
    "mirrored",
]

Colour = tuple[float, float, float]
TINY = 1e-12
UNIT = frozenset(("diffuse", "specular", "fresnel", "roughness", "isotropy"))  # in [0, 1]
SMOOTHEST = 1e-3  # roughness: below it a highlight is narrower than float32 tells directions apart


class BRDF(ABC):
    """A reflectance.

    Attributes:
        name: for people.
        turns: whether it stays the same when both directions turn about the normal.
        mirrors: whether it does when both are mirrored along the tangent, or across it.
    """

    name: ClassVar[str]
    turns: ClassVar[bool] = True
    mirrors: ClassVar[bool] = True

    def __call__(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """Of directions (…, 3) that broadcast: f (…, 3), float64."""
        light, view = np.asarray(light, dtype=np.float64), np.asarray(view, dtype=np.float64)
        seen = (light[..., 2] > 0) & (view[..., 2] > 0)
        value = self.above(light, view)
        return np.where(seen[..., None], value, 0.0)

    def __post_init__(self) -> None:
        """Refuse parameters that no surface has."""
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            values = np.asarray(getattr(self, field.name), dtype=np.float64)
            if not (np.isfinite(values).all() and (values >= 0.0).all()):
                raise PrtnetError(f"BRDF {self.name}", f"{field.name} must be finite, at least 0")
            if field.type == "float" and values.ndim > 0:
                raise PrtnetError(f"BRDF {self.name}", f"{field.name} is one number, no colour")
            if field.name in UNIT and (values > 1.0).any():
                raise PrtnetError(f"BRDF {self.name}", f"{field.name} must be at most 1")

    @abstractmethod
    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """The same for directions above the horizon; elsewhere finite, whatever."""


@dataclass(frozen=True)
class Angles:
    """Cosines that half-vector models are made of; each (…), above zero where it is divided by.

    Attributes:
        light, view: of the normal with either direction.
        half: of the normal with the half vector.
        between: of the half vector with either direction.
        x, y: the half vector along tangent and bitangent.
    """

    light: FloatArray
    view: FloatArray
    half: FloatArray
    between: FloatArray
    x: FloatArray
    y: FloatArray

    @property
    def sine2(self) -> FloatArray:
        """Squared sine of the half vector: exact where its cosine is all ones."""
        return self.x**2 + self.y**2


def half_vector(light: FloatArray, view: FloatArray) -> FloatArray:
    """Unit vectors (…, 3) halfway between directions (…, 3) that broadcast."""
    half = light + view
    return half / np.maximum(np.linalg.norm(half, axis=-1, keepdims=True), TINY)


def angles(light: FloatArray, view: FloatArray) -> Angles:
    """Of directions (…, 3) that broadcast."""
    half = half_vector(light, view)
    between = np.clip((half * view).sum(axis=-1), TINY, 1.0)
    light_cosine, view_cosine = (
        np.broadcast_to(np.maximum(d[..., 2], TINY), between.shape) for d in (light, view)
    )
    normal = np.clip(half[..., 2], TINY, 1.0)
    return Angles(light_cosine, view_cosine, normal, between, half[..., 0], half[..., 1])


def colour(value: Colour | float) -> FloatArray:
    """(3,) of a colour or a grey."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (3,))


def fresnel(facing: Colour | float, cosine: FloatArray) -> FloatArray:
    """(…, 3) Schlick's approximation: reflectance of a mirror seen at an angle."""
    start = colour(facing)
    return start + (1.0 - start) * ((1.0 - cosine) ** 5)[..., None]


def layered(diffuse: Colour | float, coat: FloatArray) -> FloatArray:
    """(…, 3) a diffuse base and what a coat (…, 3) adds to it."""
    return colour(diffuse) / math.pi + coat


def mirrored(direction: FloatArray) -> FloatArray:
    """Reflected about the normal."""
    return direction * np.array([-1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Lambert(BRDF):
    """Diffuse: light leaves alike in all directions."""

    name: ClassVar[str] = "lambert"
    diffuse: Colour | float = 0.8

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """A constant."""
        shape = np.broadcast_shapes(light.shape, view.shape)
        return np.broadcast_to(colour(self.diffuse) / math.pi, shape)


@dataclass(frozen=True)
class Phong(BRDF):
    """Modified Phong (Lafortune and Willems 1994): a lobe about the mirror direction."""

    name: ClassVar[str] = "phong"
    diffuse: Colour | float = 0.3
    specular: Colour | float = 0.4
    exponent: float = 20.0

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """kd/π + ks (n + 2)/2π cosⁿ; kd + ks at most 1 keeps energy."""
        along = np.clip((mirrored(light) * view).sum(axis=-1), 0.0, 1.0)
        lobe = (self.exponent + 2.0) / (2.0 * math.pi) * along**self.exponent
        return layered(self.diffuse, colour(self.specular) * lobe[..., None])


@dataclass(frozen=True)
class BlinnPhong(BRDF):
    """A lobe about the half vector, that reflects ``specular`` of light along the normal."""

    name: ClassVar[str] = "blinn-phong"
    diffuse: Colour | float = 0.3
    specular: Colour | float = 0.3
    exponent: float = 60.0

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """kd/π + ks (n + 2)(n + 4) / 8π(2^(−n/2) + n) (n·h)ⁿ (Giesen's normalisation)."""
        n = self.exponent
        scale = (n + 2.0) * (n + 4.0) / (8.0 * math.pi * (2.0 ** (-n / 2.0) + n))
        lobe = scale * angles(light, view).half ** n
        return layered(self.diffuse, colour(self.specular) * lobe[..., None])


@dataclass(frozen=True)
class Facets(BRDF):
    """Mirrors at random, each with its Fresnel reflectance, over a diffuse base."""

    diffuse: Colour | float = 0.0
    specular: Colour | float = 1.0
    roughness: float = 0.4
    fresnel: Colour | float = 0.5

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """kd/π + ks F · lobe."""
        a = angles(light, view)
        lobe = self.lobe(a, max(self.roughness, SMOOTHEST) ** 2)
        coat = colour(self.specular) * fresnel(self.fresnel, a.between) * lobe[..., None]
        return layered(self.diffuse, coat)

    @abstractmethod
    def lobe(self, a: Angles, roughness2: float) -> FloatArray:
        """(…) D G / (4 cos cos) of facets, for their roughness squared."""


@dataclass(frozen=True)
class CookTorrance(Facets):
    """Cook and Torrance 1982: Beckmann facets of a slope, V-shaped grooves, Fresnel."""

    name: ClassVar[str] = "cook-torrance"

    def lobe(self, a: Angles, roughness2: float) -> FloatArray:
        """See :class:`Facets`."""
        half2 = a.half**2
        facets = np.exp((half2 - 1.0) / (half2 * roughness2)) / (math.pi * roughness2 * half2**2)
        groove = 2.0 * a.half / a.between
        shadow = np.minimum(1.0, groove * np.minimum(a.light, a.view))
        return facets * shadow / (4.0 * a.light * a.view)


@dataclass(frozen=True)
class GGX(Facets):
    """Walter et al. 2007, with height-correlated Smith shadowing (Heitz 2014)."""

    name: ClassVar[str] = "ggx"
    roughness: float = 0.3

    def lobe(self, a: Angles, roughness2: float) -> FloatArray:
        """See :class:`Facets`."""
        # 1 + n·h² (α² − 1), of the sine.
        facets = roughness2 / (math.pi * (a.sine2 + roughness2 * a.half**2) ** 2)
        paths = [
            one * np.sqrt(roughness2 + (1.0 - roughness2) * other**2)
            for one, other in ((a.light, a.view), (a.view, a.light))
        ]
        return facets * 0.5 / (paths[0] + paths[1])


@dataclass(frozen=True)
class Schlick(BRDF):
    """Schlick 1994, "An inexpensive BRDF model": anisotropic facets, what they shadow diffuse.

    ``isotropy`` 1 is isotropic; towards 0 the surface is scratched along the tangent, and
    highlights stretch across. The ideal mirror of the paper's mixture is left out: no table of
    samples holds it. Seen at a grazing angle the model reflects more light than comes, a quarter
    more at 85 degrees, twice as much just above the horizon where it is smooth.
    """

    name: ClassVar[str] = "schlick"
    turns: ClassVar[bool] = False
    specular: Colour | float = 1.0
    roughness: float = 0.2
    isotropy: float = 0.2
    fresnel: Colour | float = 0.8

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """S(u) (G G′ Z A / 4π v v′ + (1 − G G′)/π)."""
        a = angles(light, view)
        r, p = max(self.roughness, SMOOTHEST), max(self.isotropy, SMOOTHEST)
        sine2 = a.sine2
        zenith = r / (sine2 + r * a.half**2) ** 2
        w2 = np.where(sine2 > TINY, a.x**2 / np.maximum(sine2, TINY), 0.5)
        azimuth = np.sqrt(p / (p * p * (1.0 - w2) + w2))
        reach = [c / (r - r * c + c) for c in (a.light, a.view)]
        seen = reach[0] * reach[1]
        lobe = seen * zenith * azimuth / (4.0 * math.pi * a.light * a.view) + (1.0 - seen) / math.pi
        return colour(self.specular) * fresnel(self.fresnel, a.between) * lobe[..., None]


@dataclass(frozen=True)
class AshikhminShirley(BRDF):
    """Ashikhmin and Shirley 2000: anisotropic Phong under a coat, over a diffuse base."""

    name: ClassVar[str] = "ashikhmin-shirley"
    turns: ClassVar[bool] = False
    diffuse: Colour | float = 0.4
    specular: Colour | float = 0.2
    along: float = 20.0
    across: float = 100.0

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """Their eqs. 4 and 5; exponents ``along`` the tangent and ``across`` it."""
        a = angles(light, view)
        exponent = (self.along * a.x**2 + self.across * a.y**2) / np.maximum(a.sine2, TINY)
        scale = math.sqrt((self.along + 1.0) * (self.across + 1.0)) / (8.0 * math.pi)
        lobe = scale * a.half**exponent / (a.between * np.maximum(a.light, a.view))
        coat = fresnel(self.specular, a.between) * lobe[..., None]
        through = [1.0 - (1.0 - c / 2.0) ** 5 for c in (a.light, a.view)]
        base = 28.0 / (23.0 * math.pi) * (through[0] * through[1])[..., None]
        return coat + base * colour(self.diffuse) * (1.0 - colour(self.specular))


def albedo(brdf: BRDF, view: FloatArray, rings: int = 256) -> FloatArray:
    """(…, 3) the part of light reflected, ∫ f cos dl, of light from where ``view`` (…, 3) looks.

    Midpoints of ``rings`` in the square of the sine, and four times as many angles around.
    """
    sine2 = (np.arange(rings) + 0.5) / rings
    around = 2.0 * math.pi * (np.arange(4 * rings) + 0.5) / (4 * rings)
    sine = np.sqrt(sine2)[:, None]
    up = np.broadcast_to(np.sqrt(1.0 - sine2)[:, None], (rings, 4 * rings))
    light = np.stack([sine * np.cos(around), sine * np.sin(around), up], axis=-1).reshape(-1, 3)
    flat = np.asarray(view, dtype=np.float64).reshape(-1, 3)
    total = np.stack([math.pi * brdf(light, one).mean(axis=0) for one in flat])
    return total.reshape(np.shape(view))
