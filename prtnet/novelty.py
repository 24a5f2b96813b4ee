"""How far a pose is from all that training saw, and what a model does there.

The reduced inputs of a cluster's training poses span a box, from ``low`` to ``high`` in each of the
K inputs. Outside it a regressor extrapolates, and a network or a steep linear map can then say
anything. So inputs are clamped to the box, and a cluster whose pose is far outside it fades to
its mean: what is unknown is answered with what is usual.
"""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["FADE_SCALE", "box_size", "fade", "novelty", "pose_novelty"]

FADE_SCALE = 1.0  # novelty at which the latents are halved
SMALLEST = 1e-6  # a box without extent has inputs that training never saw change


def box_size(low: FloatArray, high: FloatArray) -> FloatArray:
    """Half the diagonal of each cluster's box, (1 or C,) float64, above zero."""
    extent = high.astype(np.float64) - low.astype(np.float64)
    return np.maximum(0.5 * np.linalg.norm(extent, axis=-1), SMALLEST)


def novelty(inputs: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Distance to the box of the training poses over half the box's diagonal.

    0 inside; 1 where a pose is as far from the nearest point of the box as its middle is from its
    corners.

    Args:
        inputs: reduced inputs, (P, C, K).
        low: the box's lower corner, (1 or C, K).
        high: its upper corner, (1 or C, K).

    Returns:
        (P, C) float64.
    """
    outside = inputs.astype(np.float64) - np.clip(inputs, low, high)
    return np.linalg.norm(outside, axis=-1) / box_size(low, high)


def pose_novelty(each: FloatArray) -> FloatArray:
    """One number a pose, (P,): the mean over clusters, which are equally large, of (P, C)."""
    return each.mean(axis=1)


def fade(each: FloatArray) -> FloatArray:
    """What latents are multiplied by, of novelty (P, C): 1 inside the box, towards 0 far away."""
    return 1.0 / (1.0 + np.square(each / FADE_SCALE))
