"""What each receiver sees of the occluders around it, in its own local frame.

The inputs of a prior (:mod:`prtnet.prior`): features of the pose at every receiver, by a law that
knows nothing of the whole body.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np

from prtnet import sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.occluders import cap_integral_rows

__all__ = ["SMALLEST", "SOFTEST", "Surroundings", "cap_sums", "fade"]

SMALLEST = 1e-12  # squared lengths below it are no direction; a scene's size is one
SOFTEST = 0.05  # sine: a cap is faded over the horizon as if it were at least so large


class Surroundings(ABC):
    """Flattened poses (P, D) to features (P, V, F) of all receivers."""

    kind: ClassVar[str]

    @property
    @abstractmethod
    def feature_count(self) -> int:
        """Number of features F of a receiver."""

    @property
    @abstractmethod
    def receiver_count(self) -> int:
        """Number of receivers V."""

    @abstractmethod
    def __call__(self, poses: FloatArray) -> FloatArray:
        """Features (P, V, F) float32 of flattened poses (P, D)."""

    def at(self, pose: FloatArray, receivers: IntArray) -> FloatArray:
        """Features (N, F) of one flattened pose (D,) at some receivers (N,)."""
        return self(pose[None])[0, receivers]

    @abstractmethod
    def arrays(self) -> dict[str, Any]:
        """The arrays that define it, for a model file."""


def fade(height: FloatArray, sine2: FloatArray) -> FloatArray:
    """How much of a cap is above the horizon: 0 below, 1 above, linear over its own width.

    Args:
        height: z of the unit direction to its centre, (...).
        sine2: squared sine of its half-angle, (...).
    """
    softness = np.maximum(np.sqrt(sine2), SOFTEST)
    return np.clip(0.5 + 0.5 * height / softness, 0.0, 1.0)


def cap_sums(
    away: Sequence[FloatArray], sine2: FloatArray, groups: Sequence[FloatArray], order: int
) -> FloatArray:
    """Spherical harmonics of caps above the horizon, summed group by group, (N, G · n²).

    Args:
        away: x, y and z from each receiver to its occluders, in its local frame, (N, K) each.
        sine2: squared sine of the half-angle of the cap that each one covers, (N, K).
        groups: how much each occluder belongs to each group, (N, K) each.
        order: n, number of bands.
    """
    distance = np.sqrt(np.maximum(sum(a * a for a in away), SMALLEST))
    x, y, z = (a / distance for a in away)
    weight = fade(z, sine2)
    weight *= 2.0 * math.pi
    integrals = [i * weight for i in cap_integral_rows(np.sqrt(1.0 - sine2), order)]
    weighed = [[i * group for i in integrals] for group in groups]
    out = np.empty((len(sine2), len(groups), order * order), dtype=sine2.dtype)
    for index, row in enumerate(sh.components(x, y, z, order)):
        band = math.isqrt(index)
        for group, own in enumerate(weighed):
            np.einsum("nk,nk->n", row, own[band], out=out[:, group, index])
    return out.reshape(len(out), -1)
