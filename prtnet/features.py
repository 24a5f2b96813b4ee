"""What a regressor sees of a pose: joint or dihedral angles, or what surrounds each cluster.

These are the reference evaluations; the ONNX graph repeats them in portable operators.
"""

from __future__ import annotations

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from prtnet import sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.limits import check_order
from prtnet.occluders import Spheres, cap_integrals

__all__ = [
    "DihedralAngles",
    "Features",
    "JointAngles",
    "LocalJoints",
    "Occluders",
    "features_from_arrays",
]

FULL_FOLD = 1e-2  # of 2 + 2 cos θ: beyond 174° a fold's angle is not resolved in single precision
SMALLEST = 1e-12  # squared lengths below it are no direction


class Features(ABC):
    """A map from flattened poses (P, D) to features (P, 1 or C, F), float32."""

    kind: ClassVar[str]

    @abstractmethod
    def __call__(self, poses: FloatArray) -> FloatArray:
        """Features of flattened poses (P, D): (P, 1, F) for all clusters or (P, C, F)."""

    @abstractmethod
    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """The arrays that define it, for a model file."""

    def of_clusters(self, clusters: IntArray) -> Features:
        """The features of some clusters, (A,), alone; those that all share stay as they are."""
        del clusters
        return self


def joint_matrices(poses: FloatArray, joints: int) -> FloatArray:
    """Model-space joint matrices (P, J, 3, 4) at the head of flattened poses (P, D)."""
    return poses[:, : 12 * joints].reshape(len(poses), joints, 3, 4)


def directions(vectors: FloatArray, axis: int = -1) -> FloatArray:
    """Unit vectors along ``axis``; a vanishing one stays (nearly) zero."""
    square = np.sum(vectors * vectors, axis=axis, keepdims=True)
    return vectors / np.sqrt(np.maximum(square, SMALLEST))


