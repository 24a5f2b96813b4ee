"""One small network for all receivers, by Adam on random pairs of a pose and a receiver.

Its inputs are what :class:`prtnet.prior.NetworkPrior` describes. Each receiver's code starts from
the principal components of its mean features and mean visibility, and is learned with the rest.
The step follows one cosine; what is kept is a running mean of the weights.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from training.prior_samples import Samples

__all__ = ["Layers", "NetworkConfig", "fit_network"]

WARM_UP = 200  # steps
MEMORY = 0.998  # of the running mean of the weights
QUIET = 1e-6  # a feature that varies less does not vary


@dataclass(frozen=True)
class NetworkConfig:
    """Size of the network and length of its training."""

    width: int = 64
    depth: int = 2
    codes: int = 16
    steps: int = 6000
    batch: int = 4096
    rate: float = 3e-3
    decay: float = 1e-3
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Layers:
    """A fitted network.

    Attributes:
        code: (V, G).
        weights, biases: of the layers, the inputs' scale folded into the first.
        loss: mean squared error of the last steps over the mean square of the deviations.
    """

    code: FloatArray
    weights: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
    loss: float


def starting_codes(samples: Samples, mean: FloatArray, count: int) -> FloatArray:
    """Leading principal components of receivers' mean features and visibility, (V, count)."""
    seen = np.bincount(samples.receiver, minlength=len(mean))[:, None]
    total = np.zeros((len(mean), samples.features.shape[1]))
    np.add.at(total, samples.receiver, samples.features)
    known = total / np.maximum(seen, 1)
    overall = samples.features.mean(axis=0, dtype=np.float64)
    table = np.concatenate([np.where(seen > 0, known, overall), mean], axis=1)
    table -= table.mean(axis=0)
    table /= np.maximum(table.std(axis=0), QUIET)
    left, singular, _ = np.linalg.svd(table, full_matrices=False)
    codes = np.zeros((len(mean), count))
    kept = min(count, left.shape[1])
    codes[:, :kept] = left[:, :kept] * singular[:kept]
    return codes / max(float(codes.std()), QUIET)


def fit_network(
    samples: Samples,
    mean: FloatArray,
    config: NetworkConfig,
    device: str = "cpu",
    on_step: Callable[[int, int, float], None] | None = None,
) -> Layers:
    """Fit the network to samples.

    Args:
        samples: pairs of a pose and a receiver.
        mean: visibility's mean over the training poses, (V, n²).
        config: size and effort.
        device: where torch computes.
        on_step: called now and then with steps done, steps in all and the relative loss.

    Raises:
        PrtnetError: the loss is not finite.
    """
    generator = torch.Generator().manual_seed(config.seed)
    features = torch.from_numpy(samples.features).to(device)
    target = torch.from_numpy(samples.deviation).to(device)
    receiver = torch.from_numpy(samples.receiver.astype(np.int64)).to(device)
    shift, spread = features.mean(0), features.std(0).nan_to_num(0.0)
    scale = torch.where(spread > QUIET, 1.0 / spread.clamp(min=QUIET), 0.0)
    energy = float(target.square().sum(1).mean()) or 1.0

    start = starting_codes(samples, mean, config.codes).astype(np.float32)
    code = torch.from_numpy(start).to(device).requires_grad_()
    sizes = [len(shift) + config.codes, *[config.width] * config.depth, target.shape[1]]
    pairs = list(itertools.pairwise(sizes))
    layers = [made(a, b, generator, device) for a, b in pairs[:-1]]
    layers.append(made(*pairs[-1], None, device))
    inner = [p for layer in layers for p in layer]
    groups = [{"params": inner, "weight_decay": config.decay},
              {"params": [code], "weight_decay": 0.0}]  # fmt: skip
    optimiser = torch.optim.AdamW(groups, lr=config.rate)
    smooth = [p.detach().clone() for p in (*inner, code)]

    def predict(rows: Tensor) -> Tensor:
        value = torch.cat([(features[rows] - shift) * scale, code[receiver[rows]]], dim=1)
        for index, (weight, bias) in enumerate(layers):
            value = functional.linear(torch.tanh(value) if index else value, weight, bias)
        return value

    recent = 1.0
    order, position = torch.randperm(len(features), generator=generator), 0
    for step in range(config.steps):
        if position + config.batch > len(order) and position:
            order, position = torch.randperm(len(features), generator=generator), 0
        rows = order[position : position + config.batch].to(device)
        position += config.batch
        pace = min(1.0, (step + 1) / WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / config.steps))
        for group in optimiser.param_groups:
            group["lr"] = config.rate * pace
        loss = (predict(rows) - target[rows]).square().sum(1).mean() / energy
        optimiser.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        optimiser.step()
        with torch.no_grad():
            keep = min(MEMORY, (1.0 + step) / (10.0 + step))
            for mean_of, now in zip(smooth, (*inner, code), strict=True):
                mean_of.lerp_(now, 1.0 - keep)
        if step % 50 == 49 or step + 1 == config.steps:
            recent = float(loss.detach())
            if not math.isfinite(recent):
                raise PrtnetError(
                    "training data", f"the shared network's loss is not finite after {step + 1} "
                    "steps: visibility or what receivers see is beyond single precision; check "
                    "the dataset, or train --kind hybrid"
                )  # fmt: skip
            if on_step is not None:
                on_step(step + 1, config.steps, recent)
    return folded(smooth, shift, scale, recent)


def made(
    inputs: int, outputs: int, generator: torch.Generator | None, device: str
) -> tuple[Tensor, Tensor]:
    """Weights (outputs, inputs) of variance 1 / inputs, zero without a generator, and biases."""
    weight = torch.zeros(outputs, inputs)
    if generator is not None:
        weight.normal_(0.0, inputs**-0.5, generator=generator)
    bias = torch.zeros(outputs)
    return weight.to(device).requires_grad_(), bias.to(device).requires_grad_()


def folded(smooth: list[Tensor], shift: Tensor, scale: Tensor, loss: float) -> Layers:
    """The network with the standardisation of its inputs in its first layer."""
    *inner, code = (p.cpu().double().numpy() for p in smooth)
    weights = [weight.T.copy() for weight in inner[::2]]
    biases = list(inner[1::2])
    own = scale.cpu().double().numpy()
    known = len(own)
    biases[0] = biases[0] - (shift.cpu().double().numpy() * own) @ weights[0][:known]
    weights[0][:known] *= own[:, None]
    return Layers(
        code.astype(np.float32),
        tuple(weight.astype(np.float32) for weight in weights),
        tuple(bias.astype(np.float32) for bias in biases),
        loss,
    )
