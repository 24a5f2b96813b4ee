"""Features fitted to a dataset's scene: which joints move, where each cluster looks from."""

from __future__ import annotations

import dataclasses

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import one_thread
from prtnet.features import (
    DihedralAngles,
    JointAngles,
    LocalJoints,
    Occluders,
    joint_matrices,
)
from prtnet.occluders import fit_spheres

__all__ = [
    "fit_joint_angles",
    "fit_local_joints",
    "fit_occluders",
    "interior_edges",
    "moving_joints",
]

SAME_SCALE = 1e-3  # relative
LIFT = 0.02  # of the scene's largest extent
REACH = 0.15  # of the scene's height
STILL = 1e-4  # a joint whose six floats never leave this range does not move


def fit_joint_angles(poses: FloatArray, parents: IntArray) -> JointAngles:
    """Joint angles of the joints that move in flattened poses (P, D); parents (J,)."""
    every = JointAngles(np.arange(len(parents), dtype=np.int32), parents, len(parents))
    moving = moving_joints(every(poses)[:, 0, : 6 * len(parents)])
    if len(moving) == 0:
        moving = every.joint[:1]  # a feature that says nothing, rather than none
    return JointAngles(moving, parents[moving], len(parents))


def moving_joints(angles: FloatArray) -> IntArray:
    """Joints whose six floats (P, 6·J) change over the poses."""
    spread = np.ptp(angles.reshape(len(angles), -1, 6), axis=0).max(axis=1)
    return np.flatnonzero(spread > STILL).astype(np.int32)


def dominant_joints(slots: IntArray, joint_weights: FloatArray) -> IntArray:
    """The joint that moves each cluster most, (C,), of slots (C, R) and skin weights (V, J)."""
    return np.array(
        [np.argmax(joint_weights[own[own >= 0]].sum(axis=0)) for own in slots], dtype=np.int32
    )


def fit_local_joints(
    slots: IntArray, rest_positions: FloatArray, joint_weights: FloatArray, rest_pose: FloatArray
) -> LocalJoints:
    """Joints in the frame of each cluster's dominant joint; nearby is a fraction of the height.

    Args:
        slots: receivers of each cluster, (C, R), −1 for empty.
        rest_positions: receivers at rest, (V, 3).
        joint_weights: (V, J).
        rest_pose: the pose of that rest, (D,).
    """
    joints = joint_weights.shape[1]
    home = dominant_joints(slots, joint_weights)
    scale = np.linalg.norm(joint_matrices(rest_pose[None], joints)[0, home, :, 0], axis=1)
    height = float(np.ptp(rest_positions, axis=0).max())
    reach = REACH * height / np.where(scale > 0, scale, 1.0)
    return LocalJoints(home, reach.astype(np.float32), joints)


def interior_edges(faces: IntArray, welded: IntArray) -> DihedralAngles:
    """Dihedral angles of the edges that have a face on either side.

    Args:
        faces: triangles over render vertices, (T, 3).
        welded: for each render vertex a number shared by those in the same place, (V_render,).
    """
    _, representative, inverse = np.unique(welded, return_index=True, return_inverse=True)
    corners = representative[inverse[faces]]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    starts, ends = corners, np.roll(corners, -1, axis=1)
    table = np.stack([starts, ends, np.roll(corners, -2, axis=1)], axis=-1).reshape(-1, 3)
    forward = table[table[:, 0] < table[:, 1]]
    backward = table[table[:, 0] > table[:, 1]][:, [1, 0, 2]]
    # An edge used twice in one direction is no manifold's: its first face stands for both.
    _, first = np.unique(forward[:, :2], axis=0, return_index=True)
    _, other = np.unique(backward[:, :2], axis=0, return_index=True)
    forward, backward = forward[first], backward[other]
    size = len(representative) + int(corners.max(initial=0)) + 1
    ours, theirs = (side[:, 0].astype(np.int64) * size + side[:, 1] for side in (forward, backward))
    _, left, right = np.intersect1d(ours, theirs, assume_unique=True, return_indices=True)
    edge = np.concatenate([forward[left], backward[right, 2:]], axis=1)
    return DihedralAngles(edge.astype(np.int32))


