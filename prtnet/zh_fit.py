"""Fits of zonal lobes to functions, each by itself: from three lights to millions of vectors.

For fixed axes the best coefficients are linear least squares, so a fit searches over axes alone
(``prtnet.zh_misfit``). It grows: the axis that alone takes most off what is left, among candidates
and the axis of its linear band [1, section 3.3; 2], then BFGS on the axes of all lobes. Where the
error stays high, further searches start from random axes [1, section 4.1].

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
    [2] Nowrouzezahrai, Kalogerakis and Fiume, "Shadowing Dynamic Scenes with Arbitrary BRDFs",
        2009.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any

import numpy as np

from prtnet.array_library import as_floating
from prtnet.arrays import FloatArray, IntArray
from prtnet.bfgs import minimise
from prtnet.cores import one_thread, thread_count
from prtnet.sh import evaluate, fibonacci_hemisphere, order_of
from prtnet.zh import (
    RIDGE,
    Lobes,
    best_coefficients,
    checked,
    linear_axis,
    relative_error,
    synthesis,
    zonal_energy,
)
from prtnet.zh_misfit import Misfit
from prtnet.zh_order import aligned, in_order

__all__ = ["fewest_lobes", "fit_lobes", "follow_lobes", "linear_axes"]

CANDIDATES = 1500  # axes tried for a further lobe, as in [2]
STARTS = 64
FIRST_ITERATIONS = 20  # from every random start; this share, the best, goes on
KEPT = 0.2
LEAST_KEPT = 8
ITERATIONS = 100
REACH = 0.4  # of a component of an axis in one iteration
TOLERANCE = 1e-5  # share of the squared error gained in one iteration
APART = 0.9  # the cosine between axes that are not near each other
BLOCK = 1024  # functions fitted at a time by a thread
# A fit better than NEAR goes on with a ridge that small functions of lobes do not notice, and is
# kept if no coefficient is more than LARGEST times its function.
NEAR = 3e-3
FINE_RIDGE = 1e-10
FINE_TOLERANCE = 1e-4
FINE_ITERATIONS = 300
EXACT = 1e-7
LARGEST = 100.0


def fit_lobes(
    target: FloatArray,
    count: int = 3,
    starts: int = STARTS,
    good: float = 0.0,
    seed: int = 0,
    ridge: float = RIDGE,
) -> Lobes:
    """The sums of ``count`` lobes nearest to functions, each function by itself.

    Deterministic, and never worse than greedy search by more than the ridge. Lobes come in order
    of energy, largest first; each points to where its linear band is positive, so at a light
    rather than away from it. Functions are fitted by blocks, on all cores.

    Args:
        target: f, (..., n²): a colour channel each, say.
        count: number of lobes N, at least 1.
        starts: random sets of axes to search from, beside the greedy ones. For lights, the more
            the safer; for thousands of transfer vectors a few are a matter of time.
        good: random starts are for functions whose relative error is above this.
        seed: of the random starts.
        ridge: what ‖g*‖² costs. The usual one hardly shows; where fits of many functions are to be
            alike, 0.01 keeps lobes that meet from large coefficients of opposite sign.

    Returns:
        Axes (..., N, 3) and coefficients (..., N, n), in the dtype of ``target``.

    Raises:
        ValueError: ``count`` is below 1, or a coefficient is not finite.
    """
    if count < 1:
        raise ValueError(f"a fit needs at least one lobe, not {count}")
    return in_blocks(lambda block: Search(block, starts, good, seed, ridge).fit(count), target)


def fewest_lobes(target: FloatArray, most: int, error: float) -> Lobes:
    """The fit of fewest lobes whose ``relative_error`` is at most ``error``.

    Args:
        target: f, (..., n²): a few; all its functions get the same number of lobes.
        most: lobes at most; the fit with as many if none is good enough.
        error: the bound, as a fraction.
    """
    if most < 1:
        raise ValueError(f"a fit needs at least one lobe, not {most}")
    values, dtype = checked(target)
    unit, length = normalised(values.reshape(-1, values.shape[-1]))
    search = Search(unit, STARTS)
    for count in range(1, most + 1):
        lobes = shaped([scaled(search.fit(count), length, dtype)], values.shape)
        if relative_error(target, lobes) <= error:
            break
    return lobes


def follow_lobes(
    target: FloatArray,
    previous: Lobes,
    good: float = math.inf,
    starts: int = 0,
    ridge: float = RIDGE,
) -> Lobes:
    """Fits by searches from the axes of other fits: of the frame before, or of a neighbour.

    Lobe i goes on from lobe i, so that what lies between two frames can be interpolated.

    Args:
        target: f, (..., n²).
        previous: as many sums of lobes, (..., N): those of functions not far away.
        good: functions that end with a relative error above this are also fitted afresh; where
            that is better, its lobes are taken, in the order that fits ``previous`` best.
        starts: of the fresh fits, as in ``fit_lobes``; so is the next.
        ridge: what ‖g*‖² costs.

    Returns:
        As ``fit_lobes``; lobes in the order of ``previous``.
    """
    count = previous.axes.shape[-2]
    if previous.axes.shape[:-2] != target.shape[:-1]:
        raise ValueError(
            f"lobes of {previous.axes.shape[:-2]} functions to follow, not of {target.shape[:-1]}"
        )

    def followed(block: FloatArray, axes: FloatArray) -> Lobes:
        search = Search(block, ridge=ridge)
        lobes = search.finished(search.refined(axes[:, None], ITERATIONS)[0][:, 0])
        poor = np.flatnonzero(errors(lobes, block) > good)
        if len(poor) > 0:
            fresh = Search(block[poor], starts, good, ridge=ridge).fit(count)
            better = errors(fresh, block[poor]) < errors(lobes[poor], block[poor])
            chosen = poor[better]
            fresh = aligned(fresh[better], lobes[chosen])
            lobes.axes[chosen], lobes.coefficients[chosen] = fresh.axes, fresh.coefficients
        return lobes

    return in_blocks(followed, target, previous.axes.reshape(-1, count, 3))


def in_blocks(fit: Callable[..., Lobes], target: FloatArray, *others: FloatArray) -> Lobes:
    """Fits of functions of any size, by blocks on all cores; blocks see functions of norm 1.

    Args:
        fit: takes a block (B, n²), and the same rows of the others, and gives its lobes.
        target: f, (..., n²).
        others: arrays of a row each function.
    """
    given = as_floating(target)
    flat = given.reshape(-1, order_of(given) ** 2)
    blocks = [slice(first, first + BLOCK) for first in range(0, max(len(flat), 1), BLOCK)]

    def fitted(block: slice) -> Lobes:
        unit, length = normalised(checked(flat[block])[0])
        rest = [other[block].astype(np.float64) for other in others]
        return scaled(fit(unit, *rest), length, given.dtype)

    if len(blocks) == 1:
        return shaped([fitted(blocks[0])], given.shape)
    count = thread_count()
    with one_thread(), ThreadPoolExecutor(count) as pool:
        return shaped(list(pool.map(fitted, blocks)), given.shape)


def normalised(functions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Functions (B, n²) over their norms (B, 1), whose squares need not be numbers."""
    largest = np.maximum(np.abs(functions).max(axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    unit = functions / largest
    length = np.linalg.norm(unit, axis=-1, keepdims=True)
    return unit / np.where(length == 0, 1.0, length), largest * length


def scaled(lobes: Lobes, length: FloatArray, dtype: np.dtype[Any]) -> Lobes:
    """Lobes (B, N) of functions times lengths (B, 1)."""
    coefficients = lobes.coefficients * length[:, None]
    return Lobes(lobes.axes.astype(dtype), coefficients.astype(dtype))


def shaped(blocks: list[Lobes], shape: tuple[int, ...]) -> Lobes:
    """Blocks of lobes one after another, in the shape (..., n²) of their functions."""
    axes = np.concatenate([block.axes for block in blocks])
    coefficients = np.concatenate([block.coefficients for block in blocks])
    leading = (*shape[:-1], axes.shape[1])
    return Lobes(axes.reshape(*leading, 3), coefficients.reshape(*leading, coefficients.shape[-1]))


class Search:
    """The growing fit of a block of functions f of norm 1 or 0, (B, n²).

    Attributes:
        axes: of the best fit so far, (B, N, 3).
    """

    def __init__(
        self,
        target: FloatArray,
        starts: int = 0,
        good: float = 0.0,
        seed: int = 0,
        ridge: float = RIDGE,
    ) -> None:
        self.target, self.starts, self.good, self.seed = target, starts, good, seed
        self.order, self.ridge = order_of(target), ridge
        self.misfit = Misfit(target, ridge)
        self.axes: FloatArray = np.empty((len(target), 0, 3))
        self.greedy_axes: FloatArray = self.axes
        self.greedy_rest: FloatArray = target

    def fit(self, count: int) -> Lobes:
        """Grow to ``count`` lobes, at least as many as there are."""
        while self.axes.shape[1] < count:
            self.grow()
        return in_order(self.finished(self.axes))

    def grow(self) -> None:
        """Search for a fit of one lobe more: from the fit before and a further lobe, and anew."""
        basis = evaluate(self.axes, self.order)
        rest = self.target - synthesis(basis, best_coefficients(basis, self.target, self.ridge))
        first = self.candidate(rest)
        starts = [np.concatenate([self.axes, first[:, None]], axis=1)]
        greedy = self.candidate(self.greedy_rest)
        self.greedy_axes = np.concatenate([self.greedy_axes, greedy[:, None]], axis=1)
        last = evaluate(greedy[:, None], self.order)
        self.greedy_rest = self.greedy_rest - synthesis(
            last, best_coefficients(last, self.greedy_rest, self.ridge)
        )
        count = self.greedy_axes.shape[1]
        # A single lobe: the two best of the whole sphere. More: the greedy ones.
        starts.append(self.greedy_axes if count > 1 else self.candidate(rest, first)[:, None])
        axes, values = self.refined(np.stack(starts, axis=1), ITERATIONS)
        self.axes = axes[:, 0]
        poor = np.flatnonzero(values[:, 0] > self.good**2)
        # The candidates have seen the whole sphere for a single lobe.
        if count > 1 and self.starts > 0 and len(poor) > 0:
            self.search_on(poor, values[poor, 0])

    def search_on(self, poor: IntArray, values: FloatArray) -> None:
        """Search from random axes for fits of some functions that are better than ``values``."""
        count = self.axes.shape[1]
        scattered = np.random.default_rng((self.seed, count)).normal(size=(self.starts, count, 3))
        axes: FloatArray = np.broadcast_to(scattered, (len(poor), *scattered.shape))
        kept = max(LEAST_KEPT, int(KEPT * self.starts))
        if self.starts > kept:
            axes = self.refined(axes, FIRST_ITERATIONS, poor)[0][:, :kept]
        axes, found = self.refined(axes, ITERATIONS, poor)
        better = found[:, 0] < values
        self.axes[poor[better]] = axes[better, 0]

    def candidate(self, rest: FloatArray, apart: FloatArray | None = None) -> FloatArray:
        """The axes (B, 3) of the lobe that alone takes most off the rest (B, n²).

        Not near ``apart`` (B, 3) nor its opposite, if given.
        """
        candidates, basis = axis_candidates(self.order)
        energy: FloatArray = np.zeros((len(rest), len(candidates)))
        for band in range(1, self.order):
            part = slice(band * band, (band + 1) ** 2)
            energy += np.square(rest[:, part] @ basis[:, part].T) / zonal_energy(band)
        if apart is not None:
            energy[np.abs(apart @ candidates.T) > APART] = -1.0
        chosen = candidates[energy.argmax(axis=-1)]
        if apart is not None or self.order == 1:
            return chosen
        linear = linear_axes(rest)
        own = rest * evaluate(linear, self.order)
        sums = np.add.reduceat(own, np.arange(self.order) ** 2, axis=-1)[:, 1:]
        share = (np.square(sums) / zonal_energy(np.arange(1, self.order))).sum(axis=-1)
        return np.where((share > energy.max(axis=-1))[:, None], linear, chosen)

    def refined(
        self, axes: FloatArray, iterations: int, which: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Sets of axes after a search from each, the best first, and the objective there.

        Args:
            axes: (B, S, N, 3).
            iterations: of BFGS.
            which: functions (B,) that they are of; all when None.
        """
        shape = axes.shape
        functions = np.repeat(np.arange(len(axes)) if which is None else which, shape[1])
        columns = np.ascontiguousarray(axes.reshape(-1, *shape[2:]).transpose(2, 1, 0))
        points, values = minimise(
            lambda asked, at: self.misfit(functions[asked], at),
            columns.reshape(3 * shape[2], -1), iterations, REACH, TOLERANCE,
        )  # fmt: skip
        return ranked(points, values, shape)

    def finished(self, axes: FloatArray) -> Lobes:
        """The lobes (B, N) about axes (B, N, 3), which move a little where the fit is near."""
        coefficients = best_coefficients(evaluate(axes, self.order), self.target, self.ridge)
        lobes = Lobes(np.array(axes), coefficients)
        near = np.flatnonzero(errors(lobes, self.target) < NEAR)
        if self.ridge <= RIDGE and len(near) > 0 and self.order > 1:
            fine = Misfit(self.target[near], FINE_RIDGE)
            columns = np.ascontiguousarray(axes[near].transpose(2, 1, 0))
            points, values = minimise(
                fine, columns.reshape(3 * axes.shape[1], -1), FINE_ITERATIONS, REACH,
                FINE_TOLERANCE, EXACT**2,
            )  # fmt: skip
            moved = ranked(points, values, (len(near), 1, *axes.shape[1:]))[0][:, 0]
            basis = evaluate(moved, self.order)
            exact = best_coefficients(basis, self.target[near], FINE_RIDGE)
            kept = np.abs(exact).max(axis=(1, 2)) <= LARGEST
            lobes.axes[near[kept]] = moved[kept]
            lobes.coefficients[near[kept]] = exact[kept]
        return lobes


def ranked(
    points: FloatArray, values: FloatArray, shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Columns (3N, B S) as sets of unit axes (B, S, N, 3), the best first, and their values."""
    values = values.reshape(shape[:2])
    best = values.argsort(axis=1, kind="stable")
    axes = points.reshape(3, shape[2], -1).transpose(2, 1, 0).reshape(shape)
    axes = np.take_along_axis(axes, best[:, :, None, None], axis=1)
    axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    return axes, np.take_along_axis(values, best, axis=1)


def errors(lobes: Lobes, target: FloatArray) -> FloatArray:
    """‖f̃ − f‖, (B,)."""
    return np.asarray(np.linalg.norm(lobes.harmonics() - target, axis=-1))


def linear_axes(target: FloatArray) -> FloatArray:
    """Axes (B, 3) of the linear bands of functions (B, n²) [1, section 3.3]; +z without one."""
    pole = np.array([0.0, 0.0, 1.0])
    if target.shape[-1] < 4:
        return np.tile(pole, (len(target), 1))
    axis = linear_axis(target)
    length = np.linalg.norm(axis, axis=-1, keepdims=True)
    return np.where(length > 0, axis / np.where(length > 0, length, 1.0), pole)


@lru_cache
def axis_candidates(order: int) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) over half the sphere, the other half being the same lobes; the basis there."""
    axes = fibonacci_hemisphere(CANDIDATES)
    return axes, evaluate(axes, order)
