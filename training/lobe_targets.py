"""Visibility of the training poses as numbers of a few zonal lobes, in place of coefficients."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.lobe_numbers import LobeNumbers
from training.monitor import Monitor

__all__ = ["lobe_targets"]

BLOCK = 4  # poses at a time


def lobe_targets(visibility: FloatArray, count: int, watch: Monitor) -> FloatArray:
    """The numbers (P, V, N) float32 of lobes fitted to visibility (P, V, n²).

    Args:
        visibility: of the training poses.
        count: lobes of each receiver.
        watch: is told how it goes.
    """
    poses, receivers, size = visibility.shape
    numbers = LobeNumbers(count, round(size**0.5))
    watch.stage("fits of lobes")
    start = numbers.start(visibility.mean(axis=0, dtype=np.float64))
    result = np.empty((poses, receivers, numbers.size), dtype=np.float32)
    for first in range(0, poses, BLOCK):
        block = slice(first, first + BLOCK)
        result[block] = numbers.fitted(visibility[block], start)
        watch.progress(min(first + BLOCK, poses), poses, 0.0)
    return result
