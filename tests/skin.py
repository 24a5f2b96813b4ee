"""A small body of a few joints and what its receivers see: for tests of priors and their graphs."""

from __future__ import annotations

import numpy as np

from prtnet.skin_surroundings import SkinSurroundings


def random_skin(
    joints: int = 5, receivers: int = 40, clusters: int = 6, order: int = 4, seed: int = 0
) -> SkinSurroundings:
    """Everything random: no body, but every array is used."""
    rng = np.random.default_rng(seed)

    def weights(count: int) -> np.ndarray:
        raw = rng.uniform(0.1, 1.0, (count, 3))
        return (raw / raw.sum(axis=1, keepdims=True)).astype(np.float32)

    def unit(count: int) -> np.ndarray:
        v = rng.normal(size=(count, 3))
        return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)

    def index(high: int, *shape: int) -> np.ndarray:
        return rng.integers(0, high, shape).astype(np.int32)

    cluster = np.concatenate([np.arange(clusters), index(clusters, receivers - clusters)])
    inverse = np.concatenate([rng.normal(0, 0.5, (joints, 3, 3)) + np.eye(3),
                              rng.normal(0, 0.2, (joints, 3, 1))], axis=-1)  # fmt: skip
    return SkinSurroundings(
        joints=joints, size=1.7, rest_inverse=inverse.astype(np.float32),
        position=rng.normal(0, 0.3, (receivers, 3)).astype(np.float32),
        normal=unit(receivers), tangent=unit(receivers),
        skin_joint=index(joints, receivers, 3), skin_weight=weights(receivers),
        sphere_joint=index(joints, 11),
        sphere_centre=rng.normal(0, 0.3, (11, 3)).astype(np.float32),
        sphere_radius=rng.uniform(0.02, 0.4, 11).astype(np.float32),
        patch_joint=index(joints, 13, 3), patch_weight=weights(13),
        patch_centre=rng.normal(0, 0.3, (13, 3)).astype(np.float32),
        patch_area=rng.normal(0, 0.05, (13, 3)).astype(np.float32),
        cluster=cluster.astype(np.int32), own_joint=index(joints, clusters),
        near_spheres=index(11, clusters, 5), near_patches=index(13, clusters, 7), order=order,
    )  # fmt: skip
