"""Clusters of receivers whose visibility varies alike: clustered principal components.

The engine is ``training.cpca``. Here a cluster's components are courses over the poses, as the
latents of a model are, clusters have as many components as they need, and are equally large.
"""

from __future__ import annotations

import numpy as np
import torch

from prtnet.arrays import FloatArray, IntArray
from training.clusters import assign_balanced, slots_of
from training.cpca import Subspaces, alternate, lost, subspaces
from training.reduction import choose_counts

__all__ = ["lost_energy", "signal_clusters"]

POSES = 64  # leading courses over the poses that stand for all poses
BLOCK = 2048  # receivers at a time
PRICE_STEPS = 200


def leading_courses(visibility: FloatArray, most: int) -> FloatArray:
    """Deviations of visibility (P, V, n²) from its mean, on the leading courses, (K, V, n²)."""
    poses, receivers, _ = visibility.shape
    blocks = range(0, receivers, BLOCK)
    gram = np.zeros((poses, poses))
    for start in blocks:
        own = visibility[:, start : start + BLOCK]
        own = (own - own.mean(axis=0)).reshape(poses, -1)
        gram += own @ own.T
    vectors = np.linalg.eigh(gram)[1][:, ::-1][:, :most].astype(np.float32)
    course = np.empty((vectors.shape[1], *visibility.shape[1:]), dtype=np.float32)
    for start in blocks:
        own = visibility[:, start : start + BLOCK]
        course[:, start : start + BLOCK] = np.tensordot(vectors.T, own - own.mean(axis=0), 1)
    return course


def lost_energy(
    course: FloatArray, label: IntArray, clusters: int, components: float
) -> FloatArray:
    """What each cluster's subspace leaves of each receiver's signal, squared, (V, C).

    Args:
        course: signals (K, V, n²).
        label: each receiver's cluster, (V,).
        clusters: C; an empty one loses everything.
        components: dimensions of the subspaces on average; as in a model, the largest of all
            clusters are kept.
    """
    signal = vectors_of(course)
    found = needed(signal, torch.as_tensor(label), clusters, components)
    return np.asarray(lost(signal, found).numpy())


def vectors_of(course: FloatArray) -> torch.Tensor:
    """Signals (K, V, n²) as a receiver's vectors of K numbers, (V, n², K)."""
    return torch.as_tensor(course).permute(1, 2, 0).contiguous()


def needed(
    signal: torch.Tensor, label: torch.Tensor, clusters: int, components: float
) -> Subspaces:
    """The subspaces of clusters whose axes are, as a model's, the largest of all clusters."""
    found = subspaces(signal, label, clusters, signal.shape[2])
    return found.kept(choose_counts(found.values.double().numpy(), 1.0, components, 1))


def assign_by_regret(cost: FloatArray, capacity: int) -> IntArray:
    """Each receiver's cluster, none above ``capacity``, of nearly the least total cost (V, C).

    A price on every cluster rises while it is overfull and falls while it is not (the dual of the
    transport problem). What is still too much then goes by regret: a full cluster keeps those
    whom their next best choice would cost most. By plain cost it would keep quiet receivers,
    whose signal is small in any cluster.
    """
    first, second = np.partition(cost, 1, axis=1)[:, :2].T if cost.shape[1] > 1 else (cost, cost)
    rate = float(np.mean(second - first))
    price = np.zeros(cost.shape[1])
    for step in range(PRICE_STEPS):
        size = np.bincount(np.argmin(cost + price, axis=1), minlength=len(price))
        if size.max() <= capacity:
            break
        price += rate * (size / capacity - 1.0) / (1.0 + step / 10.0)
    priced = cost + price
    if cost.shape[1] > 1:
        priced = priced - np.partition(priced, 1, axis=1)[:, 1:2]
    return assign_balanced(priced, capacity)


def signal_clusters(
    visibility: FloatArray, slots: IntArray, components: float, rounds: int = 6
) -> IntArray:
    """Slots (C, R) of equally large clusters whose visibility (P, V, n²) varies alike.

    Args:
        visibility: of the training poses.
        slots: clusters to start from, (C, R), −1 for empty.
        components: of a cluster's subspace, on average.
        rounds: of assignment and subspace, at most; the clusters that lose least are kept.
    """
    course = leading_courses(visibility, POSES)
    clusters, capacity = slots.shape
    label: IntArray = np.empty(visibility.shape[1], dtype=np.int64)
    cluster, slot = np.nonzero(slots >= 0)
    label[slots[cluster, slot]] = cluster
    signal = vectors_of(course)

    def fit(label: torch.Tensor) -> Subspaces:
        return needed(signal, label, clusters, components)

    def assign(left: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(assign_by_regret(left.numpy(), capacity))

    best = alternate(signal, torch.as_tensor(label), fit, assign, rounds).numpy()
    return slots_of(best, clusters, capacity)