@dataclass(frozen=True, eq=False)
class JointAngles(Features):
    """Six floats a joint: two columns of its rotation relative to its parent joint; morph weights.

    "Arbitrary BRDFs" section 5.1.

    Attributes:
        joint: the joints that move, (A,).
        parent: the parent joint of each, -1 for none, (A,).
        joints: number of joints in a pose.
    """

    kind: ClassVar[str] = "joint_angles"
    joint: IntArray
    parent: IntArray
    joints: int

    def __call__(self, poses: FloatArray) -> FloatArray:
        """See :class:`Features`."""
        rotation = directions(joint_matrices(poses, self.joints)[..., :3], axis=-2)
        child = rotation[:, self.joint]
        identity = np.eye(3, dtype=poses.dtype)
        has_parent = (self.parent >= 0)[:, None, None]
        parent = np.where(has_parent, rotation[:, np.maximum(self.parent, 0)], identity)
        local = np.swapaxes(parent, -1, -2) @ child  # [P, A, 3, 3]
        angles = local[..., :2].reshape(len(poses), -1)
        morphs = poses[:, 12 * self.joints :]
        return np.concatenate([angles, morphs], axis=1)[:, None].astype(np.float32)

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Features`."""
        return {"joint": self.joint, "parent": self.parent, "joints": np.array([self.joints])}


@dataclass(frozen=True, eq=False)
class DihedralAngles(Features):
    """2 sin(θ/2) of the angle θ between the two faces at each interior edge of a point cache.

    "Arbitrary BRDFs" section 5.1 takes θ itself; 2 sin(θ/2) is nearly θ, grows with it up to
    174°, and needs no arctangent. An edge whose face has no area gives 0.

    Attributes:
        edge: for each edge its two ends and the vertices across, of the face on its left and of
            the one on its right, (E, 4).
    """

    kind: ClassVar[str] = "dihedral_angles"
    edge: IntArray

    def __call__(self, poses: FloatArray) -> FloatArray:
        """See :class:`Features`."""
        count = max(1, 500_000 // max(1, len(self.edge)))
        parts = [self._block(poses[i : i + count]) for i in range(0, len(poses), count)]
        return np.concatenate(parts)[:, None].astype(np.float32)

    def _block(self, poses: FloatArray) -> FloatArray:
        points = poses.astype(np.float64).reshape(len(poses), -1, 3)
        start, end, left, right = (points[:, self.edge[:, k]] for k in range(4))
        along = directions(end - start)
        # Unit normals: in metres or millimetres the same.
        first = directions(np.cross(along, directions(left - start)))
        second = directions(np.cross(directions(right - start), along))
        cosine = np.sum(first * second, axis=-1)
        sine = np.sum(np.cross(first, second) * along, axis=-1)
        return 2.0 * sine / np.sqrt(np.maximum(2.0 + 2.0 * cosine, FULL_FOLD))

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Features`."""
        return {"edge": self.edge}


@dataclass(frozen=True, eq=False)
class LocalJoints(Features):
    """Where all joints are in the frame of each cluster's dominant joint, p → p / (|p| + reach).

    It ignores global motion; what is far away changes little. The three components of all joints
    follow each other, x first, then the morph weights, the same for every cluster. Joints may be
    scaled, by one factor each.

    Attributes:
        cluster_joint: the dominant joint of each cluster, (C,).
        reach: the distance at which a position counts half, in units of that joint, (C,).
        joints: number of joints in a pose.
    """

    kind: ClassVar[str] = "local_joints"
    cluster_joint: IntArray
    reach: FloatArray
    joints: int

    def __call__(self, poses: FloatArray) -> FloatArray:
        """See :class:`Features`."""
        count = max(1, 1_000_000 // (3 * self.joints * len(self.cluster_joint)))
        parts = [self._block(poses[i : i + count]) for i in range(0, len(poses), count)]
        return np.concatenate(parts).astype(np.float32)

    def of_clusters(self, clusters: IntArray) -> LocalJoints:
        """See :class:`Features`."""
        own = self.cluster_joint[clusters], self.reach[clusters]
        return LocalJoints(*own, self.joints)

    def _block(self, poses: FloatArray) -> FloatArray:
        matrices = joint_matrices(poses.astype(np.float64), self.joints)
        home, places = matrices[:, self.cluster_joint], matrices[..., 3]
        linear = home[..., :3]
        square = np.maximum(np.sum(linear * linear, axis=-2, keepdims=True), SMALLEST)
        away = places[:, None] - home[:, :, None, :, 3]  # [P, C, J, 3]
        local = away @ (linear / square)
        distance = np.sqrt(np.maximum(np.sum(local * local, axis=-1, keepdims=True), SMALLEST))
        seen = local / (distance + self.reach.astype(np.float64)[:, None, None])
        seen = np.swapaxes(seen, -1, -2).reshape(len(poses), len(self.cluster_joint), -1)
        morphs = poses[:, None, 12 * self.joints :]
        shape = (*seen.shape[:2], morphs.shape[-1])
        return np.concatenate([seen, np.broadcast_to(morphs, shape)], axis=-1)

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Features`."""
        return {
            "cluster_joint": self.cluster_joint,
            "reach": self.reach,
            "joints": np.array([self.joints]),
        }


