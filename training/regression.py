"""Regressors from reduced inputs to latents, all clusters in one batch.

Targets are scaled so that each cluster's have unit total variance: then one α means the same
everywhere. The objective is "Arbitrary BRDFs" eq. 13 as a mean over poses,
σ = mean_i ‖Ỹ − Y‖² + α (Σ‖c‖² + Σ‖d‖²), biases free. The output layer c is linear: for any hidden
layer d the best c has a closed form, so L-BFGS searches over d alone (variable projection, Golub
and Pereyra 1973); the gradient at the best c is the partial gradient with respect to d.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from training.lbfgs import Objective, minimise

__all__ = ["Fit", "average", "fit_linear", "fit_neural"]

JITTER = 30.0  # roundings of the mean diagonal: keeps α = 0 with dependent columns solvable


@dataclass(frozen=True)
class Fit:
    """Weights of every cluster's regressor, and how the fit went.

    Attributes:
        weight, bias: (C, N or K, L) and (C, L).
        hidden_weight, hidden_bias: (C, K, N) and (C, N); None for a linear fit.
        loss: objective of each cluster, of the unit-variance targets, (C,).
        iterations: of each cluster, (C,).
        status: why each cluster's fit stopped.
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


def target_scale(targets: Tensor) -> Tensor:
    """Root of each cluster's total variance, (C, 1, 1); 1 where it has none."""
    variance = (targets - targets.mean(dim=1, keepdim=True)).square().mean(dim=1).sum(dim=-1)
    return torch.where(variance > 0, variance, 1.0).sqrt()[:, None, None]


def ridge(x: Tensor, targets: Tensor, alpha: float, prior: Tensor | None = None) -> Tensor:
    """Weights and, in the last row, the bias: (C, K + 1, L) for x (C, P, K), targets (C, P, L).

    Minimises mean_i ‖x W + b − t‖² + α ‖W‖² + tr Wᵀ S W, S (C, K, K) the ``prior``. The normal
    equations are solved in float64, with as much added to their diagonal as the rounding of their
    entries asks for.
    """
    full = with_ones(x)
    gram = full.mT @ full / x.shape[1]
    if prior is not None:
        gram = gram + torch.nn.functional.pad(prior, (0, 1, 0, 1))
    diagonal = torch.full_like(gram[:, 0], alpha)
    diagonal[:, -1] = 0.0
    mean_diagonal = gram.diagonal(dim1=-2, dim2=-1).mean(-1, keepdim=True)
    rounding = JITTER * torch.finfo(x.dtype).eps * mean_diagonal
    right = (full.mT @ targets / x.shape[1]).double()
    for growth in (1.0, 1e2, 1e4):
        system = (gram + torch.diag_embed(diagonal + growth * rounding)).double()
        factor, failed = torch.linalg.cholesky_ex(system)
        if not failed.any():
            break
    return torch.cholesky_solve(right, factor).to(x.dtype)


def fit_linear(inputs: Tensor, targets: Tensor, alpha: float, prior: Tensor | None = None) -> Fit:
    """Ridge regression of targets (C, P, L) on inputs (C, P, K); ``prior`` as in :func:`ridge`."""
    scale = target_scale(targets)
    solution = ridge(inputs, targets / scale, alpha, prior)
    residual = with_ones(inputs) @ solution - targets / scale
    loss = residual.square().sum(-1).mean(-1) + alpha * solution[:, :-1].square().sum((1, 2))
    if prior is not None:
        loss = loss + (solution[:, :-1] * (prior @ solution[:, :-1])).sum((1, 2))
    weight, bias = solution[:, :-1] * scale, solution[:, -1] * scale[:, 0]
    done = torch.zeros(len(inputs), dtype=torch.long)
    return Fit(weight, bias, None, None, loss, done, ["closed form"] * len(inputs))


def projected_objective(inputs: Tensor, targets: Tensor, neurons: int, alpha: float) -> Objective:
    """σ with the best output layer, as a function of the flattened hidden layer (A, (K+1)·N)."""
    full = with_ones(inputs)
    poses, width = full.shape[1:]

    def objective(flat: Tensor, index: Tensor) -> tuple[Tensor, Tensor]:
        hidden = flat.view(len(flat), width, neurons)
        every = len(index) == len(full)
        x, t = (full, targets) if every else (full[index], targets[index])
        activation = torch.tanh(x @ hidden)
        output = ridge(activation, t, alpha)
        residual = activation @ output[:, :-1] + output[:, -1:] - t
        penalised = hidden[:, :-1]
        value = residual.square().sum((1, 2)) / poses + alpha * (
            output[:, :-1].square().sum((1, 2)) + penalised.square().sum((1, 2))
        )
        slope = (residual @ output[:, :-1].mT) * (1.0 - activation.square())
        gradient = x.mT @ slope * (2.0 / poses)
        gradient[:, :-1] += 2.0 * alpha * penalised
        return value, gradient.reshape(len(flat), -1)

    return objective


def fit_neural(
    inputs: Tensor,
    targets: Tensor,
    neurons: int,
    alpha: float,
    iterations: int = 300,
    seed: int = 0,
    on_iteration: Callable[[int, Tensor], None] | None = None,
) -> Fit:
    """A tanh network per cluster (eq. 12), fitted by variable projection and L-BFGS.

    Args:
        inputs: reduced inputs, (C, P, K), of about unit scale.
        targets: latents, (C, P, L).
        neurons: N.
        alpha: of eq. 13.
        iterations: of L-BFGS, at most.
        seed: of the starting weights.
        on_iteration: called with the iteration's number and every cluster's objective (C,).
    """
    clusters, _, width = inputs.shape
    generator = torch.Generator().manual_seed(seed)
    start = torch.randn(clusters, width + 1, neurons, generator=generator, dtype=torch.float64)
    start = (start / width**0.5).to(inputs)
    scale = target_scale(targets)
    objective = projected_objective(inputs, targets / scale, neurons, alpha)
    result = minimise(objective, start.flatten(1), iterations=iterations, on_iteration=on_iteration)
    hidden = result.x.view(clusters, width + 1, neurons)
    output = ridge(torch.tanh(with_ones(inputs) @ hidden), targets / scale, alpha)
    return Fit(
        output[:, :-1] * scale,
        output[:, -1] * scale[:, 0],
        hidden[:, :-1],
        hidden[:, -1],
        result.value,
        result.iterations,
        result.status,
    )
