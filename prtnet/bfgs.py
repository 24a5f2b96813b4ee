"""Small smooth problems minimised all at once: BFGS on a batch, each with its own matrix.

For problems of some ten unknowns, whose evaluation costs less than a call from Python: a hundred
together take about as long as one.

Papers:
    [1] Nocedal and Wright, "Numerical Optimization", 2nd edition, 2006.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["Objective", "minimise"]

# Takes the indices (K,) of problems and their points (K, D): values (K,) and gradients (K, D).
Objective = Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]]

SUFFICIENT = 1e-4  # share of the decrease that the slope promises [1, eq. 3.4]
SHORTER = 0.4
TRIALS = 12


def minimise(
    objective: Objective, start: FloatArray, iterations: int, reach: float, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Points near local minima, none with a value above that of its start.

    Args:
        objective: value and gradient; it is asked only about problems still under way.
        start: points, (B, D).
        iterations: at most.
        reach: the largest change of a coordinate in one iteration.
        tolerance: a problem is done when an iteration takes away less than this share of its value.

    Returns:
        Points (B, D) and values (B,).
    """
    count, size = start.shape
    points = start.astype(np.float64)
    values, gradients = objective(np.arange(count), points)
    inverse = np.tile(np.eye(size), (count, 1, 1))  # of the Hessian
    under_way = np.arange(count)
    for iteration in range(iterations):
        under_way = under_way[(gradients[under_way] != 0).any(axis=-1)]
        if len(under_way) == 0:
            break
        # Each step: from the points (before) along a direction to what the line search accepts.
        before, value = points[under_way], values[under_way]
        step = -(inverse[under_way] @ gradients[under_way, :, None])[..., 0]
        uphill = (step * gradients[under_way]).sum(axis=-1) >= 0.0  # rounding took its definiteness
        step[uphill] = -gradients[under_way[uphill]]
        step *= np.minimum(1.0, reach / np.abs(step).max(axis=-1, keepdims=True))
        slope = (step * gradients[under_way]).sum(axis=-1)
        accepted, found = search(objective, under_way, before, step, value, slope)
        under_way = under_way[accepted]
        change = found[0] - before[accepted]
        bend = found[2] - gradients[under_way]
        inverse[under_way] = updated(inverse[under_way], change, bend, first=iteration == 0)
        points[under_way], values[under_way], gradients[under_way] = found
        gain = value[accepted] - found[1]
        under_way = under_way[gain > tolerance * found[1]]
    return points, values


def search(
    objective: Objective,
    which: IntArray,
    before: FloatArray,
    step: FloatArray,
    value: FloatArray,
    slope: FloatArray,
) -> tuple[IntArray, tuple[FloatArray, FloatArray, FloatArray]]:
    """Backtracking: positions in ``which`` that got lower; their points, values and gradients."""
    points, values, gradients = before.copy(), value.copy(), np.empty_like(before)
    length = 1.0
    trying, lower = np.arange(len(which)), np.zeros(len(which), dtype=bool)
    for _ in range(TRIALS):
        trial = before[trying] + length * step[trying]
        trial_value, trial_gradient = objective(which[trying], trial)
        good = trial_value <= value[trying] + SUFFICIENT * length * slope[trying]
        done = trying[good]
        points[done], values[done] = trial[good], trial_value[good]
        gradients[done], lower[done] = trial_gradient[good], True
        trying = trying[~good]
        if len(trying) == 0:
            break
        length *= SHORTER
    return np.flatnonzero(lower), (points[lower], values[lower], gradients[lower])


def updated(inverse: FloatArray, change: FloatArray, bend: FloatArray, first: bool) -> FloatArray:
    """The inverse Hessians (K, D, D) after steps (K, D) that changed gradients so [1, eq. 6.17].

    Where the curvature along the step is not positive the matrix is left as it was.
    """
    curvature = (change * bend).sum(axis=-1)
    usual = curvature > 1e-12 * np.linalg.norm(change, axis=-1) * np.linalg.norm(bend, axis=-1)
    s, y, rho = change[usual], bend[usual], 1.0 / curvature[usual, None, None]
    result = inverse.copy()
    old = result[usual]
    if first:
        old = old * (1.0 / (rho * (y * y).sum(axis=-1)[:, None, None]))  # [1, eq. 6.20]
    bent = (old @ y[..., None])[..., 0]
    across = bent[:, :, None] * s[:, None, :]
    along = 1.0 + rho * (y * bent).sum(axis=-1)[:, None, None]
    result[usual] = old + rho * (
        along * s[:, :, None] * s[:, None, :] - across - np.swapaxes(across, -1, -2)
    )
    return result