@dataclass(frozen=True, eq=False)
class Occluders(Features):
    """SH of the caps that nearby spheres cover, seen from each cluster in its own joint's frame.

    For each of a cluster's reference points, the sum over the cluster's spheres of the cap's SH.
    It ignores global motion and everything far away, and is nearly linear in what visibility does.
    Morph weights follow, the same for every cluster. Joints may be scaled, by one factor each.

    Attributes:
        spheres: the occluders.
        cluster_joint: the dominant joint of each cluster, (C,).
        point: reference points in that joint's frame, (C, M, 3).
        near: the spheres that matter to each cluster, (C, K).
        order: of the spherical harmonics, at most ``MOST_ORDER``; (M · order²) features a cluster.
        joints: number of joints in a pose.
        one_scale: whether all joints of a pose have the same scale, so that a radius in the units
            of its own joint is one in everybody's.
    """

    kind: ClassVar[str] = "occluders"
    MOST_ORDER: ClassVar[int] = 3  # what the ONNX graph has closed forms for
    spheres: Spheres
    cluster_joint: IntArray
    point: FloatArray
    near: IntArray
    order: int
    joints: int
    one_scale: bool = False

    def __call__(self, poses: FloatArray) -> FloatArray:
        """See :class:`Features`."""
        clusters, points, _ = self.point.shape
        count = max(1, 1_000_000 // max(1, self.near.size * points * self.order**2))
        parts = [self._block(poses[i : i + count]) for i in range(0, len(poses), count)]
        caps = np.concatenate(parts).reshape(len(poses), clusters, points * self.order**2)
        morphs = poses[:, None, 12 * self.joints :]
        shape = (len(poses), clusters, morphs.shape[-1])
        return np.concatenate([caps, np.broadcast_to(morphs, shape)], axis=-1).astype(np.float32)

    def of_clusters(self, clusters: IntArray) -> Occluders:
        """See :class:`Features`."""
        names = "cluster_joint", "point", "near"
        return dataclasses.replace(self, **{name: getattr(self, name)[clusters] for name in names})

    def _block(self, poses: FloatArray) -> FloatArray:
        cosine, direction = self.seen(poses)
        integrals = 2.0 * np.pi * cap_integrals(cosine, self.order)
        basis = sh.evaluate(direction, self.order)
        bands = [slice(degree**2, (degree + 1) ** 2) for degree in range(self.order)]
        summed = [
            np.einsum("pcmk,pcmki->pcmi", integrals[..., degree], basis[..., band])
            for degree, band in enumerate(bands)
        ]
        return np.concatenate(summed, axis=-1)

    def seen(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Each reference point's spheres: cos θ of the cap and local direction to the centre.

        Returns:
            (P, C, M, K) and (P, C, M, K, 3), float64. A point inside a sphere sees a half-space
            blocked.
        """
        matrices = joint_matrices(poses.astype(np.float64), self.joints)
        linear, offset = matrices[..., :3], matrices[..., 3]
        ridden = self.spheres.joint
        centre = (linear[:, ridden] @ self.spheres.centre[..., None])[..., 0] + offset[:, ridden]
        home, home_offset = linear[:, self.cluster_joint], offset[:, self.cluster_joint]
        square = np.maximum(np.sum(home * home, axis=-2, keepdims=True), SMALLEST)
        if self.one_scale:  # anybody's will do
            square = square[:, :1, :, :1]
        away = centre[:, self.near] - home_offset[:, :, None]  # [P, C, K, 3]
        local = (away @ (home / square))[:, :, None] - self.point[:, :, None]  # [P, C, M, K, 3]
        distance2 = np.maximum(np.sum(local * local, axis=-1), SMALLEST)
        radius2 = (self.spheres.radius.astype(np.float64) ** 2)[self.near][None]  # [1, C, K]
        if not self.one_scale:
            scale2 = np.sum(linear[..., 0] ** 2, axis=-1)  # [P, J]
            radius2 = radius2 * scale2[:, ridden[self.near]] / square[:, :, 0, :1]
        sine2 = np.minimum(radius2[:, :, None] / distance2, 1.0)
        return np.sqrt(1.0 - sine2), local / np.sqrt(distance2)[..., None]

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Features`."""
        return {
            "sphere_joint": self.spheres.joint,
            "sphere_centre": self.spheres.centre,
            "sphere_radius": self.spheres.radius,
            "cluster_joint": self.cluster_joint,
            "point": self.point,
            "near": self.near,
            "order": np.array([self.order]),
            "joints": np.array([self.joints]),
            "one_scale": np.array([int(self.one_scale)]),
        }


def features_from_arrays(kind: str, arrays: dict[str, Any]) -> Features:
    """The inverse of :meth:`Features.arrays`.

    Raises:
        KeyError: an array is missing, or the kind is unknown.
        ValueError: an index is below zero, or the order too high.
    """
    indices = ("joint", "parent", "edge", "cluster_joint", "near", "sphere_joint")
    if any(
        np.min(arrays[name], initial=0) < -(name == "parent") for name in indices if name in arrays
    ):
        raise ValueError("features point before their tables")
    if kind == DihedralAngles.kind:
        return DihedralAngles(arrays["edge"])
    joints = int(arrays["joints"][0])
    if kind == JointAngles.kind:
        return JointAngles(arrays["joint"], arrays["parent"], joints)
    if kind == LocalJoints.kind:
        return LocalJoints(arrays["cluster_joint"], arrays["reach"], joints)
    if kind == Occluders.kind:
        check_order(int(arrays["order"][0]))
        spheres = Spheres(arrays["sphere_joint"], arrays["sphere_centre"], arrays["sphere_radius"])
        return Occluders(
            spheres, arrays["cluster_joint"], arrays["point"], arrays["near"],
            int(arrays["order"][0]), joints, bool(arrays["one_scale"][0]),
        )  # fmt: skip
    raise KeyError(kind)
