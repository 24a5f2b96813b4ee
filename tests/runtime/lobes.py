"""Made-up surfaces whose visibility is lobes, for the tests of 1D BRDFs."""

from __future__ import annotations

import numpy as np

from prtnet.zh import Lobes
from runtime.one_dimensional import LobeSide
from tests.runtime.test_shading import random_frames

__all__ = ["random_light", "random_lobes", "random_side"]


def random_lobes(shape: tuple[int, ...], order: int, seed: int) -> Lobes:
    """About axes all over the sphere; the first two of the last axis at the poles."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(*shape, 3))
    axes[..., 0, :] = [0.0, 0.0, 1.0]
    axes[..., 1:2, :] = [0.0, 0.0, -1.0]
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    return Lobes(axes, rng.normal(size=(*shape, order)))


def random_side(count: int, order: int, seed: int = 0, lobes: int = 3) -> LobeSide:
    """Of vertices with any frames."""
    frames = random_frames(count + seed)[seed:]
    return LobeSide(random_lobes((count, lobes), order, seed), frames)


def random_light(order: int, seed: int = 9, lobes: int = 4) -> Lobes:
    """Of three colours."""
    return random_lobes((3, lobes), order, seed)
