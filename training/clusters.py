"""Clusters of receivers that a model predicts together."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import one_thread

__all__ = [
    "assign_balanced",
    "balanced_clusters",
    "cluster_coordinates",
    "slots_of",
    "squared_distances",
    "subdivide",
]


def cluster_coordinates(
    positions: FloatArray, joint_weights: FloatArray | None, weight: float = 0.5
) -> FloatArray:
    """Points whose distances say which receivers belong together, (V, 3 + J).

    Args:
        positions: receivers at rest, (V, 3).
        joint_weights: skin weights, (V, J), or None.
        weight: how far apart two receivers of different joints are, in units of the scene's size.
    """
    centred = positions.astype(np.float64) - positions.mean(axis=0, dtype=np.float64)
    size = np.abs(centred).max() or 1.0
    parts = [centred / size]
    if joint_weights is not None:
        parts.append(weight * joint_weights.astype(np.float64) / np.sqrt(2.0))
    return np.concatenate(parts, axis=1)


def squared_distances(points: FloatArray, centres: FloatArray) -> FloatArray:
    """(V, C) squared distances."""
    cross = points @ centres.T
    return (points**2).sum(1)[:, None] - 2.0 * cross + (centres**2).sum(1)


def assign_balanced(distance: FloatArray, capacity: int) -> IntArray:
    """Each point's cluster, none above ``capacity``: deferred acceptance on distances (V, C).

    Every point asks its nearest cluster that has not refused it; a full cluster keeps its
    nearest. No point and cluster would both rather have each other than what they got.
    """
    open_distance = distance.copy()
    points = np.arange(len(distance))
    while True:
        choice = np.argmin(open_distance, axis=1)
        order = np.lexsort((open_distance[points, choice], choice))
        chosen = choice[order]
        rank = points - np.searchsorted(chosen, chosen)
        refused = order[rank >= capacity]
        if len(refused) == 0:
            return choice
        open_distance[refused, choice[refused]] = np.inf


def balanced_clusters(
    points: FloatArray, clusters: int, seed: int = 0, rounds: int = 12
) -> IntArray:
    """Slots (C, R) of equally large clusters, R = ⌈V / C⌉; an empty slot holds −1.

    k-means with a capacity: k-means++ centres, then assignment by :func:`assign_balanced` and
    new centroids in turn.

    Args:
        points: (V, D).
        clusters: C, at most V of them are made.
        seed: of the starting centres.
        rounds: of assignment and centroid.
    """
    from sklearn.cluster import KMeans

    clusters = min(clusters, len(points))
    capacity = -(-len(points) // clusters)
    distinct = min(clusters, len(np.unique(points, axis=0)))
    with one_thread():
        start = KMeans(distinct, n_init=1, max_iter=20, random_state=seed).fit(points)
    centres = start.cluster_centers_[np.arange(clusters) % distinct]
    label: IntArray = np.zeros(len(points), dtype=np.int64)
    for _ in range(rounds):
        new = assign_balanced(squared_distances(points, centres), capacity)
        if np.array_equal(new, label):
            break
        label = new
        total = np.zeros_like(centres)
        np.add.at(total, label, points)
        count = np.bincount(label, minlength=clusters)[:, None]
        centres = np.where(count > 0, total / np.maximum(count, 1), centres)
    return slots_of(label, clusters, capacity)


def slots_of(label: IntArray, clusters: int, capacity: int) -> IntArray:
    """Slots (C, R) of clusters that have members, of each point's cluster (V,)."""
    slots = np.full((clusters, capacity), -1, dtype=np.int32)
    order = np.argsort(label, kind="stable")
    rank = np.arange(len(label)) - np.searchsorted(label[order], label[order])
    slots[label[order], rank] = order
    return slots[(slots >= 0).any(axis=1)]


def subdivide(slots: IntArray, points: FloatArray, parts: int, seed: int = 0) -> IntArray:
    """Each cluster's receivers in equally large groups: (C, R) to (C · parts, ⌈R / parts⌉).

    Args:
        slots: receivers of each cluster, −1 for empty.
        points: whose distances say which receivers belong together, (V, D).
        parts: groups a cluster; those that find no receiver are empty.
        seed: of :func:`balanced_clusters`.
    """
    if parts == 1:
        return slots
    groups = np.full((len(slots), parts, -(-slots.shape[1] // parts)), -1, dtype=np.int32)
    for cluster, own in enumerate(slots):
        members = own[own >= 0]
        inside = balanced_clusters(points[members], parts, seed)
        filled = np.where(inside >= 0, members[inside], -1)
        groups[cluster, : filled.shape[0], : filled.shape[1]] = filled
    return groups.reshape(-1, groups.shape[2])
