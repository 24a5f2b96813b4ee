"""Which components of a model are worth their bytes.

Components of a group are orthonormal, so what each brings can be told apart: with a component
whose true latent is t and whose predicted one is p, the squared error falls by t² − (t − p)². On
poses that no fit has seen that is the component's *marginal error*, negative where it only repeats
the training clips. Taking components in the order of marginal error per byte gives the smallest
model of every error, and the least error of every size.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.model import VisibilityModel

__all__ = ["Front", "Marginal", "front", "marginal", "truncated"]


@dataclass(frozen=True, eq=False)
class Marginal:
    """What the components of a model bring on M sets of poses that it has not seen.

    Attributes:
        energy: Σ‖v‖² of each set's visibility, (M,).
        base: Σ‖error‖² of the model without components, (M,).
        gain: by how much each component lowers that, (M, G, L).
    """

    energy: FloatArray
    base: FloatArray
    gain: FloatArray

    @staticmethod
    def joined(parts: Sequence[Marginal], width: int = 0) -> Marginal:
        """The sets of all, L at least ``width``; a component that a set lacks brings nothing."""
        width = max(width, *(part.gain.shape[2] for part in parts))
        padded = [
            np.pad(part.gain, ((0, 0), (0, 0), (0, width - part.gain.shape[2]))) for part in parts
        ]
        return Marginal(
            np.concatenate([part.energy for part in parts]),
            np.concatenate([part.base for part in parts]),
            np.concatenate(padded),
        )

    def votes(self) -> FloatArray:
        """What components are worth, (G, L): every set counts the same, whatever its size."""
        share = self.gain / np.maximum(self.energy, 1e-30)[:, None, None]
        return share.mean(axis=0)

    def errors(self, brought: FloatArray) -> FloatArray:
        """Relative RMS (..., M) of models whose components bring so much, (..., M)."""
        left = np.maximum(self.base - brought, 0.0)
        return np.sqrt(left / np.maximum(self.energy, 1e-30))


def marginal(model: VisibilityModel, blocks: Iterable[tuple[FloatArray, FloatArray]]) -> Marginal:
    """What each component of a model brings on one set of poses.

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
    return Marginal(np.array([energy]), np.array([base]), gain[None])


@dataclass(frozen=True, eq=False)
class Front:
    """Components in the order in which they are worth taking, in steps of one group each.

    Attributes:
        group: whose components each step takes, (S,).
        first, upto: from which of the group's components to before which, (S,).
        groups: G.
    """

    group: IntArray
    first: IntArray
    upto: IntArray
    groups: int

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.group)

    def counts(self, steps: int) -> IntArray:
        """Components of each group, (G,), after so many steps."""
        counts = np.zeros(self.groups, dtype=np.int64)
        np.maximum.at(counts, self.group[:steps], self.upto[:steps])
        return counts

    def brought(self, gain: FloatArray) -> FloatArray:
        """What the components taken bring after 0, 1, … steps, (S + 1, M), of gains (M, G, L)."""
        total = np.concatenate([np.zeros((*gain.shape[:2], 1)), np.cumsum(gain, axis=2)], axis=2)
        each = total[:, self.group, self.upto] - total[:, self.group, self.first]
        return np.concatenate([np.zeros((1, len(gain))), np.cumsum(each, axis=1).T])


def front(worth: FloatArray, latents: IntArray, step: int) -> Front:
    """The order of worth; what is worth nothing is left out.

    Args:
        worth: of each component, (G, L). All cost about equally many bytes, their rows.
        latents: how many each group has at most, (G,).
        step: a group has a multiple of so many components, or all it can have.
    """
    steps = []
    for index, (own, most) in enumerate(zip(worth, latents, strict=True)):
        ends = np.append(np.arange(step, most, step), most) if most > 0 else np.zeros(0, int)
        total = np.concatenate([[0.0], np.cumsum(own)])
        at = 0
        while True:  # the concave hull of the cumulated worth: the steepest way on, again and again
            further = ends[ends > at]
            if len(further) == 0:
                break
            slopes = (total[further] - total[at]) / (further - at)
            best = int(np.argmax(slopes))
            if not slopes[best] > 0:
                break
            steps.append((-float(slopes[best]), index, at, int(further[best])))
            at = int(further[best])
    steps.sort()
    table = np.array([step[1:] for step in steps], dtype=np.int64).reshape(-1, 3)
    return Front(table[:, 0], table[:, 1], table[:, 2], len(worth))


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
