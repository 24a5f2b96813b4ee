"""Regressors from reduced inputs to latents, all clusters in one batch.

Targets are scaled so that each cluster's have unit total variance: then one α means the same
everywhere. The objective is "Arbitrary BRDFs" eq. 13 as a mean over poses,
σ = mean_i ‖Ỹ − Y‖² + α (Σ‖c‖² + Σ‖d‖²), biases free. The output layer c is linear: for any hidden
layer d the best c has a closed form, so L-BFGS searches over d alone (variable projection, Golub
and Pereyra 1973); the gradient at the best c is the partial gradient with respect to d.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from prtnet.cores import thread_count
from prtnet.errors import PrtnetError
from prtnet.exchange import Exchange, Given, Result, exchange
from training.lbfgs import NOT_FINITE, Objective, minimise
from training.runs import OnIteration, in_runs

__all__ = [
    "Fit",
    "Networks",
    "average",
    "fit_linear",
    "fit_neural",
    "total_iterations",
]

CLOSED_FORM, CONSTANT = "closed form", "constant"
START_ALPHA = 1e-2  # of the ridge regression that networks start near
START_GAIN = 0.3  # how far into its bend a neuron sees at the start
START_ELSEWHERE = 0.2  # weight of directions the ridge regression does not look along
SCREENING = 20  # iterations after which restarts are compared
CLUSTERS = 4  # of a block: fewer waste time on small products, more leave workers without any
RUN = 2_000_000  # products of a layer for each thread: with fewer, threads wait for Python
JITTER = 30.0  # roundings of the mean diagonal: keeps α = 0 with dependent columns solvable


@dataclass(frozen=True)
class Fit:
    """Weights of every cluster's regressor, and how the fit went.

    Attributes:
        weight, bias: (C, N or K, L) and (C, L).
        hidden_weight, hidden_bias: (C, K, N) and (C, N); None for a linear fit.
        loss: objective of each cluster, of the unit-variance targets, (C,).
        iterations: of each cluster, (C,).
        status: why each cluster's fit stopped; constant where there was nothing to fit.
    """

    weight: Tensor
    bias: Tensor
    hidden_weight: Tensor | None
    hidden_bias: Tensor | None
    loss: Tensor
    iterations: Tensor
    status: list[str]

    def __call__(self, inputs: Tensor) -> Tensor:
        """Latents (C, P, L) of reduced inputs (C, P, K)."""
        value = inputs
        if self.hidden_weight is not None and self.hidden_bias is not None:
            value = torch.tanh(value @ self.hidden_weight + self.hidden_bias[:, None])
        return value @ self.weight + self.bias[:, None]


def average(fits: Sequence[Fit]) -> Fit:
    """The mean of several fits as one: networks stand side by side, their outputs divided."""
    first = fits[0]
    if len(fits) == 1:
        return first
    if first.hidden_weight is None or first.hidden_bias is None:
        raise ValueError("only networks are averaged")
    return Fit(
        torch.cat([f.weight for f in fits], dim=1) / len(fits),
        torch.stack([f.bias for f in fits]).mean(0),
        torch.cat([f.hidden_weight for f in fits if f.hidden_weight is not None], dim=2),
        torch.cat([f.hidden_bias for f in fits if f.hidden_bias is not None], dim=1),
        torch.stack([f.loss for f in fits]).mean(0),
        torch.stack([f.iterations for f in fits]).amax(0),
        first.status,
    )


def with_ones(x: Tensor) -> Tensor:
    """A column of ones behind the last: (..., P, K) -> (..., P, K + 1)."""
    return torch.cat([x, torch.ones_like(x[..., :1])], dim=-1)


def target_variance(targets: Tensor) -> Tensor:
    """Each cluster's total variance, (C,), of targets (C, P, L)."""
    return (targets - targets.mean(dim=1, keepdim=True)).square().mean(dim=1).sum(dim=-1)


def target_scale(targets: Tensor) -> Tensor:
    """Root of each cluster's total variance, (C, 1, 1); 1 where it has none."""
    variance = target_variance(targets)
    return torch.where(variance > 0, variance, 1.0).sqrt()[:, None, None]


