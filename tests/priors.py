"""Small random priors."""

from __future__ import annotations

import itertools

import numpy as np

from prtnet.prior import MapPrior, NetworkPrior, Prior
from prtnet.surroundings import Surroundings
from tests.models import random_poses
from tests.skin import random_skin


def random_prior(
    kind: str, joints: int = 5, receivers: int = 40, order: int = 3, seed: int = 0,
    surroundings: Surroundings | None = None, poses: np.ndarray | None = None,
) -> Prior:  # fmt: skip
    """Maps or a network; the range it knows is crossed by some poses."""
    rng = np.random.default_rng(seed)
    sees = surroundings or random_skin(joints, receivers, seed=seed)
    seen = sees(random_poses(20, joints, seed=seed) if poses is None else poses)
    low, high = np.percentile(seen, (10, 90), axis=(0, 1)).astype(np.float32)

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32) / np.float32(shape[0] ** 0.5)

    if kind == "maps":
        count = 6
        cluster = getattr(sees, "cluster", np.arange(receivers) % count).astype(np.int32)
        return MapPrior(sees, low, high, cluster, normal(count, 2 * len(low), order**2))
    widths = [len(low) + 4, 8, 8, order**2]
    return NetworkPrior(
        sees, low, high, normal(receivers, 4),
        tuple(normal(a, b) for a, b in itertools.pairwise(widths)),
        tuple(normal(b) for b in widths[1:]),
    )  # fmt: skip
