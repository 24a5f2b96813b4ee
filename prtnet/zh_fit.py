"""Fits of zonal lobes to functions, each by itself.

For fixed axes the best coefficients are linear least squares, so a fit searches over axes alone:
greedily among candidates as in [1, 2], then by BFGS on the axes of all lobes, from several starts
at once.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
    [2] Nowrouzezahrai, Kalogerakis and Fiume, "Shadowing Dynamic Scenes with Arbitrary BRDFs",
        2009.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from itertools import islice

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.bfgs import minimise
from prtnet.sh import bands, evaluate, fibonacci_hemisphere, gradient, order_of
from prtnet.zh import (
    RIDGE,
    Lobes,
    best_coefficients,
    checked,
    in_order,
    relative_error,
    synthesis,
    zonal_energy,
)

__all__ = ["fewest_lobes", "fit_lobes"]

CANDIDATES = 1500  # axes tried for a further lobe, as in [2]
STARTS = 64
FIRST_ITERATIONS = 20  # from every start; the best KEPT go on
KEPT = 12
ITERATIONS = 100
REACH = 0.4  # of a component of an axis in one iteration
TOLERANCE = 1e-5  # share of the squared error gained in one iteration
BLOCK = 64  # functions fitted at a time


def fit_lobes(target: FloatArray, count: int = 3, starts: int = STARTS) -> Lobes:
    """The sums of ``count`` lobes nearest to functions, each function by itself.

    Deterministic, and never worse than ``count`` − 1 lobes or than greedy search by more than
    the ridge. Lobes come in order of energy, largest first; each points to where its linear band
    is positive, so at a light rather than away from it.

    Args:
        target: f, (..., n²): a colour channel each, say.
        count: number of lobes N, at least 1.
        starts: scattered sets of axes to search from, beside the greedy ones. For lights, the
            more the safer; for thousands of transfer vectors a few are a matter of time.

    Returns:
        Axes (..., N, 3) and coefficients (..., N, n), in the dtype of ``target``.

    Raises:
        ValueError: ``count`` is below 1, or a coefficient is not finite.
    """
    if count < 1:
        raise ValueError(f"a fit needs at least one lobe, not {count}")
    return next(islice(growing_fits(target, starts), count - 1, None))


def fewest_lobes(target: FloatArray, most: int, error: float) -> Lobes:
    """The fit of fewest lobes whose ``relative_error`` is at most ``error``.

    Args:
        target: f, (..., n²); all its functions get the same number of lobes.
        most: lobes at most; the fit with as many if none is good enough.
        error: the bound, as a fraction.
    """
    if most < 1:
        raise ValueError(f"a fit needs at least one lobe, not {most}")
    for lobes in islice(growing_fits(target, STARTS), most):
        if relative_error(target, lobes) <= error:
            break
    return lobes


def growing_fits(target: FloatArray, starts: int) -> Iterator[Lobes]:
    """Fits of 1, 2, 3, … lobes; each search also starts from the fit before and a further lobe."""
    values, dtype = checked(target)
    order = order_of(values)
    flat = values.reshape(-1, order * order)
    largest = np.maximum(np.abs(flat).max(axis=-1, keepdims=True), np.finfo(np.float64).tiny)
    unit = flat / largest
    length = np.linalg.norm(unit, axis=-1, keepdims=True)
    unit /= np.where(length == 0, 1.0, length)
    searches = [
        Search(unit[first : first + BLOCK], starts) for first in range(0, max(len(unit), 1), BLOCK)
    ]
    while True:
        axes = np.concatenate([search.grown() for search in searches])
        lobes = in_order(axes, best_coefficients(evaluate(axes, order), unit))
        coefficients = lobes.coefficients * (largest * length)[:, None]
        shape = (*values.shape[:-1], axes.shape[1])
        yield Lobes(
            lobes.axes.reshape(*shape, 3).astype(dtype),
            coefficients.reshape(*shape, order).astype(dtype),
        )


class Search:
    """The growing fit of a block of unit vectors f, (B, n²)."""

    def __init__(self, target: FloatArray, starts: int) -> None:
        self.target, self.starts = target, starts
        self.order = order_of(target)
        self.axes: FloatArray = np.empty((len(target), 0, 3))
        self.greedy_axes: FloatArray = self.axes
        self.greedy_rest: FloatArray = target

    def grown(self) -> FloatArray:
        """The axes (B, N, 3) of the best fit found with one lobe more."""
        count = self.axes.shape[1] + 1
        basis = evaluate(self.axes, self.order)
        rest = self.target - synthesis(basis, best_coefficients(basis, self.target))
        starts = [self.extended(self.axes, rest)]
        self.greedy_axes = self.extended(self.greedy_axes, self.greedy_rest)
        last = evaluate(self.greedy_axes[:, -1:], self.order)
        self.greedy_rest = self.greedy_rest - synthesis(
            last, best_coefficients(last, self.greedy_rest)
        )
        if count > 1:  # the candidates have seen the whole sphere for a single lobe
            scattered = np.random.default_rng(count).normal(size=(self.starts, count, 3))
            starts += [
                self.greedy_axes,
                *np.broadcast_to(scattered[:, None], (self.starts, len(self.target), count, 3)),
            ]
        axes = np.stack(starts, axis=1)  # [B, S, N, 3]
        if axes.shape[1] > KEPT:
            axes = self.refined(axes, FIRST_ITERATIONS)[:, :KEPT]
        self.axes = self.refined(axes, ITERATIONS)[:, 0]
        return self.axes

    def extended(self, axes: FloatArray, rest: FloatArray) -> FloatArray:
        """The axes (B, N, 3) and the candidate that alone takes most off the rest (B, n²)."""
        candidates, basis = axis_candidates(self.order)
        energy: FloatArray = np.zeros((len(rest), len(candidates)))
        for band in range(self.order):
            part = slice(band * band, (band + 1) ** 2)
            energy += (rest[:, part] @ basis[:, part].T) ** 2 / zonal_energy(band)
        return np.concatenate([axes, candidates[energy.argmax(axis=-1)][:, None]], axis=1)

    def refined(self, axes: FloatArray, iterations: int) -> FloatArray:
        """Sets of axes (B, S, N, 3) after a search from each, the best first."""
        shape = axes.shape
        target = np.repeat(self.target, shape[1], axis=0)

        def objective(which: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
            value, slope = misfit(target[which], points.reshape(-1, *shape[2:]))
            return value, slope.reshape(points.shape)

        flat = axes.reshape(-1, 3 * shape[2])
        points, values = minimise(objective, flat, iterations, REACH, TOLERANCE)
        best = values.reshape(shape[:2]).argsort(axis=1, kind="stable")
        points = np.take_along_axis(points.reshape(shape), best[:, :, None, None], axis=1)
        return np.asarray(points / np.linalg.norm(points, axis=-1, keepdims=True))


def misfit(target: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The objective ‖f̃ − f‖² + ε‖g*‖² at the best coefficients, and its gradient.

    At the best coefficients its derivatives by them vanish, so those of the axes are all there
    are: 2 Σ_lm ∇(y_lm ∘ h) g*_l (f̃ − f)_lm [1, eq. 20–21].

    Args:
        target: f, (B, n²).
        axes: vectors of any length, (B, N, 3).

    Returns:
        (B,) and (B, N, 3).
    """
    order = order_of(target)
    basis = evaluate(axes / np.linalg.norm(axes, axis=-1, keepdims=True), order)
    coefficients = best_coefficients(basis, target)
    missed = synthesis(basis, coefficients) - target
    size = (coefficients**2 @ zonal_energy(np.arange(order))).sum(axis=-1)
    value = (missed**2).sum(axis=-1) + RIDGE * size
    weight = 2.0 * coefficients[..., bands(order)] * missed[:, None]  # [B, N, n²]
    return value, (weight[..., None, :] @ gradient(axes, order))[..., 0, :]


@lru_cache
def axis_candidates(order: int) -> tuple[FloatArray, FloatArray]:
    """Axes (K, 3) over half the sphere, the other half being the same lobes; the basis there."""
    axes = fibonacci_hemisphere(CANDIDATES)
    return axes, evaluate(axes, order)
