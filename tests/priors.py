"""Small random priors."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from prtnet.model import VisibilityModel
from prtnet.prior import MapPrior, NetworkPrior, Prior
from prtnet.surroundings import Surroundings
from tests.cloth import folding_sheet, surroundings_of
from tests.models import random_model, random_poses
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


def beside_prior(model: VisibilityModel, prior: Prior, bounded: bool = False) -> VisibilityModel:
    """The model with a prior that is worth as much as the rest, and bounds that values cross."""
    size = model.order**2
    bounds = np.stack([np.full(size, -1.0), np.full(size, 1.5)]).astype(np.float32)
    return dataclasses.replace(
        model,
        kind="hybrid" if prior.kind == "maps" else "shared",
        basis=0.1 * model.basis,
        mean=0.3 * model.mean,
        prior=prior,
        signal=np.zeros((model.receiver_count, size), dtype=np.float32),
        bounds=bounds if bounded else None,
    )


def sheet_with_prior(
    kind: str, two_sided: bool = True, **options: object
) -> tuple[VisibilityModel, np.ndarray]:
    """A model of a folding sheet, and poses of it."""
    scene = folding_sheet(9, 8)
    poses = scene.frames.reshape(len(scene.frames), -1)
    seen, receivers, _ = surroundings_of(scene, two_sided, **options)
    model = random_model(features="dihedral_angles", joints=18, receivers=len(receivers))
    model.metadata["pose_size"] = poses.shape[1]
    prior = random_prior(kind, receivers=len(receivers), surroundings=seen, poses=poses)
    return beside_prior(model, prior), poses