def reference_points(
    positions: FloatArray, normals: FloatArray, count: int, lift: float
) -> FloatArray:
    """Points spread over a cluster (N, 3) and lifted off the surface, (count, 3).

    The centroids of k-means parts, each moved by ``lift`` along its part's mean normal; a cluster
    with fewer distinct receivers repeats some.
    """
    from sklearn.cluster import KMeans

    distinct = min(count, len(np.unique(positions, axis=0)))
    with one_thread():
        parts = KMeans(distinct, n_init=2, random_state=0).fit(positions.astype(np.float64))
    normal = np.zeros((distinct, 3))
    np.add.at(normal, parts.labels_, normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return (parts.cluster_centers_ + lift * normal)[np.arange(count) % distinct]


def fit_occluders(
    poses: FloatArray,
    slots: IntArray,
    rest_positions: FloatArray,
    rest_normals: FloatArray,
    joint_weights: FloatArray,
    rest_pose: FloatArray,
    points: int = 6,
    near: int = 48,
    spheres: int = 160,
    order: int = 3,
    seed: int = 0,
) -> Occluders:
    """Occluder features for clusters of receivers.

    Reference points are centroids of parts of the cluster, a little off
    the surface. Each cluster keeps the spheres, not on its own joint, that ever cover
    most of a point's view.

    Args:
        poses: training poses, flattened, (P, D).
        slots: receivers of each cluster, (C, R), −1 for empty.
        rest_positions: receivers at rest, (V, 3).
        rest_normals: their normals, (V, 3).
        joint_weights: (V, J).
        rest_pose: the pose of that rest, (D,).
        points: M reference points a cluster.
        near: K spheres a cluster.
        spheres: about how many to fit to the whole skin.
        order: of the caps' spherical harmonics.
        seed: of k-means.
    """
    joints = joint_weights.shape[1]
    rest = joint_matrices(rest_pose[None], joints)[0].astype(np.float64)
    fitted = fit_spheres(rest_positions, joint_weights, rest, spheres, seed=seed)
    lift = LIFT * float(np.ptp(rest_positions, axis=0).max())
    home = dominant_joints(slots, joint_weights)
    where = np.zeros((len(slots), points, 3), dtype=np.float32)
    for cluster, own in enumerate(slots):
        own = own[own >= 0]
        seen = reference_points(rest_positions[own], rest_normals[own], points, lift)
        linear, offset = rest[home[cluster], :, :3], rest[home[cluster], :, 3]
        where[cluster] = (seen - offset) @ np.linalg.pinv(linear).T
    candidates = np.broadcast_to(np.arange(len(fitted), dtype=np.int32), (len(slots), len(fitted)))
    one_scale = same_scale(poses, joints)
    every = Occluders(fitted, home, where, candidates, order, joints, one_scale)
    return dataclasses.replace(every, near=nearest_spheres(every, poses, near))


def same_scale(poses: FloatArray, joints: int) -> bool:
    """Whether all joints of each flattened pose (P, D) are scaled alike, as in most rigs."""
    lengths = np.linalg.norm(joint_matrices(poses, joints)[..., :3], axis=-2).reshape(
        len(poses), -1
    )
    return bool((np.ptp(lengths, axis=1) <= SAME_SCALE * lengths.max(axis=1)).all())


def nearest_spheres(every: Occluders, poses: FloatArray, near: int) -> IntArray:
    """For each cluster the ``near`` spheres of other joints that cover most, (C, K).

    ``every`` has all spheres near every cluster. Where a cluster has fewer on other joints, all
    clusters keep that many: one, its own, on a rig of a single joint.
    """
    most = np.zeros(every.near.shape)
    for start in range(0, len(poses), 8):
        cosine, _ = every.seen(poses[start : start + 8])
        most = np.maximum(most, (1.0 - cosine).max(axis=(0, 2)))
    own = every.spheres.joint[None, :] == every.cluster_joint[:, None]  # [C, S]
    score = np.where(own, -1.0, most)
    fewest_foreign = int((~own).sum(axis=1).min())
    count = max(1, min(near, fewest_foreign))
    return np.argsort(-score, axis=-1)[:, :count].astype(np.int32)
