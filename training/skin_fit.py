"""Spheres and patches fitted to a skinned scene, and which of them each cluster looks at."""

from __future__ import annotations

import dataclasses

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import one_thread
from prtnet.dataset import Dataset
from prtnet.features import joint_matrices
from prtnet.occluders import fit_spheres
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.surroundings import SMALLEST, fade

__all__ = ["fit_skin", "skin_patches", "strongest"]

INFLUENCES = 4  # joints that carry a point
REFERENCES = 6  # receivers of a cluster that choose what all of it looks at
POSES = 48  # in which they choose
PER_JOINT = 24  # spheres, at most


def fit_skin(
    dataset: Dataset,
    poses: FloatArray,
    slots: IntArray,
    spheres: int = 160,
    near_spheres: int = 40,
    patches: int = 768,
    near_patches: int = 64,
    order: int = 4,
    seed: int = 0,
) -> SkinSurroundings:
    """What receivers of a skinned scene see of its body.

    Args:
        dataset: for the mesh at rest and its skin weights.
        poses: training poses, flattened, (P, D).
        slots: receivers of each cluster, (C, R), −1 for empty.
        spheres: about how many to fit to the whole skin.
        near_spheres: how many of them a cluster looks at.
        patches: about how many pieces to cut the skin into.
        near_patches: how many of them a cluster looks at.
        order: of the caps' spherical harmonics.
        seed: of k-means and of the choice of poses.
    """
    assert dataset.joint_weights is not None
    weights = dataset.joint_weights.astype(np.float64)
    joints = weights.shape[1]
    rest = joint_matrices(dataset.rest_pose[None].astype(np.float64), joints)[0]
    size = float(np.ptp(dataset.rest_positions, axis=0).max()) or 1.0
    unit_rest = rest.copy()
    unit_rest[..., 3] = (rest[..., 3] - rest[0, :, 3]) / size
    position = (dataset.rest_positions.astype(np.float64) - rest[0, :, 3]) / size
    fitted = fit_spheres(position, weights, unit_rest, spheres, PER_JOINT, seed)
    ridden = unit_rest[fitted.joint]
    centre = (ridden[..., :3] @ fitted.centre[..., None])[..., 0] + ridden[..., 3]
    stretch = np.sqrt(np.sum(ridden[..., :3] ** 2, axis=(1, 2)) / 3.0)
    faces = dataset.receiver_of_vertex[dataset.faces]
    label = skin_patches(position, faces, weights, patches, seed)
    patch_centre, patch_area, patch_skin = gathered(position, faces, weights, label)
    skin_joint, skin_weight = strongest(weights)
    patch_joint, patch_weight = strongest(patch_skin)
    cluster = np.zeros(len(position), dtype=np.int32)
    for index, own in enumerate(slots):
        cluster[own[own >= 0]] = index
    dominant = np.stack([weights[own[own >= 0]].sum(axis=0) for own in slots]).argmax(axis=1)
    every = SkinSurroundings(
        joints=joints, size=size, rest_inverse=inverted(unit_rest).astype(np.float32),
        position=position.astype(np.float32), normal=dataset.rest_normals,
        tangent=dataset.rest_tangents, skin_joint=skin_joint, skin_weight=skin_weight,
        sphere_joint=fitted.joint, sphere_centre=centre.astype(np.float32),
        sphere_radius=(fitted.radius * stretch).astype(np.float32),
        patch_joint=patch_joint, patch_weight=patch_weight,
        patch_centre=patch_centre.astype(np.float32), patch_area=patch_area.astype(np.float32),
        cluster=cluster, own_joint=dominant.astype(np.int32),
        near_spheres=np.zeros((len(slots), 1), dtype=np.int32),
        near_patches=np.zeros((len(slots), 1), dtype=np.int32), order=order,
    )  # fmt: skip
    near = nearest(every, poses, slots, seed)
    counts = near_spheres, near_patches
    kept = [
        np.argsort(-strength, axis=1, kind="stable")[:, :count].astype(np.int32)
        for strength, count in zip(near, counts, strict=True)
    ]
    return dataclasses.replace(every, near_spheres=kept[0], near_patches=kept[1])


