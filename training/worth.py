"""Which components of a model are worth their bytes.

Components of a group are orthonormal, so what each brings can be told apart: with a component
whose true latent is t and whose predicted one is p, the squared error falls by t² − (t − p)². On
poses that no fit has seen that is the component's *marginal error*, negative where it only repeats
the training clips. Taking components in the order of marginal error per byte gives the smallest
model of every error, and the least error of every size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.model import VisibilityModel

__all__ = ["Front", "Marginal", "front", "marginal", "truncated"]


@dataclass(frozen=True, eq=False)
class Marginal:
    """What the components of a model bring on poses that it has not seen.

    Attributes:
        energy: Σ‖v‖² of the poses' visibility.
        base: Σ‖error‖² of the model without components.
        gain: by how much each component lowers that, (G, L).
    """

    energy: float
    base: float
    gain: FloatArray

    def __add__(self, other: Marginal) -> Marginal:
        """Of both sets of poses; a component that one of them lacks brings nothing there."""
        width = max(self.gain.shape[1], other.gain.shape[1])
        gain = np.zeros((len(self.gain), width))
        for part in (self, other):
            gain[:, : part.gain.shape[1]] += part.gain
        return Marginal(self.energy + other.energy, self.base + other.base, gain)

    def error(self, gain: FloatArray | float) -> Any:
        """Relative RMS of a model whose components bring so much, (...)."""
        left = np.maximum(self.base - np.asarray(gain), 0.0)
        return np.sqrt(left / max(self.energy, 1e-30))


def marginal(model: VisibilityModel, blocks: Iterable[tuple[FloatArray, FloatArray]]) -> Marginal:
    """What each component of a model brings.

    Args:
        model: in float32: rounded components are not orthonormal.
        blocks: poses (B, D) that its fit did not see, and their visibility (B, V, n²).
    """
    gain = np.zeros((len(model.latents), int(model.latents.max(initial=0))))
    energy = base = 0.0
    mean = model.decode(np.zeros((1, *gain.shape)))
    for poses, truth in blocks:
        left = truth - model.prior_part(poses)
        known, predicted = model.encode(left), model.latent(poses)[..., : gain.shape[1]]
        gain += np.sum(known**2 - (known - predicted) ** 2, axis=0)
        energy += float(np.sum(np.square(truth), dtype=np.float64))
        base += float(np.sum(np.square(left - mean), dtype=np.float64))
    return Marginal(energy, base, gain)


@dataclass(frozen=True, eq=False)
class Front:
    """Components in the order in which they are worth taking, in steps of one group each.

    Attributes:
        group: whose components each step takes, (S,).
        upto: how many that group then has, (S,).
        gain: what each step brings, (S,).
        groups: G.
    """

    group: IntArray
    upto: IntArray
    gain: FloatArray
    groups: int

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.group)

    def counts(self, steps: int) -> IntArray:
        """Components of each group, (G,), after so many steps."""
        counts = np.zeros(self.groups, dtype=np.int64)
        np.maximum.at(counts, self.group[:steps], self.upto[:steps])
        return counts


def front(gain: FloatArray, latents: IntArray, step: int) -> Front:
    """The order of worth; what brings nothing is left out.

    Args:
        gain: of each component, (G, L). All cost equally many bytes.
        latents: how many each group has at most, (G,).
        step: a group has a multiple of so many components, or all it can have.
    """
    steps = []
    for index, (own, most) in enumerate(zip(gain, latents, strict=True)):
        ends = np.append(np.arange(step, most, step), most) if most > 0 else np.zeros(0, int)
        total = np.concatenate([[0.0], np.cumsum(own)])
        at = 0
        while True:  # the concave hull of the cumulated gain: the steepest way on, again and again
            further = ends[ends > at]
            if len(further) == 0:
                break
            slopes = (total[further] - total[at]) / (further - at)
            best = int(np.argmax(slopes))
            if not slopes[best] > 0:
                break
            end = int(further[best])
            steps.append((-float(slopes[best]), index, end, float(total[end] - total[at])))
            at = end
    steps.sort()
    table = np.array([step[1:3] for step in steps], dtype=np.int64).reshape(-1, 2)
    return Front(table[:, 0], table[:, 1], np.array([step[3] for step in steps]), len(gain))


def truncated(model: VisibilityModel, counts: IntArray) -> VisibilityModel:
    """The model with the first components of each group alone.

    Args:
        model: of any kind.
        counts: components to keep of each group, (G,), at most what it has.
    """
    starts = np.cumsum(model.latents) - model.latents
    rows = [start + np.arange(count) for start, count in zip(starts, counts, strict=True)]
    width = int(counts.max(initial=0))
    regressor = dataclasses.replace(
        model.regressor,
        weight=model.regressor.weight[..., :width],
        bias=model.regressor.bias[..., :width],
    )
    return dataclasses.replace(
        model,
        latents=counts.astype(np.int32),
        basis=model.basis[np.concatenate(rows).astype(np.int64)],
        regressor=regressor,
    )
