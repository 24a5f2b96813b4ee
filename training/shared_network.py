"""One small network for all receivers, by Adam on random pairs of a pose and a receiver.

Its inputs are what :class:`prtnet.prior.NetworkPrior` describes. Each receiver's code starts from
the principal components of its mean features and mean visibility, and is learned with the rest.
The step follows one cosine; what is kept is a running mean of the weights.

A batch's gradient is the sum of those of parts of a fixed size, one thread each, added in order:
so the number of threads changes no byte.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from prtnet.arrays import FloatArray
from prtnet.cores import Each, in_threads, one_by_one
from prtnet.errors import PrtnetError
from training.prior_samples import Samples

__all__ = ["Layers", "NetworkConfig", "fit_network"]

WARM_UP = 200  # steps
MEMORY = 0.998  # of the running mean of the weights
QUIET = 1e-6  # a feature that varies less does not vary
PART = 512  # samples of a batch whose gradient is one thread's


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


class Network:
    """What is fitted, as it is now.

    Attributes:
        layers: weights (outputs, inputs) and biases (outputs,) of each.
        code: of each receiver, (V, G).
    """

    def __init__(self, samples: Samples, mean: FloatArray, config: NetworkConfig, device: str):
        self.generator = torch.Generator().manual_seed(config.seed)
        self.features = torch.from_numpy(samples.features).to(device)
        self.target = torch.from_numpy(samples.deviation).to(device)
        self.receiver = torch.from_numpy(samples.receiver.astype(np.int64)).to(device)
        self.shift, spread = self.features.mean(0), self.features.std(0).nan_to_num(0.0)
        self.scale = torch.where(spread > QUIET, 1.0 / spread.clamp(min=QUIET), 0.0)
        start = starting_codes(samples, mean, config.codes).astype(np.float32)
        self.code = torch.from_numpy(start).to(device)
        inputs = len(self.shift) + config.codes
        sizes = [inputs, *[config.width] * config.depth, self.target.shape[1]]
        pairs = list(itertools.pairwise(sizes))
        self.layers = [made(a, b, self.generator, device) for a, b in pairs[:-1]]
        self.layers.append(made(*pairs[-1], None, device))

    @property
    def inner(self) -> list[Tensor]:
        """Weights and biases of the layers, from the first on."""
        return [parameter for layer in self.layers for parameter in layer]

    def descent(self, rows: Tensor) -> tuple[Tensor, list[Tensor], Tensor]:
        """The squared error of samples (B,), summed, and half its gradient.

        Returns:
            the error; the gradient with respect to ``inner``; that with respect to the codes of
            the samples' receivers, (B, G).
        """
        seen = (self.features[rows] - self.shift) * self.scale
        values = [torch.cat([seen, self.code[self.receiver[rows]]], dim=1)]
        for weight, bias in self.layers[:-1]:
            values.append(torch.addmm(bias, values[-1], weight.T).tanh_())
        weight, bias = self.layers[-1]
        slope = torch.addmm(bias, values[-1], weight.T) - self.target[rows]
        error = slope.square().sum()
        gradients: list[Tensor] = []
        for index in range(len(self.layers) - 1, -1, -1):
            gradients[:0] = [slope.T @ values[index], slope.sum(0)]
            slope = slope @ self.layers[index][0]
            if index:
                slope *= 1.0 - values[index].square()
        return error, gradients, slope[:, seen.shape[1] :]

    def gradient(self, rows: Tensor, energy: float, each: Each, part: int) -> Tensor:
        """Set every parameter's gradient of the mean squared error of samples (B,) over ``energy``,
        worked out by parts of so many.

        Returns:
            the mean squared error over ``energy``.
        """
        parts = list(each(self.descent, torch.split(rows, part)))
        factor = 2.0 / (len(rows) * energy)
        for parameter, own in zip(
            self.inner, zip(*(found[1] for found in parts), strict=True), strict=True
        ):
            total = own[0]
            for further in own[1:]:
                total += further
            parameter.grad = total.mul_(factor)
        codes = torch.cat([found[2] for found in parts]).mul_(factor)
        where = (self.receiver[rows],)  # on CUDA in one order, which index_add_ has not
        self.code.grad = torch.zeros_like(self.code).index_put_(where, codes, accumulate=True)
        return torch.stack([found[0] for found in parts]).sum() / (len(rows) * energy)


def fit_network(
    samples: Samples,
    mean: FloatArray,
    config: NetworkConfig,
    device: str = "cpu",
    on_step: Callable[[int, int, float], None] | None = None,
) -> Layers:
    """Fit the network to samples, by ``thread_count()`` threads.

    Args:
        samples: pairs of a pose and a receiver.
        mean: visibility's mean over the training poses, (V, n²).
        config: size and effort.
        device: where torch computes.
        on_step: called now and then with steps done, steps in all and the relative loss.

    Raises:
        PrtnetError: the loss is not finite.
    """
    with in_threads() as each:
        network = Network(samples, mean, config, device)
        parts = (each, PART) if device == "cpu" else (one_by_one, config.batch)
        return trained(network, config, on_step, *parts)


def trained(
    network: Network,
    config: NetworkConfig,
    on_step: Callable[[int, int, float], None] | None,
    each: Each,
    part: int,
) -> Layers:
    """The network after all steps; see :func:`fit_network` and :meth:`Network.gradient`."""
    inner, code = network.inner, network.code
    groups = [{"params": inner, "weight_decay": config.decay},
              {"params": [code], "weight_decay": 0.0}]  # fmt: skip
    optimiser = torch.optim.AdamW(groups, lr=config.rate)
    smooth = [p.clone() for p in (*inner, code)]
    energy = float(network.target.square().sum(1).mean()) or 1.0
    recent = 1.0
    for step, rows in enumerate(itertools.islice(batches(network, config), config.steps)):
        pace = min(1.0, (step + 1) / WARM_UP) * 0.5 * (1 + math.cos(math.pi * step / config.steps))
        for group in optimiser.param_groups:
            group["lr"] = config.rate * pace
        loss = network.gradient(rows, energy, each, part)
        optimiser.step()
        keep = min(MEMORY, (1.0 + step) / (10.0 + step))
        for mean_of, now in zip(smooth, (*inner, code), strict=True):
            mean_of.lerp_(now, 1.0 - keep)
        if step % 50 == 49 or step + 1 == config.steps:
            recent = float(loss)
            if not math.isfinite(recent):
                raise PrtnetError(
                    "training data", f"the shared network's loss is not finite after {step + 1} "
                    "steps: visibility or what receivers see is beyond single precision; check "
                    "the dataset, or train --kind hybrid"
                )  # fmt: skip
            if on_step is not None:
                on_step(step + 1, config.steps, recent)
    return folded(smooth, network.shift, network.scale, recent)


def batches(network: Network, config: NetworkConfig) -> Iterator[Tensor]:
    """Numbers of samples, (B,), without an end: no two of a round are the same.

    A round leaves out what does not fill a batch, unless that is all.
    """
    count = len(network.features)
    batch = min(config.batch, count)
    while True:
        order = torch.randperm(count, generator=network.generator)
        for rows in torch.split(order[: count - count % batch], batch):
            yield rows.to(network.features.device)


def made(
    inputs: int, outputs: int, generator: torch.Generator | None, device: str
) -> tuple[Tensor, Tensor]:
    """Weights (outputs, inputs) of variance 1 / inputs, zero without a generator, and biases."""
    weight = torch.zeros(outputs, inputs)
    if generator is not None:
        weight.normal_(0.0, inputs**-0.5, generator=generator)
    bias = torch.zeros(outputs)
    return weight.to(device), bias.to(device)


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
