"""A ridge map for each cluster from what receivers see to the deviation of their visibility."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.prior import saturated
from training.prior_samples import Samples
from training.reduction import each_cluster

__all__ = ["fit_maps"]

RIDGE = 1e-3  # of the features' mean square


def fit_maps(
    samples: Samples, cluster: IntArray, clusters: int, receivers: int, ridge: float = RIDGE
) -> FloatArray:
    """Maps (C, 2 · F, n²).

    Features count as deviations from each receiver's own mean, so a map says what changes with
    the pose and not how receivers differ.

    Args:
        samples: pairs of a pose and a receiver.
        cluster: of each receiver, (V,).
        clusters: C.
        receivers: V.
        ridge: weight decay relative to the features' mean square.
    """
    both = np.concatenate([samples.features, saturated(samples.features)], axis=1)
    count = np.maximum(np.bincount(samples.receiver, minlength=receivers), 1)[:, None]
    order = np.argsort(samples.receiver, kind="stable")
    starts = np.searchsorted(samples.receiver[order], np.arange(receivers))
    mean = np.zeros((receivers, both.shape[1]))
    seen = np.bincount(samples.receiver, minlength=receivers) > 0
    mean[seen] = np.add.reduceat(both[order], starts[seen], axis=0, dtype=np.float64)
    mean /= count
    centred = both - mean[samples.receiver].astype(np.float32)
    own = cluster[samples.receiver]
    maps = np.zeros((clusters, both.shape[1], samples.deviation.shape[1]))

    def fit(index: int) -> None:
        x = centred[own == index].astype(np.float64)
        gram = x.T @ x
        level = ridge * np.trace(gram) / len(gram)
        if level > 0:
            right = x.T @ samples.deviation[own == index]
            maps[index] = np.linalg.solve(gram + level * np.eye(len(gram)), right)

    each_cluster(fit, clusters)
    return maps.astype(np.float32)
