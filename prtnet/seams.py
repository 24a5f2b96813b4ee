"""Seams: how much a prediction's error jumps where two clusters meet.

Clusters are predicted apart, so their errors may differ along a border, and the eye finds an edge
that follows no shape. The jump across an edge of the mesh is ‖e_a − e_b‖ of the errors
e = ṽ − v at its two receivers; the root mean square over the edges that cross a border, beside
that over the edges inside clusters, says whether borders show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["JumpSum", "cluster_of_receiver", "receiver_edges", "seam_ratio"]


def receiver_edges(faces: IntArray, receiver_of_vertex: IntArray) -> IntArray:
    """Edges between different receivers, each once, (E, 2), of triangles over vertices (T, 3)."""
    corners = receiver_of_vertex[faces]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), 1)
    distinct: IntArray = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0)
    return distinct


def cluster_of_receiver(slots: IntArray) -> IntArray:
    """The cluster of each receiver, (V,), of slots (C, R), −1 for empty."""
    clusters, columns = np.nonzero(slots >= 0)
    owner = np.zeros(len(clusters), dtype=np.int32)
    owner[slots[clusters, columns]] = clusters
    return owner


@dataclass
class JumpSum:
    """Squared jumps across edges (E,), summed block by block of poses.

    Attributes:
        edges: pairs of receivers, (E, 2).
        squared: the sum so far, (E,).
        poses: how many were added.
    """

    edges: IntArray
    squared: FloatArray | None = None
    poses: int = 0

    def add(self, values: FloatArray) -> None:
        """Add poses of errors, or of any signal, (P, V, n²)."""
        jump = values[:, self.edges[:, 0]] - values[:, self.edges[:, 1]]
        total = np.einsum("pei,pei->e", jump, jump, dtype=np.float64)
        self.squared = total if self.squared is None else self.squared + total
        self.poses += len(values)

    def rms(self, owner: IntArray) -> tuple[float, float]:
        """Root mean square jump across borders and inside clusters, owner (V,); 0 for no edges."""
        if self.squared is None:
            raise ValueError("no poses were added")
        across = owner[self.edges[:, 0]] != owner[self.edges[:, 1]]
        found = [
            float(np.sqrt(self.squared[which].mean() / self.poses)) if which.any() else 0.0
            for which in (across, ~across)
        ]
        return found[0], found[1]


def seam_ratio(error: FloatArray, edges: IntArray, owner: IntArray) -> float:
    """Jump of errors (P, V, n²) across borders over that inside clusters; 1 where none shows.

    Args:
        error: prediction minus truth.
        edges: pairs of receivers, (E, 2).
        owner: the cluster of each receiver, (V,).
    """
    total = JumpSum(edges)
    total.add(error)
    across, inside = total.rms(owner)
    if across == 0.0:
        return 1.0 if inside == 0.0 else 0.0
    return across / inside if inside > 0.0 else float("inf")
