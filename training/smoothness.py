"""A prior that small changes of the input make small changes of the output, for linear models.

"Arbitrary BRDFs" section 5.3 names such a prior without its form. Here it is the mean over
consecutive poses of a clip of ‖(x_{i+1} − x_i) W‖²: how much the prediction moves from one frame
to the next, in the metric of the motion itself. Weight decay, ‖W‖², is the same with the identity
in place of the covariance of the changes.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from prtnet.arrays import FloatArray, IntArray

__all__ = ["change_covariance", "consecutive"]

GAP = 2.01  # steps so many times longer than usual have something held out in between


def consecutive(clip: IntArray, time: FloatArray, without: int | None = None) -> IntArray:
    """Pairs (2, S) of rows that follow each other in one clip, and in time: not over a gap.

    Args:
        clip: each row's clip, (P,).
        time: seconds in the clip, (P,).
        without: a clip whose poses follow no time, as the sampled ones.
    """
    order = np.lexsort((time, clip))
    same = clip[order[1:]] == clip[order[:-1]]
    if without is not None:
        same &= clip[order[1:]] != without
    before, after = order[:-1][same], order[1:][same]
    step = time[after] - time[before]
    near = step <= GAP * np.median(step) if len(step) else step < 0
    return np.stack([before[near], after[near]])


def change_covariance(inputs: Tensor, steps: IntArray) -> Tensor:
    """Mean outer product (C, K, K) of the changes of inputs (C, P, K) over steps (2, S)."""
    before, after = (torch.from_numpy(rows).to(inputs.device) for rows in steps)
    change = inputs[:, after] - inputs[:, before]
    return change.mT @ change / max(1, change.shape[1])
