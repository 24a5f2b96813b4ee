"""What a prior is fitted to: some receivers of every training pose with what they see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import in_threads
from prtnet.surroundings import Surroundings

__all__ = ["Samples", "draw_samples"]


@dataclass(frozen=True, eq=False)
class Samples:
    """Pairs of a pose and a receiver.

    Attributes:
        features: what the receiver sees, (N, F) float32.
        deviation: of its visibility from the training mean, (N, n²) float32.
        receiver: (N,).
    """

    features: FloatArray
    deviation: FloatArray
    receiver: IntArray


def draw_samples(
    surroundings: Surroundings,
    poses: FloatArray,
    visibility: FloatArray,
    mean: FloatArray,
    count: int,
    seed: int,
    progress: Callable[[int, int], object],
) -> Samples:
    """Equally many receivers of every pose, at random.

    Args:
        surroundings: what receivers see.
        poses: of training, (P, D).
        visibility: of all receivers in them, (P, V, n²).
        mean: over the poses, (V, n²).
        count: about how many samples.
        seed: of the choice.
        progress: told the number of poses done, and of all.
    """
    receivers = visibility.shape[1]
    each = int(np.clip(round(count / len(poses)), 1, receivers))

    def work(row: int) -> tuple[IntArray, FloatArray, FloatArray]:
        rng = np.random.default_rng((seed, row))
        own = np.sort(rng.permutation(receivers)[:each]).astype(np.int32)
        return own, surroundings.at(poses[row], own), visibility[row, own] - mean[own]

    parts = []
    with in_threads() as each_pose:
        for done, part in enumerate(each_pose(work, range(len(poses))), start=1):
            parts.append(part)
            progress(done, len(poses))
    own, seen, deviation = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Samples(seen, deviation, own)
