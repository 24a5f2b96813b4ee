"""Small smooth problems minimised many at once: BFGS on a batch, each with its own matrix and step.

For problems of some ten unknowns, whose evaluation costs less than a call from Python. A problem is
a column. Every round evaluates each problem of the batch once, whether it tries its first step
along a direction or a shorter one, and problems that are done make room for those that wait.

Papers:
    [1] Nocedal and Wright, "Numerical Optimization", 2nd edition, 2006.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from prtnet.arrays import BoolArray, FloatArray, IntArray

__all__ = ["Objective", "minimise"]

# Takes the indices (K,) of problems and their points (D, K): values (K,) and slopes (D, K).
Objective = Callable[[IntArray, FloatArray], tuple[FloatArray, FloatArray]]

SUFFICIENT = 1e-4  # share of the decrease that the slope promises [1, eq. 3.4]
SHORTER = (0.1, 0.5)  # a rejected step is multiplied by something between
SHORTEST = 1e-5  # a direction is given up below this share of its first step
WIDTH = 1024  # problems under way at once
QUIET = 2  # steps one after another that gain too little: one may be unlucky
ROOM = 0.25  # of the batch is refilled at a time


def minimise(
    objective: Objective,
    start: FloatArray,
    iterations: int,
    reach: float,
    tolerance: float,
    enough: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Points near local minima, none with a value above that of its start.

    Args:
        objective: values and slopes; it is asked only about problems still under way.
        start: points, (D, B).
        iterations: accepted steps at most.
        reach: the largest change of a coordinate in one step.
        tolerance: a problem is done when steps take away less than this share of its value.
        enough: a problem is done when its value is not above this.

    Returns:
        Points (D, B) and values (B,).
    """
    points = np.array(start, dtype=np.float64)
    count = points.shape[1]
    values = np.empty(count)
    if count == 0:
        return points, values
    waiting = min(WIDTH, count)  # the first that has not begun
    batch = Batch(objective, np.arange(waiting), points[:, :waiting], reach)
    while waiting < count or len(batch.which) > 0:
        if waiting < count and len(batch.which) <= (1.0 - ROOM) * WIDTH:
            new = np.arange(waiting, min(waiting + WIDTH - len(batch.which), count))
            batch.join(Batch(objective, new, points[:, new], reach))
            waiting += len(new)
        batch.done |= (batch.taken >= iterations) | (batch.value <= enough)
        gain = batch.step(objective, reach)
        small = gain <= tolerance * np.abs(batch.value)
        batch.quiet = np.where(small, batch.quiet + 1, np.where(np.isinf(gain), batch.quiet, 0))
        batch.done |= batch.quiet >= QUIET
        if batch.done.mean() >= ROOM:
            finished = batch.which[batch.done]
            points[:, finished] = batch.point[:, batch.done]
            values[finished] = batch.value[batch.done]
            batch.keep(~batch.done)
    return points, values


class Batch:
    """Problems under way: a column each.

    Attributes:
        which: their indices, (K,).
        point: the best points, (D, K); ``value`` and ``slope`` are the objective's there.
        taken: steps accepted, (K,); ``quiet``: of the last ones, how many gained too little.
        done: which are finished, (K,).
    """

    # Arrays whose last axis is the problem.
    STATE = (
        "which", "point", "value", "slope", "inverse", "direction", "scale", "length", "taken",
        "quiet", "done",
    )  # fmt: skip

    def __init__(
        self, objective: Objective, which: IntArray, point: FloatArray, reach: float
    ) -> None:
        size, count = point.shape
        self.which, self.point = which, point
        self.value, self.slope = objective(which, point)
        self.inverse = np.zeros((size, size, count))  # of the Hessian
        self.inverse[np.arange(size), np.arange(size)] = 1.0
        self.taken = np.zeros(count, dtype=np.int64)
        self.quiet = np.zeros_like(self.taken)
        self.done = (self.slope == 0).all(axis=0)
        self.direction = -self.slope
        self.length = np.ones(count)
        self.scale = self.limited(reach)

    def join(self, other: Batch) -> None:
        """Take in further problems."""
        for name in self.STATE:
            pair = getattr(self, name), getattr(other, name)
            setattr(self, name, np.concatenate(pair, axis=-1))

    def keep(self, chosen: BoolArray) -> None:
        """Drop all others."""
        for name in self.STATE:
            setattr(self, name, np.compress(chosen, getattr(self, name), axis=-1))

    def limited(self, reach: float) -> FloatArray:
        """What share of the directions changes no coordinate by more than the reach."""
        largest = np.abs(self.direction).max(axis=0, initial=0.0)
        return np.minimum(1.0, reach / np.where(largest > 0, largest, 1.0))

    def step(self, objective: Objective, reach: float) -> FloatArray:
        """Try a point a problem; what it took from the value, or infinity while still trying."""
        move = self.scale * self.length * self.direction
        value, slope = objective(self.which, self.point + move)
        promised = (move * self.slope).sum(axis=0)
        rise = value - self.value
        good = (rise <= SUFFICIENT * promised) & ~self.done
        gain = np.where(good, -rise, np.inf)
        bend = np.where(good, slope - self.slope, 0.0)
        move = np.where(good, move, 0.0)
        along = np.where(good, slope, self.slope)
        turned = self.updated(move, bend, along)
        self.point += move
        self.value = np.where(good, value, self.value)
        self.slope = along
        self.taken += good
        uphill = good & ((turned * along).sum(axis=0) >= 0.0)  # rounding took its definiteness
        turned[:, uphill] = -along[:, uphill]
        self.direction = np.where(good, turned, self.direction)
        self.scale = np.where(good, self.limited(reach), self.scale)
        # A rejected step: to the minimum of the parabola through both values and the first slope.
        bowl = 2.0 * (rise - promised)
        best = np.divide(-promised, bowl, out=np.full_like(bowl, SHORTER[0]), where=bowl > 0)
        self.length = np.where(good, 1.0, self.length * np.clip(best, *SHORTER))
        self.done |= (self.length < SHORTEST) | (self.slope == 0).all(axis=0)
        return gain

    def updated(self, move: FloatArray, bend: FloatArray, slope: FloatArray) -> FloatArray:
        """Update inverse Hessians by steps (D, K) that changed slopes so [1, eq. 6.17].

        Where the curvature along a step is not positive, or there was no step, the matrix is left
        as it was.

        Returns:
            −H g, the directions (D, K) of Newton's steps from where the slopes are g.
        """
        curvature = (move * bend).sum(axis=0)
        steep = (bend * bend).sum(axis=0)
        usual = curvature > 1e-12 * np.sqrt((move * move).sum(axis=0) * steep)
        first = usual & (self.taken == 0)
        rho = np.divide(1.0, curvature, out=np.zeros_like(curvature), where=usual)
        if first.any():  # [1, eq. 6.20]
            scale = np.divide(curvature, steep, out=np.ones_like(curvature), where=first)
            self.inverse *= scale
        bent = np.einsum("ijk,jk->ik", self.inverse, bend)
        side = rho * (0.5 * (1.0 + rho * (bend * bent).sum(axis=0)) * move - bent)
        result = -np.einsum("ijk,jk->ik", self.inverse, slope)
        result -= move * (side * slope).sum(axis=0) + side * (move * slope).sum(axis=0)
        for row, s, u in zip(self.inverse, move, side, strict=True):
            row += s * side
            row += u * move
        return result
