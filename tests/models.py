"""Small random models and poses: what tests of evaluation and export need."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from prtnet.features import DihedralAngles, Features, JointAngles, LocalJoints, Occluders
from prtnet.lobe_numbers import LobeNumbers
from prtnet.model import Regressor, VisibilityModel
from prtnet.occluders import Spheres


def random_poses(
    count: int, joints: int, morphs: int = 0, seed: int = 0, one_scale: bool = False
) -> np.ndarray:
    """Poses of joints scattered in a two-metre box, all turned and scaled at random.

    With ``one_scale`` all joints of a pose are scaled alike.
    """
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(count * joints, rng=rng).as_matrix().reshape(count, joints, 3, 3)
    scale = rng.uniform(0.5, 2.0, (count, 1 if one_scale else joints, 1, 1))
    offset = rng.uniform(-1.0, 1.0, (count, joints, 3, 1))
    matrices = np.concatenate([rotation * scale, offset], axis=-1).reshape(count, -1)
    weights = rng.uniform(0.0, 1.0, (count, morphs))
    return np.concatenate([matrices, weights], axis=1).astype(np.float32)


def random_features(kind: str, joints: int, clusters: int, order: int, seed: int = 0) -> Features:
    rng = np.random.default_rng(seed)
    if kind == "joint_angles":
        parent = np.arange(-1, joints - 1)
        moving = np.arange(0, joints, 2)
        return JointAngles(moving.astype(np.int32), parent[moving].astype(np.int32), joints)
    if kind == "dihedral_angles":  # of a cache with four vertices for each of the joints' numbers
        vertices = [rng.choice(4 * joints, 4, replace=False) for _ in range(9)]
        return DihedralAngles(np.array(vertices, dtype=np.int32))
    if kind == "local_joints":
        home = rng.integers(0, joints, clusters).astype(np.int32)
        return LocalJoints(home, rng.uniform(0.1, 0.5, clusters).astype(np.float32), joints)
    spheres = Spheres(
        rng.integers(0, joints, 11).astype(np.int32),
        rng.normal(0, 0.2, (11, 3)).astype(np.float32),
        rng.uniform(0.02, 0.6, 11).astype(np.float32),
    )
    return Occluders(
        spheres,
        rng.integers(0, joints, clusters).astype(np.int32),
        rng.normal(0, 0.3, (clusters, 3, 3)).astype(np.float32),
        rng.integers(0, 11, (clusters, 7)).astype(np.int32),
        order,
        joints,
        bool(seed % 2),
    )


def random_model(
    kind: str = "neural",
    features: str = "occluders",
    joints: int = 5,
    morphs: int = 0,
    clusters: int = 6,
    receivers: int = 40,
    feature_order: int = 3,
    seed: int = 0,
    parts: int = 1,
    clamped: bool = True,
    lobes: int = 0,
    order: int = 3,
) -> VisibilityModel:
    """A model whose every array is random, with groups of unequally many latents.

    With ``lobes`` it is of that kind, and ``kind`` is its regressor's.

    With ``clamped`` it has a training range that random poses are now inside and now outside of.
    """
    rng = np.random.default_rng(seed)
    seen = random_features(features, joints, clusters, feature_order, seed)
    width = seen(random_poses(1, joints, morphs)).shape[-1]
    inputs, neurons, most = 4, 6, 5
    groups = clusters * parts
    capacity = -(-receivers // groups)
    slots = np.full(groups * capacity, -1, dtype=np.int32)
    slots[:receivers] = rng.permutation(receivers)
    rng.shuffle(slots)
    latents = rng.choice([0, 2, most], groups).astype(np.int32)
    if kind == "constant":
        latents[:] = 0
    shared = clusters if features in ("occluders", "local_joints") else 1

    def normal(*shape: int) -> np.ndarray:
        return rng.normal(size=shape).astype(np.float32)

    numbers = LobeNumbers(lobes, order).size if lobes else order**2
    hidden = neurons if kind == "neural" else inputs
    pairs = None
    if kind == "quadratic":
        pairs = np.array([[0, 0, 1, 2, 1], [0, 1, 3, 3, 1]], dtype=np.int32)
        hidden += pairs.shape[1]
    return VisibilityModel(
        kind="lobes" if lobes else kind,
        order=order,
        features=seen,
        input_mean=normal(shared, width),
        input_basis=normal(shared, width, inputs) / width**0.5,
        regressor=Regressor(
            normal(groups, hidden, most),
            normal(groups, most),
            normal(clusters, inputs, neurons) if kind == "neural" else None,
            normal(clusters, neurons) if kind == "neural" else None,
            pairs,
        ),
        latents=latents,
        receivers=slots.reshape(groups, capacity),
        mean=normal(groups, capacity * numbers),
        basis=normal(int(latents.sum()), capacity * numbers),
        rest_tangents=normal(receivers, 3),
        metadata={"pose_size": 12 * joints + morphs, "format_version": 2},
        input_low=-np.abs(normal(shared, inputs)) if clamped else None,
        input_high=np.abs(normal(shared, inputs)) if clamped else None,
        signal=normal(receivers, order**2) if lobes else None,
        lobes=lobes,
    )
