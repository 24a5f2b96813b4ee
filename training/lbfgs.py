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

__all__ = ["Objective", "Result", "minimise"]

Objective = Callable[[Tensor, Tensor], tuple[Tensor, Tensor]]
"""(x (A, D), indices (A,) of the problems) -> values (A,), gradients (A, D)."""

ARMIJO = 1e-4
LONGEST_SEARCH = 25
CONVERGED, STALLED, UNFINISHED = "converged", "stalled", "iteration limit"


@dataclass(frozen=True)
class Result:
    """Where each problem ended.

    Attributes:
        x: the best point found, (C, D).
        value: its objective, (C,).
        iterations: taken by each problem, (C,).
        status: why each stopped: converged, stalled (no lower point along the search direction)
            or iteration limit.
    """

    x: Tensor
    value: Tensor
    iterations: Tensor
    status: list[str]


class History:
    """The last ``size`` steps and gradient changes of every problem."""

    def __init__(self, size: int, x: Tensor) -> None:
        self.s = x.new_zeros(size, *x.shape)
        self.y = torch.zeros_like(self.s)
        self.rho = x.new_zeros(size, len(x))
        self.scale = x.new_ones(len(x))
        self.next = 0

    def push(self, index: Tensor, s: Tensor, y: Tensor) -> None:
        """Store a step of the problems ``index``; pairs without positive curvature are left out."""
        sy, yy = (s * y).sum(1), (y * y).sum(1)
        good = sy > 1e-10 * yy
        slot = self.next
        self.s[slot, index], self.y[slot, index] = s, y
        self.rho[slot, index] = torch.where(good, 1.0 / torch.where(good, sy, 1.0), 0.0)
        self.scale[index] = torch.where(good, sy / torch.where(good, yy, 1.0), self.scale[index])
        self.next = (slot + 1) % len(self.s)

    def forget(self, index: Tensor) -> None:
        """Start the problems ``index`` afresh, from steepest descent."""
        self.rho[:, index] = 0.0
        self.scale[index] = 1.0

    def direction(self, index: Tensor, gradient: Tensor) -> Tensor:
        """−H g by the two-loop recursion; a pair that was left out has ρ = 0 and does nothing."""
        s, y, rho = self.s[:, index], self.y[:, index], self.rho[:, index]
        size = len(s)
        newest_first = [(self.next - 1 - k) % size for k in range(size)]
        q = gradient.clone()
        alpha = [q.new_zeros(len(q))] * size
        for k in newest_first:
            alpha[k] = rho[k] * (s[k] * q).sum(1)
            q -= alpha[k][:, None] * y[k]
        q *= self.scale[index][:, None]
        for k in reversed(newest_first):
            beta = rho[k] * (y[k] * q).sum(1)
            q += (alpha[k] - beta)[:, None] * s[k]
        return -q


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
    memory = History(history, x)
    taken = torch.zeros(len(x), dtype=torch.long)
    quiet = torch.zeros(len(x), dtype=torch.long, device=x.device)
    fresh = torch.ones(len(x), dtype=torch.bool, device=x.device)
    status = [UNFINISHED] * len(x)
    sound = torch.isfinite(value) & torch.isfinite(gradient).all(1)
    for lost in everyone[~sound].tolist():
        status[lost] = STALLED
    active = everyone[sound]
    for iteration in range(iterations):
        if len(active) == 0:
            break
        g = gradient[active]
        d = memory.direction(active, g)
        slope = (d * g).sum(1)
        uphill = ~(slope < 0)
        d, slope = torch.where(uphill[:, None], -g, d), torch.where(uphill, -(g * g).sum(1), slope)
        first = fresh[active] | uphill
        length = g.norm(dim=1).clamp(min=1e-300)
        step = torch.where(first, torch.clamp(1.0 / length, max=1.0), torch.ones_like(length))
        new_x, new_value, new_gradient, moved = search(
            objective, active, x[active], value[active], slope, d, step
        )
        went = active[moved]
        memory.push(went, new_x[moved] - x[went], new_gradient[moved] - g[moved])
        gain = value[went] - new_value[moved]
        quiet[went] = torch.where(gain <= tolerance * new_value[moved].abs(), quiet[went] + 1, 0)
        x[went], value[went], gradient[went] = new_x[moved], new_value[moved], new_gradient[moved]
        taken[went.cpu()] += 1
        # A problem that found no lower point restarts from steepest descent once, then stops.
        stuck = active[~moved]
        hopeless = stuck[fresh[stuck]]
        memory.forget(stuck)
        fresh[went], fresh[stuck] = False, True
        finished = active[(quiet[active] >= 3) | (gradient[active].abs().amax(1) == 0)]
        for problem in finished.tolist():
            status[problem] = CONVERGED
        for problem in hopeless.tolist():
            status[problem] = STALLED
        leaving = torch.cat([finished, hopeless])
        active = active[~torch.isin(active, leaving)]
        if on_iteration is not None:
            on_iteration(iteration, value)
    return Result(x, value, taken, status)