def ridge(x: Tensor, targets: Tensor, alpha: float, prior: Tensor | None = None) -> Tensor:
    """Weights and, in the last row, the bias: (C, K + 1, L) for x (C, P, K), targets (C, P, L).

    Minimises mean_i ‖x W + b − t‖² + α ‖W‖² + tr Wᵀ S W, S (C, K, K) the ``prior``.
    """
    return solve_ridge(with_ones(x), targets, alpha, prior)


def solve_ridge(full: Tensor, targets: Tensor, alpha: float, prior: Tensor | None = None) -> Tensor:
    """As :func:`ridge`, for inputs (C, P, K + 1) whose last column is ones.

    The normal equations are solved in float64, with as much added to their diagonal as the
    rounding of their entries asks for.
    """
    poses = full.shape[1]
    gram = full.mT @ full / poses
    if prior is not None:
        gram = gram + torch.nn.functional.pad(prior, (0, 1, 0, 1))
    diagonal = torch.full_like(gram[:, 0], alpha)
    diagonal[:, -1] = 0.0
    mean_diagonal = gram.diagonal(dim1=-2, dim2=-1).mean(-1, keepdim=True)
    rounding = JITTER * torch.finfo(full.dtype).eps * mean_diagonal
    right = (full.mT @ targets / poses).double()
    for _ in range(3):
        system = (gram + torch.diag_embed(diagonal + rounding)).double()
        factor, failed = torch.linalg.cholesky_ex(system)
        if not failed.any():
            break
        rounding = torch.where(failed[:, None] > 0, 1e2 * rounding, rounding)
    return torch.cholesky_solve(right, factor).to(full.dtype)


def require_finite(inputs: Tensor, targets: Tensor) -> None:
    """One line for a number that is not finite, rather than a model full of them."""
    for name, table in (("inputs", inputs), ("targets", targets)):
        bad = ~torch.isfinite(table).all(2).all(1)
        if bool(bad.any()):
            first = int(bad.nonzero()[0, 0])
            raise PrtnetError(
                "training data",
                f"cluster {first} has {name} that are not finite; generate the dataset again",
            )


def fit_varying(
    inputs: Tensor, targets: Tensor, fit: Callable[[Tensor, Tensor, Tensor], Fit]
) -> Fit:
    """Fit the clusters whose targets vary; the others cost nothing and predict their mean.

    So does, whatever happens, a cluster whose fit is not finite.

    Args:
        inputs: (C, P, K).
        targets: (C, P, L).
        fit: fits some of the clusters, (A, P, K) and (A, P, L), to targets of unit variance; which
            they are is its third argument, (A,).
    """
    if targets.shape[2] == 1:  # torch rounds a single column by how many clusters there are
        two = fit_varying(inputs, torch.cat([targets, torch.zeros_like(targets)], dim=2), fit)
        return replace(two, weight=two.weight[..., :1], bias=two.bias[..., :1])
    require_finite(inputs, targets)
    scale, mean = target_scale(targets), targets.mean(dim=1)
    rounding = (8.0 * torch.finfo(targets.dtype).eps) ** 2
    varies = target_variance(targets) > rounding * targets.square().mean(dim=1).sum(dim=-1)
    alive = varies.nonzero()[:, 0]
    if len(alive) == 0:  # one is fitted all the same: for the shapes
        alive = torch.zeros(1, dtype=torch.long, device=inputs.device)
    part = fit(inputs[alive], targets[alive] / scale[alive], alive)
    sound = varies[alive] & torch.isfinite(part.loss)
    for layer in (part.weight, part.bias, part.hidden_weight, part.hidden_bias):
        if layer is not None:
            sound &= torch.isfinite(layer).flatten(1).all(1)
    fitted = alive[sound]

    def everywhere(values: Tensor) -> Tensor:
        whole = values.new_zeros(len(inputs), *values.shape[1:])
        whole[fitted] = values[sound]
        return whole

    bias = mean.clone()
    bias[fitted] = part.bias[sound] * scale[fitted, 0]
    status = [CONSTANT] * len(inputs)
    iterations = torch.zeros(len(inputs), dtype=torch.long)
    for cluster, row, good in zip(alive.tolist(), range(len(alive)), sound.tolist(), strict=True):
        if good:
            status[cluster], iterations[cluster] = part.status[row], part.iterations[row]
        elif bool(varies[cluster]):
            status[cluster] = NOT_FINITE
    return Fit(
        everywhere(part.weight) * scale,
        bias,
        None if part.hidden_weight is None else everywhere(part.hidden_weight),
        None if part.hidden_bias is None else everywhere(part.hidden_bias),
        everywhere(part.loss),
        iterations,
        status,
    )


