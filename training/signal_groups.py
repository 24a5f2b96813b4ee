"""A cluster's receivers in groups whose visibility moves together: clustered PCA.

The engine is ``training.cpca``. Groups are equally large; a cluster's signals are first compressed
to a few moments in time, so that a round is cheap.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
import torch

from prtnet.arrays import FloatArray, IntArray
from training.clusters import assign_balanced
from training.cpca import Subspaces, alternate, subspaces

__all__ = ["regroup"]

MOMENTS = 40  # principal components of a cluster that tell its groups apart
ROUNDS = 12


def regroup(visibility: FloatArray, groups: IntArray, parts: int, count: int) -> IntArray:
    """Groups (C · parts, R) of the same clusters, receivers exchanged within each cluster.

    Args:
        visibility: of the training poses, (P, V, n²).
        groups: receivers of each group to start from, −1 for empty.
        parts: groups a cluster.
        count: components that a group will have, about.
    """
    if parts == 1 or count == 0:
        return groups
    result = np.full_like(groups, -1)
    for start in range(0, len(groups), parts):
        own = groups[start : start + parts]
        member, before = own[own >= 0], np.nonzero(own >= 0)[0]
        label = rounds(moments(visibility[:, member]), before, parts, count, own.shape[1])
        order = np.argsort(label, kind="stable")
        rank = np.arange(len(member)) - np.searchsorted(label[order], label[order])
        result[start + label[order], rank] = member[order]
    return result


def moments(block: FloatArray) -> FloatArray:
    """Signals (P, R, n²) as (R, M, n²) in the principal components of time they share."""
    poses, receivers, coefficients = block.shape
    centred = (block - block.mean(axis=0)).reshape(poses, -1)
    gram = (centred @ centred.T).astype(np.float64)
    first = max(0, poses - MOMENTS)
    _, vectors = scipy.linalg.eigh(gram, subset_by_index=(first, poses - 1))
    reduced = vectors.T.astype(np.float32) @ centred
    return np.swapaxes(reduced.reshape(-1, receivers, coefficients), 0, 1)


def rounds(signal: FloatArray, label: IntArray, parts: int, count: int, capacity: int) -> IntArray:
    """Each receiver's group after rounds of components and assignment, (R,).

    Args:
        signal: (R, M, n²).
        label: groups to start from, (R,).
        parts: number of groups.
        count: components a group.
        capacity: of a group.
    """
    vectors = torch.as_tensor(signal).swapaxes(1, 2).contiguous()  # [R, n², M]

    def fit(label: torch.Tensor) -> Subspaces:
        return subspaces(vectors, label, parts, count)

    def assign(lost: torch.Tensor) -> torch.Tensor:
        return torch.as_tensor(assign_balanced(lost.numpy(), capacity))

    return alternate(vectors, torch.as_tensor(label), fit, assign, ROUNDS).numpy()
