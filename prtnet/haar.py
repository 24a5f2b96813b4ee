"""Haar wavelets of square blocks: orthonormal, non-standard, in Mallat's layout.

A step takes every two by two numbers a b / c d to (a + b + c + d)/2 and three differences; the
sums, a block of half the side, are stepped again, until one is left. Sums stand in the first
quarter, differences along a row beside them, along a column below, of both at the corner; so the
mean of a block of side h, times h, is its first number. "All-Frequency" (Liu, Sloan, Shum and
Snyder 2004) section 4, after Ng, Ramamoorthi and Hanrahan 2003.
"""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["haar", "unhaar"]


def haar(blocks: FloatArray) -> FloatArray:
    """Coefficients of blocks (..., h, h), of the same shape and kind of float.

    Raises:
        ValueError: blocks are not square, or h is no power of two.
    """
    found = np.array(blocks)
    side = checked_side(found)
    while side > 1:
        half = side // 2
        part = found[..., :side, :side]
        a, b = part[..., 0::2, 0::2], part[..., 0::2, 1::2]
        c, d = part[..., 1::2, 0::2], part[..., 1::2, 1::2]
        above, below, across, beneath = a + b, c + d, a - b, c - d
        part[..., :half, :half], part[..., half:, :half] = stepped(above, below)
        part[..., :half, half:], part[..., half:, half:] = stepped(across, beneath)
        side = half
    return found


def unhaar(coefficients: FloatArray) -> FloatArray:
    """The blocks (..., h, h) that have these coefficients.

    Raises:
        ValueError: blocks are not square, or h is no power of two.
    """
    found = np.array(coefficients)
    side, half = checked_side(found), 1
    while half < side:
        part = found[..., : 2 * half, : 2 * half]
        above, below = stepped(part[..., :half, :half], part[..., half:, :half])
        across, beneath = stepped(part[..., :half, half:], part[..., half:, half:])
        part[..., 0::2, 0::2], part[..., 0::2, 1::2] = above + across, above - across
        part[..., 1::2, 0::2], part[..., 1::2, 1::2] = below + beneath, below - beneath
        half *= 2
    return found


def stepped(first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half the sum, and half the difference."""
    return (first + second) / 2, (first - second) / 2


def checked_side(blocks: FloatArray) -> int:
    """The side h of blocks (..., h, h), or ValueError."""
    side = blocks.shape[-1] if blocks.ndim > 1 else 0
    if side == 0 or blocks.shape[-2] != side or side & (side - 1):
        raise ValueError(f"blocks of shape {blocks.shape} have no Haar wavelets")
    return side
