"""Light between the points of a surface: what arrives directly, and over bounces.

All functions of distant light are harmonics in one frame, the surface's. With X the irradiance of
every point over π, as functions of that light:

    X = X₀ + H B,    B = exit(X)

X₀ is what arrives directly: the clamped cosine, exactly, minus what rays find hidden. H gathers the
exit radiance B over the same rays, the hit triangles' corners by their barycentric weights; its
rows sum to the part of the sky, by the cosine, that is hidden by front faces. A matte surface has
exit(X) = albedo · X, so bounces shrink by the albedo at least, and end. Where albedo 1 is enclosed
they never do: that is told.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse

from data_gen.casters import Caster, Hits, caster_of
from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.console import Report, silent
from prtnet.cores import lasting_threads
from prtnet.exchange import Given, Result, exchange
from prtnet.kept import keeps_last
from prtnet.sh_rotation import rotate

__all__ = ["Bounces", "Gathering", "bounce", "gather", "unit_irradiance"]

BATCH = 1 << 17  # rays at a time
PARTS = 4  # of so many rays, where others trace them
CSR = ("data", "indices", "indptr")
NOTHING = 1e-9  # of the most exit radiance: less is rounding
STEADY = 1e-6  # a bounce that shrinks by less does not shrink
UNIFORM = math.sqrt(4.0 * math.pi)  # ∫ of light 1 from all around, by its first coefficient

Exit = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Gathering:
    """Weighted sums over the sky of every point, one for each of F functions.

    Attributes:
        direct: of light that nothing hides, in the surface's frame, (K, F, n²) float64.
        hidden: of exit radiance of the points that hide it, F sparse matrices (K, K).
    """

    direct: FloatArray
    hidden: list[scipy.sparse.csr_array]


@dataclass
class Bounces:
    """What became of the energy, for light 1 from all around.

    Attributes:
        energy: exit radiance that each bounce adds, the surface's mean; direct light first.
        largest: the same of the point that gets most: each at most the albedo times the one before.
        left: bound of what further bounces would add anywhere, as a share of the largest exit
            radiance; infinite where bounces do not shrink.
        diverges: whether they do not.
    """

    energy: list[float] = field(default_factory=list)
    largest: list[float] = field(default_factory=list)
    left: float = 0.0
    diverges: bool = False

    def facts(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {
            "bounces": len(self.energy) - 1,
            "energy": self.energy,
            "left": self.left if math.isfinite(self.left) else None,
            "diverges": self.diverges,
        }


def unit_irradiance(order: int) -> FloatArray:
    """The clamped cosine over π in a local frame, (n²,): X of a point that sees all of its sky."""
    zonal = np.zeros(order**2)
    z, weight = np.polynomial.legendre.leggauss(order + 1)
    z, weight = (z + 1.0) / 2.0, weight / 2.0  # on [0, 1], where the cosine is a polynomial
    up = np.stack([np.sqrt(1.0 - z * z), 0.0 * z, z], axis=1)
    every = 2.0 * (weight * z) @ sh.evaluate(up, order)
    band = np.arange(order)
    zonal[band * (band + 1)] = every[band * (band + 1)]
    return zonal


def gather(
    caster: Caster,
    order: int,
    rays: int,
    functions: Callable[[FloatArray], FloatArray] | None = None,
    open_sky: FloatArray | None = None,
    threads: int = 1,
    report: Report = silent,
) -> Gathering:
    """Cast rays over the hemisphere of every point.

    Args:
        caster: the points.
        order: bands n.
        rays: of every point, a spherical Fibonacci hemisphere.
        functions: F weights (F, R) of directions (R, 3) in local frames, per steradian; the cosine
            over π when not given.
        open_sky: the functions' exact harmonics, (F, n²).
        threads: that trace.
        report: of progress.
    """
    local = sh.fibonacci_hemisphere(rays)
    if functions is None or open_sky is None:
        values, open_sky = local[None, :, 2] / math.pi, unit_irradiance(order)[None]
    else:
        values = functions(local)
    step = max(1, BATCH // rays)
    parts = -(-len(caster) // step)

    def told(done: int) -> None:
        report("rays", min(done * step, len(caster)), len(caster))

    place = exchange()
    if place is not None:
        given = {"values": values, "open_sky": open_sky, **caster.arrays()}
        work = GatherBlock(type(caster).__name__, order, rays, step)
        pieces = -(-parts // PARTS)
        results = place.ordered(work, given, pieces, lambda done: told(done * PARTS))
        found = [unpacked(arrays, len(values), len(caster)) for _, arrays in results]
    else:
        sky = Sky(caster, order, values, open_sky)
        found = []
        gathered = lasting_threads(threads).map(sky, slices(len(caster), step))
        for done, one in enumerate(gathered, 1):
            found.append(one)
            told(done)
    direct, hidden = together(found)
    return Gathering(direct, hidden)


Part = tuple[FloatArray, list[scipy.sparse.csr_array]]  # as Gathering has them, of some points


class Sky:
    """What the rays of points sum up to, as :func:`gather` has it.

    Args:
        caster: the points.
        order: bands n.
        values: of F functions along the rays, per steradian, (F, R).
        open_sky: the functions' exact harmonics, (F, n²).
    """

    def __init__(
        self, caster: Caster, order: int, values: FloatArray, open_sky: FloatArray
    ) -> None:
        rays = values.shape[1]
        local = sh.fibonacci_hemisphere(rays)
        self.caster, self.open_sky = caster, open_sky
        self.values = values * (2.0 * math.pi / rays)
        blocked = self.values[:, :, None] * sh.evaluate(local, order)  # [F, R, n²]
        flat = blocked.transpose(1, 0, 2).reshape(rays, -1)
        self.flat = np.ascontiguousarray(flat, dtype=np.float32)
        self.local = local.astype(np.float32)

    def __call__(self, part: slice) -> Part:
        """Of some points."""
        frames = self.caster.frames[part]
        directions = self.local @ frames.astype(np.float32).transpose(0, 2, 1)  # [B, R, 3]
        hits = self.caster.cast(part, directions)
        shade = np.zeros((len(frames), len(self.local)), dtype=np.float32)
        shade.reshape(-1)[hits.ray] = 1.0
        lost = (shade @ self.flat).reshape(len(frames), *self.open_sky.shape)
        direct = rotate(self.open_sky - lost.astype(np.float64), frames[:, None])
        direct[shade.all(axis=1)] = 0.0  # not the rays' error: enclosed places stay dark for good
        return direct, hidden_by(hits, self.values, (len(frames), len(self.caster)))


@dataclass(frozen=True)
class GatherBlock:
    """Rays of a few parts of the points: work that can be handed over.

    Attributes:
        kind: of caster, its class.
        order: bands n.
        rays: of every point.
        step: points of a part.
    """

    kind: str
    order: int
    rays: int
    step: int

    def __call__(self, number: int, given: Given) -> Result:
        """See ``prtnet.exchange.Work``."""
        sky = known_sky(self, given)
        parts = slices(len(sky.caster), self.step)[number * PARTS : (number + 1) * PARTS]
        direct, hidden = together([sky(part) for part in parts])
        arrays = {"direct": direct}
        for function, matrix in enumerate(hidden):
            for name in CSR:
                arrays[f"{name}{function}"] = getattr(matrix, name)
        return {}, arrays


@keeps_last
def known_sky(block: GatherBlock, given: Given) -> Sky:
    """What the blocks of one surface share."""
    caster = caster_of(block.kind, given)
    return Sky(caster, block.order, given["values"], given["open_sky"])


def slices(count: int, step: int) -> list[slice]:
    """So many points in parts."""
    return [slice(start, min(start + step, count)) for start in range(0, count, step)]


def together(parts: Sequence[Part]) -> Part:
    """Parts of the points as one."""
    hidden = [
        scipy.sparse.csr_array(scipy.sparse.vstack(matrices))
        for matrices in zip(*(matrices for _, matrices in parts), strict=True)
    ]
    return np.concatenate([direct for direct, _ in parts]), hidden


def unpacked(arrays: Mapping[str, Any], functions: int, points: int) -> Part:
    """A block's result."""
    direct = arrays["direct"]
    shape = len(direct), points
    hidden = [
        scipy.sparse.csr_array(tuple(arrays[f"{name}{k}"] for name in CSR), shape=shape)
        for k in range(functions)
    ]
    return direct, hidden


