"""Directions drawn from where a light is bright, with their density: lamps, skies and pictures.

Each emitter draws as often as its radiance says, in luminance, but for smooth factors. A light of
several parts is drawn part by part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.axis_frames import frame_about
from prtnet.environment import Environment
from prtnet.equirectangular import Picture
from prtnet.luminance import REC709
from prtnet.presets import Disc, Lamp, Preset, direction_of
from prtnet.sampling import Cells, around, linear

__all__ = ["Cap", "Dome", "Emitter", "Panorama", "SoftLobe", "Turned", "emitters"]


class Emitter(Protocol):
    """A part of a light."""

    @property
    def power(self) -> float:
        """About ∫ radiance ds, in luminance."""
        ...

    def draw(self, u: FloatArray) -> FloatArray:
        """Unit directions (N, 3) of random numbers (N, 2) in [0, 1)."""
        ...

    def density(self, directions: FloatArray) -> FloatArray:
        """Of being drawn (N,), 1/sr, at unit directions (N, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class SoftLobe:
    """A ``Lamp`` along +z: exp(κ(cos − 1)), exactly."""

    sharpness: float
    luminance: float

    @property
    def scale(self) -> float:
        """∫exp(κ(z − 1)) ds."""
        return -2.0 * math.pi * math.expm1(-2.0 * self.sharpness) / self.sharpness

    @property
    def power(self) -> float:
        """See :class:`Emitter`."""
        return self.luminance * self.scale

    def draw(self, u: FloatArray) -> FloatArray:
        """The inverse of the share of all that is within a height."""
        drop = -np.log1p(u[:, 0] * math.expm1(-2.0 * self.sharpness)) / self.sharpness
        return around(np.minimum(drop, 2.0), 2.0 * math.pi * u[:, 1])

    def density(self, directions: FloatArray) -> FloatArray:
        """See :class:`Emitter`."""
        return np.asarray(np.exp(self.sharpness * (directions[:, 2] - 1.0)) / self.scale)


@dataclass(frozen=True, eq=False)
class Cap:
    """A ``Disc`` along +z, evenly: its soft rim is brought out by the radiance."""

    height: float  # 1 − cos of its radius
    luminance: float

    @property
    def power(self) -> float:
        """See :class:`Emitter`."""
        return self.luminance * 2.0 * math.pi * self.height

    def draw(self, u: FloatArray) -> FloatArray:
        """Even in height."""
        return around(self.height * u[:, 0], 2.0 * math.pi * u[:, 1])

    def density(self, directions: FloatArray) -> FloatArray:
        """See :class:`Emitter`."""
        inside = 1.0 - directions[:, 2] <= self.height
        return np.where(inside, 1.0 / (2.0 * math.pi * self.height), 0.0)


@dataclass(frozen=True, eq=False)
class Dome:
    """Sky and ground about +z, linear in height on either side of the horizon; in luminance."""

    nadir: float
    horizon: float
    zenith: float

    @property
    def power(self) -> float:
        """See :class:`Emitter`."""
        return math.pi * (self.nadir + 2.0 * self.horizon + self.zenith)

    def draw(self, u: FloatArray) -> FloatArray:
        """Sky or ground, then how far from the horizon."""
        sky = math.pi * (self.horizon + self.zenith) / self.power
        above = u[:, 0] < sky
        share = np.where(
            above, u[:, 0] / max(sky, 1e-300), (u[:, 0] - sky) / max(1.0 - sky, 1e-300)
        )
        end = np.where(above, self.zenith, self.nadir)
        height = linear(np.full(len(u), self.horizon), end, share)
        return around(1.0 - np.where(above, height, -height), 2.0 * math.pi * u[:, 1])

    def density(self, directions: FloatArray) -> FloatArray:
        """See :class:`Emitter`."""
        z = directions[:, 2]
        end = np.where(z > 0.0, self.zenith, self.nadir)
        return np.asarray((self.horizon + (end - self.horizon) * np.abs(z)) / self.power)


@dataclass(frozen=True, eq=False)
class Panorama:
    """A picture of the whole sphere: as bright as it is between the middles of its texels.

    Attributes:
        grey: luminance, (H, W, 1), at least 0.
    """

    grey: FloatArray

    @cached_property
    def rows(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Of the H + 1 rows of cells between middles: tops, heights, and sin θ in their middles.

        In texels, from the north pole; the first row and the last are half as high.
        """
        height = len(self.grey)
        edges = np.clip(np.arange(height + 2) - 0.5, 0.0, height)
        middle = (edges[1:] + edges[:-1]) / 2.0
        return edges[:-1], np.diff(edges), np.sin(math.pi * middle / height)

    @cached_property
    def weights(self) -> FloatArray:
        """(H + 1, W) of cells: mean luminance times about their solid angle, in texels."""
        _, tall, sine = self.rows
        padded = np.pad(self.grey[..., 0], ((1, 1), (0, 0)), mode="edge")
        down = padded[1:] + padded[:-1]
        return np.asarray((down + np.roll(down, -1, axis=1)) * (tall * sine / 4.0)[:, None])

    @cached_property
    def cells(self) -> Cells:
        """To draw from."""
        return Cells(self.weights[None])

    @cached_property
    def total(self) -> float:
        """Sum of all weights."""
        return float(self.weights.sum())

    @property
    def power(self) -> float:
        """See :class:`Emitter`."""
        height, width = self.grey.shape[:2]
        return self.total * 2.0 * math.pi**2 / (height * width)

    def draw(self, u: FloatArray) -> FloatArray:
        """A cell, then linearly down it, then linearly across."""
        height, width = self.grey.shape[:2]
        row, column, left = self.cells.draw(np.zeros(len(u), dtype=np.int64), u)
        upper, lower, beside = np.maximum(row - 1, 0), np.minimum(row, height - 1), column + 1
        a, b, c, d = (self.grey[r, k % width, 0] for r in (upper, lower) for k in (column, beside))
        down = linear(a + b, c + d, left[:, 0])
        across = linear(a + (c - a) * down, b + (d - b) * down, left[:, 1])
        tops, tall, _ = self.rows
        theta = math.pi / height * (tops[row] + tall[row] * down)
        phi = 2.0 * math.pi / width * (column + 0.5 + across)
        sine = np.sin(theta)
        return np.stack([-sine * np.cos(phi), np.cos(theta), -sine * np.sin(phi)], axis=1)

    def density(self, directions: FloatArray) -> FloatArray:
        """See :class:`Emitter`."""
        height, width = self.grey.shape[:2]
        sine = np.hypot(directions[:, 0], directions[:, 2])
        theta = np.arctan2(sine, directions[:, 1])
        row = np.floor(theta * (height / math.pi) + 0.5).astype(np.int64)
        grey = Picture(self.grey).radiance(directions)[:, 0]
        texels = height * width / (2.0 * math.pi**2)  # in a unit of θ and φ
        weight = grey * self.rows[2][np.clip(row, 0, height)] / max(self.total, 1e-300)
        return np.asarray(weight * texels / np.maximum(sine, 1e-12))


@dataclass(frozen=True, eq=False)
class Turned:
    """An emitter, turned by a rotation R (3, 3)."""

    emitter: Emitter
    rotation: FloatArray

    @property
    def power(self) -> float:
        """See :class:`Emitter`."""
        return self.emitter.power

    def draw(self, u: FloatArray) -> FloatArray:
        """See :class:`Emitter`."""
        return self.emitter.draw(u) @ self.rotation.T

    def density(self, directions: FloatArray) -> FloatArray:
        """See :class:`Emitter`."""
        return self.emitter.density(directions @ self.rotation)


def emitters(light: Environment) -> list[Emitter]:
    """The parts of a light that shine, to draw directions from.

    Empty where the light is black, or of a source that is neither a preset nor a picture.
    """
    source = light.source
    if isinstance(source, Picture):
        found: list[Emitter] = [Panorama((np.abs(source.texels) @ REC709)[..., None])]
    elif isinstance(source, Preset):
        grey = [float(np.dot(c, REC709)) for c in (source.nadir, source.horizon, source.zenith)]
        found = [Turned(Dome(*grey), frame_about(np.array([0.0, 1.0, 0.0])))]
        found += [emitter_of(lamp) for lamp in source.lamps]
    else:
        found = []
    return [Turned(one, light.rotation) for one in found if one.power > 0.0]


def emitter_of(lamp: Lamp | Disc) -> Emitter:
    """To draw from a lamp of a preset."""
    luminance = float(np.dot(lamp.colour, REC709))
    shape: Emitter
    if isinstance(lamp, Disc):
        shape = Cap(2.0 * math.sin(math.radians(lamp.outer) / 2.0) ** 2, luminance)
    else:
        shape = SoftLobe(lamp.sharpness, luminance)
    return Turned(shape, frame_about(direction_of(lamp.azimuth, lamp.elevation)))