def fit_linear(inputs: Tensor, targets: Tensor, alpha: float, prior: Tensor | None = None) -> Fit:
    """Ridge regression of targets (C, P, L) on inputs (C, P, K); ``prior`` as in :func:`ridge`.

    Raises:
        PrtnetError: an input or a target is not finite.
    """

    def fit(x: Tensor, t: Tensor, index: Tensor) -> Fit:
        form = None if prior is None else prior[index]

        def run(first: int, end: int, _: OnIteration) -> Fit:
            own = None if form is None else form[first:end]
            return closed_form(x[first:end], t[first:end], alpha, own)

        return fitted_in_runs(run, x, x.shape[2])

    return fit_varying(inputs, targets, fit)


def closed_form(x: Tensor, t: Tensor, alpha: float, form: Tensor | None) -> Fit:
    """The ridge regressions of some clusters; see :func:`ridge`."""
    solution = ridge(x, t, alpha, form)
    weight, bias = solution[:, :-1], solution[:, -1]
    residual = with_ones(x) @ solution - t
    loss = residual.square().sum(-1).mean(-1) + alpha * weight.square().sum((1, 2))
    if form is not None:
        loss = loss + (weight * (form @ weight)).sum((1, 2))
    done = torch.zeros(len(x), dtype=torch.long)
    return Fit(weight, bias, None, None, loss, done, [CLOSED_FORM] * len(x))