def hidden_by(
    hits: Hits, values: FloatArray, shape: tuple[int, int]
) -> list[scipy.sparse.csr_array]:
    """F matrices (B, K): what points that hide the sky of others weigh there.

    Args:
        hits: of B points' rays.
        values: of F functions along R rays, solid angles included, (F, R).
        shape: B and K.
    """
    lit = hits.weights.ravel() > 0
    point, ray = np.divmod(np.repeat(hits.ray, 3)[lit], values.shape[1])
    place = (point, hits.corners.ravel()[lit])
    share = hits.weights.ravel()[lit]
    return [
        scipy.sparse.csr_array((share * value[ray], place), shape=shape)
        for value in values.astype(np.float32)
    ]


def bounce(
    arriving: FloatArray,
    hidden: scipy.sparse.csr_array,
    leave: Exit,
    areas: FloatArray,
    most: int,
    tolerance: float = 1e-3,
    through: FloatArray | None = None,
    report: Report = silent,
) -> tuple[FloatArray, Bounces]:
    """All exit radiance, (K, n²), of direct light and its bounces, and their energies.

    Bounces end when further ones cannot add more than ``tolerance`` of the largest exit radiance
    to any point, or after ``most``.

    Args:
        arriving: of direct light, (K, n²).
        hidden: H.
        leave: exit radiance (K, n²) of irradiance over π.
        areas: of the points, (K,).
        most: bounces at most; 0 for direct light alone.
        tolerance: see above.
        through: further exit radiance of direct light, (K, n²), from behind the surface.
        report: of progress.
    """
    share = areas / areas.sum()
    norm = float(leave(hidden @ np.ones((len(areas), 1))).max(initial=0.0))
    told = Bounces()
    leaving = leave(arriving) if through is None else leave(arriving) + through
    total = np.zeros_like(leaving)
    before: FloatArray | None = None
    for done in range(most + 1):
        total += leaving
        white = leaving[:, 0] * UNIFORM
        told.energy.append(float(share @ white))
        told.largest.append(float(np.abs(white).max(initial=0.0)))
        told.left = following(white, before, norm, float(total[:, 0].max()) * UNIFORM)
        told.diverges = done > 1 and never_ends(told.largest)
        report("bounces", done, most, f"energy {told.energy[-1]:.4g}")
        if done == most or told.left <= tolerance:
            break
        before, leaving = white, leave(hidden @ leaving)
    return total, told


def following(white: FloatArray, before: FloatArray | None, norm: float, most: float) -> float:
    """Bound of what all further bounces add to any point, as a share of ``most``.

    Bounces are a positive operator A. Where it takes no 1 to more than q, nor any point's light to
    more than q times that light, it does so again and again: at most q / (1 − q) of this bounce
    follows. The first q is A's norm, the second is told by the bounce before.

    Args:
        white: exit radiance of this bounce, (K,).
        before: of the one before, if there was one.
        norm: of A.
        most: exit radiance of all bounces so far, of the point that has most.
    """
    largest = float(np.abs(white).max(initial=0.0))
    if largest <= NOTHING * most or largest == 0.0:
        return 0.0
    shrinks = [norm]
    if before is not None:
        told = before > NOTHING * most
        if not (white[~told] > NOTHING * most).any():
            shrinks.append(float((white[told] / before[told]).max(initial=0.0)))
    q = min(shrinks)
    return largest * q / (1.0 - q) / most if q < 1.0 - STEADY else math.inf


def never_ends(largest: Sequence[float]) -> bool:
    """Whether the last bounce was as large as the one before."""
    return largest[-1] > 0.0 and largest[-1] >= (1.0 - STEADY) * largest[-2]
