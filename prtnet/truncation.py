"""Non-linear truncation of light: its most important wavelets, and zero for all others.

Which those are, "All-Frequency" (Liu, Sloan, Shum and Snyder 2004) section 6 takes from Ng,
Ramamoorthi and Hanrahan 2003: the largest; the largest where each is weighed by the solid angle it
covers; or by how strongly the transfer of the surface answers it on average. As light moves, others
become important: what is left out flickers. Sparse light makes the products of the clusters faster.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.cube_map import segments_of, solid_angles
from prtnet.haar import haar, unhaar

__all__ = ["area_weights", "transfer_weights", "truncated"]

BLOCK = 1 << 14  # rows of transfer at a time


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


def transfer_weights(segments: Iterable[FloatArray]) -> FloatArray:
    """How strongly a surface answers every wavelet of light, (24, (n/2)²).

    The root of the mean square over vertices and rows.

    Args:
        segments: 24 of raw transfer (P, m, (n/2)²), as ``data_gen.all_frequency`` makes them.
    """
    return np.stack([answered(one) for one in segments])


def answered(transfer: FloatArray) -> FloatArray:
    """Of one segment (P, m, h²): (h²,)."""
    half = round(transfer.shape[-1] ** 0.5)
    flat = transfer.reshape(-1, half, half)
    total = np.zeros(half * half)
    for start in range(0, len(flat), BLOCK):
        waves = haar(flat[start : start + BLOCK]).reshape(-1, half * half)
        total += np.einsum("bk,bk->k", waves, waves, dtype=np.float64)
    return np.sqrt(total / max(1, len(flat)))
