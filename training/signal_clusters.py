"""Clusters of receivers whose visibility varies alike: clustered principal components.

Sloan, Hall, Hart, Snyder, "Clustered principal components for precomputed radiance transfer",
SIGGRAPH 2003: assign every receiver to the cluster whose subspace holds most of it, fit the
subspaces anew, and so on. Here a cluster's components are courses over the poses, as the latents
of a model are, and clusters are equally large.
"""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from training.clusters import assign_balanced, slots_of
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
    flat = course.reshape(len(course), -1)
    energy = np.einsum("kvi,kvi->v", course, course)
    lost = np.tile(energy[:, None], (1, clusters))
    values = np.zeros((clusters, len(course)))
    vectors = np.zeros((clusters, len(course), len(course)), dtype=np.float32)
    for cluster in np.unique(label):
        own = course[:, label == cluster].reshape(len(course), -1)
        ascending, columns = np.linalg.eigh((own @ own.T).astype(np.float64))
        values[cluster] = np.maximum(ascending[::-1], 0.0)
        vectors[cluster] = columns[:, ::-1]
    for cluster, count in enumerate(choose_counts(values, 1.0, components, 1)):
        held = (vectors[cluster, :, :count].T @ flat).reshape(-1, *course.shape[1:])
        lost[:, cluster] -= np.einsum("kvi,kvi->v", held, held)
    return lost


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
    best, least = label, np.inf
    for _ in range(rounds):
        lost = lost_energy(course, label, clusters, components)
        total = float(lost[np.arange(len(label)), label].sum())
        if total >= least:
            break
        best, least = label, total
        label = assign_by_regret(lost, capacity)
    return slots_of(best, clusters, capacity)
