"""Height fields that tile, made by code: weave, swirl, bumps, waffle.

A pattern takes coordinates u along x and v along y in [0, 1), of which it is periodic, and gives
heights from 0, deepest, to 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["PATTERNS", "SCATTERED", "relief", "seams_close"]

THREADS = 4  # of a weave, each way; even, so that over and under alternate across the border
ROWS_OF_BUMPS = 4
CELLS = 3  # of a waffle, a side
ARMS, TURNS = 3, 2.5  # of a swirl

Pattern = Callable[[FloatArray, FloatArray, np.random.Generator], FloatArray]


def weave(u: FloatArray, v: FloatArray, random: np.random.Generator) -> FloatArray:
    """Plain weave of round threads: each goes over every other one of those it crosses."""
    del random
    x, y = u * THREADS, v * THREADS

    def thread(across: FloatArray, along: FloatArray, phase: float) -> FloatArray:
        round_ = np.sqrt(np.maximum(1.0 - (2.0 * (across % 1.0) - 1.0) ** 2, 0.0))
        sway = np.cos(math.pi * (along - 0.5 + np.floor(across) + phase))
        return 0.5 * round_ + 0.25 * (1.0 + sway) * (round_ > 0)

    between = 0.25  # where four threads meet
    return (np.maximum(thread(x, y, 0.0), thread(y, x, 1.0)) - between) / (1.0 - between)


def swirl(u: FloatArray, v: FloatArray, random: np.random.Generator) -> FloatArray:
    """Spiral ridges about the middle, which fade out before the border."""
    del random
    x, y = u - 0.5, v - 0.5
    radius = np.hypot(x, y)
    ridge = 0.5 + 0.5 * np.cos(ARMS * np.arctan2(y, x) - 4.0 * math.pi * TURNS * radius)
    fade = np.clip((0.5 - radius) / 0.15, 0.0, 1.0)
    middle = np.clip(radius / 0.08, 0.0, 1.0)  # where the ridges meet
    return ridge * smooth(fade) * smooth(middle)


def bumps(u: FloatArray, v: FloatArray, random: np.random.Generator) -> FloatArray:
    """Round bumps of several sizes, scattered on a jittered grid."""
    height = np.zeros(np.broadcast_shapes(u.shape, v.shape))
    for row in range(ROWS_OF_BUMPS):
        for column in range(ROWS_OF_BUMPS):
            centre = (np.array([column, row]) + random.uniform(0.25, 0.75, 2)) / ROWS_OF_BUMPS
            radius = random.uniform(0.6, 1.0) * 0.6 / ROWS_OF_BUMPS
            x = (u - centre[0] + 0.5) % 1.0 - 0.5
            y = (v - centre[1] + 0.5) % 1.0 - 0.5
            r2 = (x * x + y * y) / radius**2
            tall = radius * ROWS_OF_BUMPS / 0.6
            height = np.maximum(height, tall * np.maximum(1.0 - r2, 0.0) ** 1.5)
    return height


def waffle(u: FloatArray, v: FloatArray, random: np.random.Generator) -> FloatArray:
    """Square pits with sloping walls between flat ridges."""
    del random
    x, y = (np.abs((one * CELLS) % 1.0 - 0.5) * 2.0 for one in (u, v))  # 0 mid-pit, 1 mid-ridge
    return smooth(np.clip((np.maximum(x, y) - 0.5) / 0.25, 0.0, 1.0))


def smooth(t: FloatArray) -> FloatArray:
    """3t² − 2t³ on [0, 1]."""
    return t * t * (3.0 - 2.0 * t)


PATTERNS: dict[str, Pattern] = {"weave": weave, "swirl": swirl, "bumps": bumps, "waffle": waffle}
SCATTERED = ("bumps",)  # those that a seed makes different


def relief(name: str, texels: tuple[int, int], seed: int = 0) -> FloatArray:
    """Heights (H, W) float64 in [0, 1] of a pattern at the middles of texels.

    Args:
        name: of ``PATTERNS``.
        texels: W and H.
        seed: of what is scattered.
    """
    u = (np.arange(texels[0]) + 0.5) / texels[0]
    v = (np.arange(texels[1]) + 0.5) / texels[1]
    return PATTERNS[name](u[None, :], v[:, None], np.random.default_rng(seed))


def seams_close(heights: FloatArray) -> tuple[bool, bool]:
    """Whether a relief (H, W) may tile along x and along y.

    It may where the step across the border is not much higher than those inside.
    """
    found = []
    for axis in (1, 0):
        steps = np.diff(heights, axis=axis)
        seam = np.take(heights, 0, axis) - np.take(heights, -1, axis)
        inside = np.sqrt(np.mean(steps**2)) if steps.size else 0.0
        found.append(bool(np.sqrt(np.mean(seam**2)) <= 2.5 * inside + 1e-12))
    return found[0], found[1]
