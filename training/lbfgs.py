"""L-BFGS over many independent problems at once, each with its own history and line search.

One search over all problems would share one step length; here every problem takes its own, and
only the problems still at work are evaluated. A non-finite trial value counts as a step too long.
The iteration is Nocedal and Wright, "Numerical Optimization", algorithms 7.4 and 7.5, with
backtracking by safeguarded interpolation until the Armijo condition holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["NOT_FINITE", "Objective", "Result", "minimise"]

Objective = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(x (A, D), indices (A,) of the problems) -> values (A,), gradients (A, D)."""

ARMIJO = 1e-4
LONGEST_SEARCH = 25
CONVERGED, STALLED, UNFINISHED = "converged", "stalled", "iteration limit"
NOT_FINITE = "not finite"


@dataclass(frozen=True)
class Result:
    """Where each problem ended.

    Attributes:
        x: the best point found, (C, D).
        value: its objective, (C,).
        iterations: taken by each problem, (C,).
        status: why each stopped: converged, stalled (no lower point along the search direction),
            iteration limit, or not finite (already at its start, where it stays).
    """

    x: Tensor
    value: Tensor
    iterations: Tensor
    status: list[str]


class History:
    """The last ``size`` steps and gradient changes of the problems at work, in their order.

    Kept dense: problems that finish are dropped, so that no iteration has to gather the rest.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self.pairs: list[tuple[Tensor, Tensor, Tensor]] = []  # s, y (A, D), ρ (A, 1), oldest first
        self.scale: Tensor | None = None  # (A, 1)

    def push(self, moved: Tensor, s: Tensor, y: Tensor) -> None:
        """Store steps (A, D); ρ = 0 where a problem did not move or found no positive curvature."""
        sy, yy = (s * y).sum(1, keepdim=True), (y * y).sum(1, keepdim=True)
        good = moved[:, None] & (sy > 1e-10 * yy)
        rho = torch.where(good, 1.0 / torch.where(good, sy, 1.0), 0.0)
        before = torch.ones_like(sy) if self.scale is None else self.scale
        self.scale = torch.where(good, sy / torch.where(good, yy, 1.0), before)
        self.pairs = [*self.pairs[-self.size + 1 :], (s, y, rho)]

    def forget(self, which: Tensor) -> None:
        """Start the problems where ``which`` (A,) is true afresh, from steepest descent."""
        again = which[:, None]
        self.pairs = [(s, y, torch.where(again, 0.0, rho)) for s, y, rho in self.pairs]
        if self.scale is not None:
            self.scale = torch.where(again, 1.0, self.scale)

    def keep(self, which: Tensor) -> None:
        """Drop all problems but those where ``which`` (A,) is true."""
        self.pairs = [(s[which], y[which], rho[which]) for s, y, rho in self.pairs]
        if self.scale is not None:
            self.scale = self.scale[which]

    def direction(self, gradient: Tensor) -> Tensor:
        """−H g by the two-loop recursion; a pair that was left out has ρ = 0 and does nothing."""
        q = gradient.clone()
        weights = []
        for s, y, rho in reversed(self.pairs):
            weights.append(rho * (s * q).sum(1, keepdim=True))
            q.addcmul_(weights[-1], y, value=-1.0)
        if self.scale is not None:
            q *= self.scale
        for s, y, rho in self.pairs:
            beta = rho * (y * q).sum(1, keepdim=True)
            q.addcmul_(weights.pop() - beta, s)
        return q.neg_()


def search(
    objective: Objective, index: Tensor, x: Tensor, value: Tensor, slope: Tensor, direction: Tensor,
    step: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    """Backtrack each problem until it satisfies Armijo; returns x, value, gradient, success."""
    best_x, best_value = x.clone(), value.clone()
    best_gradient = torch.zeros_like(x)
    done = torch.zeros(len(x), dtype=torch.bool, device=x.device)
    trying = torch.arange(len(x), device=x.device)
    for _ in range(LONGEST_SEARCH):
        trial = x[trying] + step[trying, None] * direction[trying]
        trial_value, trial_gradient = objective(trial, index[trying])
        finite = torch.isfinite(trial_value) & torch.isfinite(trial_gradient).all(1)
        rise = trial_value - value[trying]
        accepted = finite & (rise <= ARMIJO * step[trying] * slope[trying])
        winners = trying[accepted]
        best_x[winners], best_value[winners] = trial[accepted], trial_value[accepted]
        best_gradient[winners] = trial_gradient[accepted]
        done[winners] = True
        # The minimum of the parabola through value, slope and trial, kept within [0.1, 0.5].
        old = step[trying]
        curvature = 2.0 * (rise - slope[trying] * old)
        shrink = torch.where(finite, -slope[trying] * old / curvature, 0.1).nan_to_num(0.5)
        step[trying] = old * shrink.clamp(0.1, 0.5)
        trying = trying[~accepted]
        if len(trying) == 0:
            break
    return best_x, best_value, best_gradient, done


def minimise(
    objective: Objective,
    x0: Tensor,
    iterations: int = 500,
    history: int = 20,
    tolerance: float = 1e-6,
    on_iteration: Callable[[int, Tensor], None] | None = None,
) -> Result:
    """Minimise C independent functions of D variables each.

    Args:
        objective: values and gradients of some of the problems.
        x0: starting points, (C, D).
        iterations: at most so many each.
        history: pairs kept for the Hessian's approximation.
        tolerance: converged when a step lowers the value by less than this fraction of it three
            times running, or the gradient vanishes.
        on_iteration: called with the iteration's number and all values (C,).

    Returns:
        The best point of each problem: never worse than ``x0``.
    """
    x = x0.clone()
    everyone = torch.arange(len(x), device=x.device)
    value, gradient = objective(x, everyone)
    taken = torch.zeros(len(x), dtype=torch.long, device=x.device)
    status = [UNFINISHED] * len(x)
    sound = torch.isfinite(value) & torch.isfinite(gradient).all(1)
    note(status, everyone[~sound], NOT_FINITE)
    active = everyone[sound]
    memory = History(history)
    quiet = torch.zeros_like(active)
    fresh = torch.ones_like(active, dtype=torch.bool)
    for iteration in range(iterations):
        if len(active) == 0:
            break
        here, below, g = x[active], value[active], gradient[active]
        d = memory.direction(g)
        slope = (d * g).sum(1)
        uphill = ~(slope < 0)
        d, slope = torch.where(uphill[:, None], -g, d), torch.where(uphill, -(g * g).sum(1), slope)
        length = g.norm(dim=1).clamp(min=1e-300)
        first = torch.clamp(1.0 / length, max=1.0)
        step = torch.where(fresh | uphill, first, torch.ones_like(length))
        new_x, new_value, new_gradient, moved = search(
            objective, active, here, below, slope, d, step
        )
        new_gradient = torch.where(moved[:, None], new_gradient, g)
        memory.push(moved, new_x - here, new_gradient - g)
        x[active], value[active], gradient[active] = new_x, new_value, new_gradient
        taken[active] += moved.long()
        small = moved & (below - new_value <= tolerance * new_value.abs())
        quiet = torch.where(moved, torch.where(small, quiet + 1, 0), quiet)
        # A problem that found no lower point restarts from steepest descent once, then stops.
        hopeless = ~moved & fresh
        memory.forget(~moved)
        fresh = ~moved
        finished = ~hopeless & ((quiet >= 3) | (new_gradient.abs().amax(1) == 0))
        note(status, active[finished], CONVERGED)
        note(status, active[hopeless], STALLED)
        going = ~(finished | hopeless)
        if not bool(going.all()):
            memory.keep(going)
            active, quiet, fresh = active[going], quiet[going], fresh[going]
        if on_iteration is not None:
            on_iteration(iteration, value)
    return Result(x, value, taken.cpu(), status)


def note(status: list[str], problems: Tensor, text: str) -> None:
    """Write down why some problems stopped."""
    for problem in problems.tolist():
        status[problem] = text