def inverted(matrices: FloatArray) -> FloatArray:
    """Inverses (J, 3, 4) of affine matrices (J, 3, 4); of a flat one the pseudo-inverse."""
    linear = np.linalg.pinv(matrices[..., :3])
    return np.concatenate([linear, -linear @ matrices[..., 3:]], axis=-1)


def strongest(weights: FloatArray) -> tuple[IntArray, FloatArray]:
    """The joints that carry each point most, (N, W), and their weights, which sum to one."""
    count = min(INFLUENCES, weights.shape[1])
    joint = np.argsort(-weights, axis=1, kind="stable")[:, :count].astype(np.int32)
    kept = np.take_along_axis(weights, joint, axis=1)
    total = np.maximum(kept.sum(axis=1, keepdims=True), SMALLEST)
    return joint, (kept / total).astype(np.float32)


def skin_patches(
    position: FloatArray, faces: IntArray, weights: FloatArray, count: int, seed: int
) -> IntArray:
    """The patch of each face, (T,): k-means of place, orientation and skin weights, by area."""
    from sklearn.cluster import MiniBatchKMeans

    corners = position[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    normal = cross / np.maximum(area, SMALLEST)[:, None]
    where = np.concatenate(
        [corners.mean(axis=1), 0.05 * normal, 0.05 * weights[faces].mean(axis=1)], axis=1
    )
    distinct = min(count, len(np.unique(where, axis=0)))
    means = MiniBatchKMeans(distinct, n_init=1, max_iter=30, batch_size=4096, random_state=seed)
    share = area if area.max() > 0 else None
    with one_thread():
        label = means.fit_predict(where, sample_weight=share)
    return np.unique(label, return_inverse=True)[1]


def gathered(
    position: FloatArray, faces: IntArray, weights: FloatArray, label: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centroid, vector area (Q, 3) and skin weights (Q, J) of patches of faces."""
    corners = position[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2.0
    area = np.maximum(np.linalg.norm(cross, axis=1), SMALLEST)
    total = np.bincount(label, area)

    def summed(values: FloatArray) -> FloatArray:
        return np.stack([np.bincount(label, column) for column in values.T], axis=1)

    centre = summed(corners.mean(axis=1) * area[:, None]) / total[:, None]
    skin = summed(weights[faces].mean(axis=1) * area[:, None]) / total[:, None]
    return centre, summed(cross), skin


def nearest(
    every: SkinSurroundings, poses: FloatArray, slots: IntArray, seed: int
) -> tuple[FloatArray, FloatArray]:
    """How much spheres (C, S) and patches (C, Q) ever cover of what a cluster sees."""
    rng = np.random.default_rng(seed)
    chosen = rng.permutation(len(poses))[:POSES]
    points = np.stack([rng.choice(own[own >= 0], REFERENCES) for own in slots])  # [C, M]
    strengths = [np.zeros((len(slots), len(kind)))
                 for kind in (every.sphere_joint, every.patch_joint)]  # fmt: skip
    for pose in poses[chosen]:
        carry = every.carry(pose)
        position, axes = every.frames(carry, points.ravel())
        spheres, radius2 = every.posed_spheres(carry)
        patches, area = every.posed_patches(carry)
        for kind, centre in enumerate((spheres, patches)):
            step = centre - position[:, None]  # [C · M, S, 3]
            distance2 = np.maximum(np.sum(step * step, axis=-1), SMALLEST)
            if kind == 0:
                sine2 = np.minimum(radius2 / distance2, 1.0)
            else:
                seen = np.abs(np.sum(area * step, axis=-1)) / np.sqrt(distance2)
                sine2 = seen / (np.pi * distance2 + seen)
            height = np.sum(step * axes[:, None, :, 2], axis=-1) / np.sqrt(distance2)
            covered = (1.0 - np.sqrt(1.0 - sine2)) * fade(height, sine2)
            most = covered.reshape(*points.shape, -1).max(axis=1)
            strengths[kind] = np.maximum(strengths[kind], most)
    return strengths[0], strengths[1]