def projected_objective(inputs: Tensor, targets: Tensor, neurons: int, alpha: float) -> Objective:
    """σ with the best output layer, as a function of the flattened hidden layer (A, (K+1)·N).

    Large arrays are reused in place: fresh memory costs as much here as the arithmetic.
    """
    full = with_ones(inputs)
    poses, width = full.shape[1:]

    def objective(flat: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
        hidden = flat.view(len(flat), width, neurons)
        every = len(index) == len(full)
        x, t = (full, targets) if every else (full[index], targets[index])
        activation = with_ones((x @ hidden).tanh_())
        output = solve_ridge(activation, t, alpha)
        residual = torch.baddbmm(t, activation, output, beta=-1.0)
        penalised, weights = hidden[:, :-1], output[:, :-1]
        value = torch.linalg.vecdot(residual.flatten(1), residual.flatten(1)) / poses + alpha * (
            weights.square().sum((1, 2)) + penalised.square().sum((1, 2))
        )
        sensitivity = activation[..., :-1].square_().neg_().add_(1.0)  # of tanh
        slope = (residual @ weights.mT).mul_(sensitivity)
        gradient = x.mT @ slope * (2.0 / poses)
        gradient[:, :-1] += 2.0 * alpha * penalised
        return value, gradient.reshape(len(flat), -1)

    return objective


def start_near_ridge(
    x: Tensor, t: Tensor, neurons: int, generator: torch.Generator, first: int, of: int
) -> Tensor:
    """Flattened hidden layers (A, (K+1)·N) that already see what a line would.

    Each neuron looks along a random mixture of the ridge regression's directions, and a little
    elsewhere, where tanh hardly bends; random biases spread the neurons over its range. From here
    half the iterations go as far as from random weights. Random numbers are drawn for ``of``
    clusters, of which these are those from ``first`` on: a block has the numbers of its place.
    """
    clusters, _, width = x.shape

    def normal(*shape: int) -> Tensor:
        drawn = torch.randn(of, *shape, generator=generator, dtype=torch.float64)
        return drawn[first : first + clusters].to(x)

    directions = ridge(x, t, START_ALPHA)[:, :-1] @ normal(t.shape[2], neurons)
    spread = (x @ directions).square().mean(dim=1, keepdim=True).sqrt()
    along = START_GAIN * directions / torch.where(spread > 0, spread, 1.0)
    weights = along + START_ELSEWHERE * normal(width, neurons) / width**0.5
    return torch.cat([weights, normal(1, neurons)], dim=1).flatten(1)


def best_start(
    objective: Objective,
    starts: Sequence[Tensor],
    iterations: int,
    on_iteration: OnIteration | None,
) -> tuple[Tensor, Tensor]:
    """Each problem's best of several starts after some iterations from each, and how many it took.

    One start is handed back as it is.
    """
    if len(starts) == 1:
        return starts[0], torch.zeros(len(starts[0]), dtype=torch.long)
    tried = [
        minimise(
            objective,
            start,
            iterations=iterations,
            on_iteration=None if on_iteration is None else shifted(on_iteration, k * iterations),
        )
        for k, start in enumerate(starts)
    ]
    values = torch.stack([result.value for result in tried]).nan_to_num(torch.inf)
    best = values.argmin(dim=0)
    points = torch.stack([result.x for result in tried])
    taken = torch.stack([result.iterations for result in tried])
    each = torch.arange(len(best), device=best.device)
    return points[best, each], taken[best.cpu(), each.cpu()]


def shifted(on_iteration: OnIteration, offset: int) -> OnIteration:
    """The same, counting from ``offset``."""
    return lambda iteration, values: on_iteration(iteration + offset, values)


def total_iterations(iterations: int, restarts: int) -> int:
    """How many iterations :func:`fit_neural` counts at most."""
    return iterations if restarts == 1 else iterations + restarts * min(SCREENING, iterations)


@dataclass(frozen=True)
class Networks:
    """How networks are fitted to targets of unit variance; see :func:`fit_neural`."""

    neurons: int
    alpha: float
    iterations: int = 300
    seed: int = 0
    restarts: int = 1

    def __call__(
        self,
        x: Tensor,
        t: Tensor,
        on_iteration: OnIteration | None = None,
        first: int = 0,
        of: int | None = None,
    ) -> Fit:
        """The fits of inputs (A, P, K) to targets (A, P, L), all in one batch.

        Clusters do not see each other: computed by one thread, a block of them, from the ``first``
        on out of ``of``, has the bytes that it has in the batch of all.
        """
        if self.neurons == 1 and len(x) > 1:  # a single column again
            every = len(x) if of is None else of
            rows = range(len(x))
            alone = [self(x[k : k + 1], t[k : k + 1], None, first + k, every) for k in rows]
            found = joined(alone)
            if on_iteration is not None:
                on_iteration(total_iterations(self.iterations, self.restarts) - 1, found.loss)
            return found
        objective = projected_objective(x, t, self.neurons, self.alpha)
        generator = torch.Generator().manual_seed(self.seed)
        place = first, len(x) if of is None else of
        starts = [
            start_near_ridge(x, t, self.neurons, generator, *place) for _ in range(self.restarts)
        ]
        screening = min(SCREENING, self.iterations)
        start, before = best_start(objective, starts, screening, on_iteration)
        offset = total_iterations(self.iterations, self.restarts) - self.iterations
        result = minimise(
            objective,
            start,
            iterations=self.iterations,
            on_iteration=None if on_iteration is None else shifted(on_iteration, offset),
        )
        hidden = result.x.view(len(x), -1, self.neurons)
        output = ridge(torch.tanh(with_ones(x) @ hidden), t, self.alpha)
        return Fit(
            output[:, :-1], output[:, -1], hidden[:, :-1], hidden[:, -1],
            result.value, before + result.iterations, result.status,
        )  # fmt: skip


TENSORS = ("weight", "bias", "hidden_weight", "hidden_bias", "loss", "iterations")


@dataclass(frozen=True)
class FitBlock:
    """The networks of some clusters out of more: work that can be handed over.

    Attributes:
        how: networks are fitted.
        clusters: in all blocks.
    """

    how: Networks
    clusters: int

    def __call__(self, number: int, given: Given) -> Result:
        """See ``prtnet.exchange.Work``."""
        torch.set_num_threads(1)
        rows = slice(number * CLUSTERS, (number + 1) * CLUSTERS)
        x, t = (torch.from_numpy(given.part(name, rows)) for name in ("inputs", "targets"))
        found = self.how(x, t, first=rows.start, of=self.clusters)
        return {"status": found.status}, {n: getattr(found, n).numpy() for n in TENSORS}


def fit_in_blocks(
    place: Exchange, how: Networks, x: Tensor, t: Tensor, on_iteration: OnIteration | None
) -> Fit:
    """As ``how(x, t)``; told of whole blocks, as if of all iterations in equal parts."""
    blocks = -(-len(x) // CLUSTERS)
    limit = total_iterations(how.iterations, how.restarts)
    found: dict[int, Fit] = {}
    given = {"inputs": x.numpy(), "targets": t.numpy()}
    for number, header, arrays in place.run(FitBlock(how, len(x)), given, blocks):
        tensors = {name: torch.from_numpy(arrays[name]) for name in TENSORS}
        found[number] = Fit(**tensors, status=header["status"])
        if on_iteration is not None:
            losses = torch.cat([fit.loss for fit in found.values()])
            on_iteration(max(1, limit * len(found) // blocks) - 1, losses)
    return joined([found[number] for number in range(blocks)])


def fit_in_runs(how: Networks, x: Tensor, t: Tensor, on_iteration: OnIteration | None) -> Fit:
    """As ``how(x, t)`` by one thread, by as many as have enough to do."""

    def fit(first: int, end: int, told: OnIteration) -> Fit:
        return how(x[first:end], t[first:end], told, first, len(x))

    return fitted_in_runs(fit, x, how.neurons, on_iteration)


def fitted_in_runs(
    fit: Callable[[int, int, OnIteration], Fit],
    x: Tensor,
    columns: int,
    on_iteration: OnIteration | None = None,
) -> Fit:
    """The fits of clusters from a first to before another, in runs; all at once on a GPU.

    Args:
        fit: those of some.
        x: inputs (C, P, K).
        columns: that they are multiplied by.
        on_iteration: told of all.
    """
    if x.device.type != "cpu":
        return fit(0, len(x), on_iteration or (lambda *_: None))
    runs = max(1, min(thread_count(), x.numel() * columns // RUN))
    return joined(in_runs(fit, len(x), runs, on_iteration))


def joined(fits: Sequence[Fit]) -> Fit:
    """Fits of some clusters after others."""
    columns = {name: [getattr(fit, name) for fit in fits] for name in TENSORS}
    tensors: dict[str, Any] = {
        name: None if own[0] is None else torch.cat(own) for name, own in columns.items()
    }
    return Fit(**tensors, status=[text for fit in fits for text in fit.status])


def fit_neural(
    inputs: Tensor,
    targets: Tensor,
    neurons: int,
    alpha: float,
    iterations: int = 300,
    seed: int = 0,
    on_iteration: OnIteration | None = None,
    restarts: int = 1,
) -> Fit:
    """A tanh network per cluster (eq. 12), fitted by variable projection and L-BFGS.

    Args:
        inputs: reduced inputs, (C, P, K), of about unit scale.
        targets: latents, (C, P, L).
        neurons: N.
        alpha: of eq. 13.
        iterations: of L-BFGS, at most.
        seed: of the starting weights.
        on_iteration: called with the iteration's number, below :func:`total_iterations`, and the
            objective of every cluster that varies.
        restarts: starts of which every cluster keeps the best after a few iterations.

    Raises:
        PrtnetError: an input or a target is not finite.
    """
    how = Networks(neurons, alpha, iterations, seed, restarts)
    place = exchange()

    def fit(x: Tensor, t: Tensor, _: Tensor) -> Fit:
        if place is not None:
            return fit_in_blocks(place, how, x, t, on_iteration)
        return fit_in_runs(how, x, t, on_iteration)

    return fit_varying(inputs, targets, fit)
