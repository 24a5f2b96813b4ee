"""Non-linear truncation of light: its most important wavelets, and zero for all others.

Which those are, "All-Frequency" (Liu, Sloan, Shum and Snyder 2004) section 6 takes from Ng,
Ramamoorthi and Hanrahan 2003: the largest; the largest where each is weighed by the solid angle it
covers; or by how strongly the transfer of the surface answers it on average. As light moves, others
become important: what is left out flickers. Sparse light makes the products of the clusters faster.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment
from prtnet.arrays import FloatArray
from prtnet.cube_map import segments_of, solid_angles
from prtnet.haar import unhaar
from prtnet.sparse_columns import decode

__all__ = ["area_weights", "transfer_weights", "truncated"]


def truncated(
    coefficients: FloatArray, count: int, weights: FloatArray | None = None
) -> FloatArray:
    """Light with all but its ``count`` most important coefficients zero, (24, (n/2)², C).

    Args:
        coefficients: from ``prtnet.cube_map.segment_coefficients``, (24, (n/2)², C). Colours are
            kept or dropped together, by the root of the sum of their squares.
        count: how many are kept; all where there are no more. Of equal ones the first.
        weights: of the magnitudes, (24, (n/2)²); none where magnitudes alone count, which is best
            for the light itself.

    Raises:
        ValueError: fewer than none are to be kept.
    """
    if count < 0:
        raise ValueError(f"{count} coefficients cannot be kept")
    importance = np.linalg.norm(coefficients.astype(np.float64), axis=-1)
    if weights is not None:
        importance = importance * weights
    kept = np.argsort(-importance.ravel(), kind="stable")[:count]
    found = np.zeros_like(coefficients)
    flat = found.reshape(importance.size, -1)
    flat[kept] = coefficients.reshape(importance.size, -1)[kept]
    return found


def area_weights(size: int) -> FloatArray:
    """∫ |wavelet| over the solid angle, (24, (n/2)²), of cube maps of n texels a side.

    It is the most that an open transfer of 1 makes of a coefficient of 1.

    Raises:
        ValueError: n / 2 is no power of two.
    """
    half = size // 2
    areas = segments_of(np.broadcast_to(solid_angles(size), (6, size, size)))
    every = np.abs(unhaar(np.eye(half * half).reshape(-1, half, half)))
    return np.einsum("kyx,gyx->gk", every, areas)


def transfer_weights(fields: Sequence[AllFrequencyField]) -> FloatArray:
    """How strongly baked objects answer every wavelet of light together, (24, (n/2)²).

    The root of the mean square over their vertices and rows of transfer, as it is stored.

    Args:
        fields: of the same n.
    """
    rows = sum(len(one) * one.rows for one in fields)
    squares = [
        sum(answered(one.segments[number], one.rows) for one in fields)
        for number in range(SEGMENTS)
    ]
    return np.sqrt(np.stack(squares) / max(1, rows))


def answered(one: Segment, rows: int) -> FloatArray:
    """Squares of the columns of a segment's transfer, summed over vertices and rows, ((n/2)²,).

    Of a cluster with weights W and representatives R they are diag(Rᵀ Wᵀ W R).
    """
    clusters, terms = one.scale.shape
    if not clusters:
        return np.zeros(one.representatives.shape[1] // rows)
    weights = one.weights * one.scale[one.labels()].astype(np.float64) * one.step
    grams = np.add.reduceat(weights[:, :, None] * weights[:, None, :], one.starts[:-1])
    total = np.zeros(one.representatives.shape[1])
    every = decode(one.representatives).reshape(clusters, terms, -1)
    for gram, own in zip(grams, every.astype(np.float64), strict=True):
        total += np.einsum("nd,nd->d", gram @ own, own)
    return np.maximum(total, 0.0).reshape(rows, -1).sum(axis=0)
