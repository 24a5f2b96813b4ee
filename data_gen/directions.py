"""Ways to draw rays above a receiver, and how they are weighed against each other.

Of several ways that draw n_k directions of density p_k each, whatever one of them drew counts
f / Σ_k n_k p_k, the balance heuristic [1]: right on average wherever one of them may draw, and
about as good as the best of them.

[1] Veach, Guibas. "Optimally combining sampling techniques for Monte Carlo rendering". 1995.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.brdf import BRDF, Lambert
from prtnet.brdf_sampling import BRDFSampler, brdf_sampler
from prtnet.emission import Emitter, emitters
from prtnet.environment import Environment
from prtnet.sampling import around, cosine_hemisphere, lattice, shares

__all__ = ["Aimed", "Light", "Places", "Plan", "Sampling", "Way", "plan"]

Sampling = Literal["uniform", "light", "brdf", "mixed"]
Light = Environment | Callable[[FloatArray], FloatArray]
EVEN = 0.25  # of the rays that are a BRDF's: for what its table misses


@dataclass(frozen=True, eq=False)
class Places:
    """Receivers that are looked at.

    Attributes:
        frames: columns tangent, bitangent, normal, (N, 3, 3) float64.
        view: to the eye, above the horizon, in those frames, (N, 3).
    """

    frames: FloatArray
    view: FloatArray

    def at(self, index: IntArray | slice) -> Places:
        """Some of them, or with repetition."""
        return Places(self.frames[index], self.view[index])

    def world(self, local: FloatArray) -> FloatArray:
        """A direction of each, (N, 3), out of its frame."""
        return np.einsum("nij,nj->ni", self.frames, local)


@dataclass(frozen=True, eq=False)
class Aimed:
    """Directions above the horizon, one at every place.

    Attributes:
        places: N of them.
        world: directions (N, 3), world space.
        local: the same in the places' frames.
    """

    places: Places
    world: FloatArray
    local: FloatArray


class Way(Protocol):
    """A way to draw directions."""

    def draw(self, places: Places, u: FloatArray, /) -> FloatArray:
        """A direction (N, 3) at every place, world space, of random numbers (N, 2)."""
        ...

    def density(self, aimed: Aimed, /) -> FloatArray:
        """Of being drawn (N,), 1/sr."""
        ...


@dataclass(frozen=True, eq=False)
class Uniform:
    """All directions above the horizon alike."""

    def draw(self, places: Places, u: FloatArray) -> FloatArray:
        """See :class:`Way`."""
        return places.world(around(u[:, 0], 2.0 * math.pi * u[:, 1]))

    def density(self, aimed: Aimed) -> FloatArray:
        """See :class:`Way`."""
        return np.full(len(aimed.local), 1.0 / (2.0 * math.pi))


@dataclass(frozen=True, eq=False)
class Cosine:
    """As a diffuse surface reflects."""

    def draw(self, places: Places, u: FloatArray) -> FloatArray:
        """See :class:`Way`."""
        return places.world(cosine_hemisphere(u))

    def density(self, aimed: Aimed) -> FloatArray:
        """See :class:`Way`."""
        return aimed.local[:, 2] / math.pi


@dataclass(frozen=True, eq=False)
class Shining:
    """Where a part of the light is."""

    emitter: Emitter

    def draw(self, _places: Places, u: FloatArray) -> FloatArray:
        """See :class:`Way`."""
        return self.emitter.draw(u)

    def density(self, aimed: Aimed) -> FloatArray:
        """See :class:`Way`."""
        return self.emitter.density(aimed.world)


@dataclass(frozen=True, eq=False)
class Reflecting:
    """Where a BRDF's table says that the eye sees it from."""

    sampler: BRDFSampler

    def draw(self, places: Places, u: FloatArray) -> FloatArray:
        """See :class:`Way`."""
        return places.world(self.sampler.draw(places.view, u))

    def density(self, aimed: Aimed) -> FloatArray:
        """See :class:`Way`."""
        return self.sampler.density(aimed.local, aimed.places.view)


@dataclass(frozen=True, eq=False)
class Plan:
    """Ways, and how many rays of a receiver each draws."""

    ways: Sequence[Way]
    counts: Sequence[int]

    @property
    def rays(self) -> int:
        """Of a receiver."""
        return sum(self.counts)

    def draw(self, places: Places, shifts: FloatArray) -> FloatArray:
        """Directions (N, rays, 3) at N places, world space.

        Args:
            places: N of them.
            shifts: of every way's lattice of random numbers, at every place, (N, ways, 2).
        """
        found = []
        for index, (way, count) in enumerate(zip(self.ways, self.counts, strict=True)):
            u = (lattice(count) + shifts[:, index, None]) % 1.0  # [N, count, 2]
            every = places.at(np.repeat(np.arange(len(shifts)), count))
            found.append(way.draw(every, u.reshape(-1, 2)).reshape(*u.shape[:2], 3))
        return np.concatenate(found, axis=1)

    def density(self, aimed: Aimed) -> FloatArray:
        """Σ_k n_k p_k (N,)."""
        pairs = zip(self.ways, self.counts, strict=True)
        parts = [count * way.density(aimed) for way, count in pairs]
        return np.asarray(sum(parts))


def plan(light: Light, brdf: BRDF, rays: int, sampling: Sampling) -> Plan:
    """How to spend rays on a receiver.

    Args:
        light: a light, or radiance by direction: of that it is not known where it is bright.
        brdf: of the surface.
        rays: in all; one for every way at least.
        sampling: ``uniform``, by ``light`` or ``brdf`` alone, or half of either, ``mixed``.
    """
    bright = emitters(light) if isinstance(light, Environment) else []
    shining: list[tuple[Way, float]] = [(Shining(one), one.power) for one in bright]
    even: list[tuple[Way, float]] = [(Uniform(), 1.0)]
    reflecting: list[tuple[Way, float]] = [(Cosine(), 1.0)]
    if not isinstance(brdf, Lambert):
        reflecting = [(Uniform(), EVEN), (Reflecting(brdf_sampler(brdf)), 1.0 - EVEN)]
    groups = {
        "uniform": [even],
        "light": [shining or even],
        "brdf": [reflecting],
        "mixed": [shining or even, reflecting],
    }[sampling]
    pairs = [
        (way, weight / sum(w for _, w in group) / len(groups))
        for group in groups for way, weight in group
    ]  # fmt: skip
    counts = shares(np.array([weight for _, weight in pairs]), rays)
    return Plan([way for way, _ in pairs], counts.tolist())
