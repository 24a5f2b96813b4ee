"""What each receiver of a skinned mesh sees of the body around it, in its own frame.

Two kinds of occluders. *Spheres* fitted to the skin ride on joints and stand for the body's volume;
those of the cluster's own joint and all others are summed apart. *Patches* are pieces of the skin,
carried by its joints like vertices: one of vector area A in direction u at distance d covers a cap
with sin² θ = |A·u| / (π d² + |A·u|), the solid angle of a small disc; those that turn their outside
and those that turn their inside to the receiver are summed apart. Of either kind a cluster of
receivers looks only at those that matter to it.

Receivers, too, are carried by their joints from rest, with their normals and tangents. Morph
targets move neither.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.features import joint_matrices
from prtnet.limits import check_order
from prtnet.surroundings import SMALLEST, Surroundings, cap_sums

__all__ = ["SkinSurroundings"]

BLOCK_PAIRS = 60_000  # receivers × occluders at a time: what stays in the cache


@dataclass(frozen=True, eq=False)
class SkinSurroundings(Surroundings):
    """Flattened poses (P, D) of a skinned scene to features (P, V, 4 · n²).

    The sums over foreign spheres, over spheres of the cluster's own joint, over patches that show
    their outside, and over those that show their inside. Lengths are in units of ``size`` and
    about joint 0 at rest, so that scale and place do not matter.

    Attributes:
        joints: number of joints J in a pose.
        size: the scene's extent at rest, the unit of length below.
        rest_inverse: from rest to each joint's frame, (J, 3, 4).
        position, normal, tangent: of receivers at rest, (V, 3).
        skin_joint, skin_weight: the joints that carry each receiver, (V, W); rows sum to one.
        sphere_joint, sphere_centre, sphere_radius: (S,), (S, 3) at rest, (S,).
        patch_joint, patch_weight: the joints that carry each patch, (Q, W).
        patch_centre, patch_area: centroid and vector area at rest, (Q, 3).
        cluster: of each receiver, (V,).
        own_joint: dominant joint of each cluster, (C,).
        near_spheres, near_patches: the occluders each cluster looks at, (C, K) and (C, L).
        order: n of the spherical harmonics, at most ``MOST_ORDER``.
    """

    kind: ClassVar[str] = "skin"
    MOST_ORDER: ClassVar[int] = 4  # what the ONNX graph has closed forms for
    GROUPS: ClassVar[int] = 4
    joints: int
    size: float
    rest_inverse: FloatArray
    position: FloatArray
    normal: FloatArray
    tangent: FloatArray
    skin_joint: IntArray
    skin_weight: FloatArray
    sphere_joint: IntArray
    sphere_centre: FloatArray
    sphere_radius: FloatArray
    patch_joint: IntArray
    patch_weight: FloatArray
    patch_centre: FloatArray
    patch_area: FloatArray
    cluster: IntArray
    own_joint: IntArray
    near_spheres: IntArray
    near_patches: IntArray
    order: int

    @property
    def feature_count(self) -> int:
        """See :class:`Surroundings`."""
        return self.GROUPS * self.order**2

    @property
    def receiver_count(self) -> int:
        """See :class:`Surroundings`."""
        return len(self.position)

    def __call__(self, poses: FloatArray) -> FloatArray:
        """See :class:`Surroundings`."""
        everyone = np.arange(self.receiver_count)
        out = np.empty((len(poses), self.receiver_count, self.feature_count), dtype=np.float32)
        for pose, features in zip(poses, out, strict=True):
            features[:] = self.at(pose, everyone)
        return out

    def at(self, pose: FloatArray, receivers: IntArray) -> FloatArray:
        """See :class:`Surroundings`."""
        carry = self.carry(pose)
        spheres, patches = self.posed_spheres(carry), self.posed_patches(carry)
        count = max(1, BLOCK_PAIRS // (self.near_spheres.shape[1] + self.near_patches.shape[1]))
        out = np.empty((len(receivers), self.feature_count), dtype=np.float32)
        for start in range(0, len(receivers), count):
            own = receivers[start : start + count]
            out[start : start + count] = self._block(carry, spheres, patches, own)
        return out

    def carry(self, pose: FloatArray) -> FloatArray:
        """Matrices (J, 3, 4) float64 that carry points from rest to the pose (D,).

        Both in units of ``size``, about joint 0.
        """
        matrices = joint_matrices(pose[None].astype(np.float64), self.joints)[0]
        linear = matrices[..., :3]
        inverse = self.rest_inverse.astype(np.float64)
        offset = (matrices[..., 3] - matrices[:1, :, 3]) / self.size
        carried: FloatArray = offset + (linear @ inverse[..., 3:])[..., 0]
        return np.concatenate([linear @ inverse[..., :3], carried[..., None]], axis=-1)

    def posed_spheres(self, carry: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centres (S, 3) and squared radii (S,)."""
        matrices = carry[self.sphere_joint]
        centre = (matrices[..., :3] @ self.sphere_centre[..., None])[..., 0] + matrices[..., 3]
        scale2 = np.sum(matrices[..., :3] ** 2, axis=(1, 2)) / 3.0
        return centre, self.sphere_radius.astype(np.float64) ** 2 * scale2

    def posed_patches(self, carry: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Centroids (Q, 3) and vector areas (Q, 3): the cofactor matrix carries areas."""
        matrices = blended(carry, self.patch_joint, self.patch_weight)
        linear = matrices[..., :3]
        centre = (linear @ self.patch_centre[..., None])[..., 0] + matrices[..., 3]
        return centre, (cofactors(linear) @ self.patch_area[..., None])[..., 0]

    def frames(self, carry: FloatArray, receivers: IntArray) -> tuple[FloatArray, FloatArray]:
        """Positions (N, 3) and frames (N, 3, 3), columns tangent, bitangent, normal."""
        matrices = blended(carry, self.skin_joint[receivers], self.skin_weight[receivers])
        linear = matrices[..., :3]
        position = (linear @ self.position[receivers, :, None])[..., 0] + matrices[..., 3]
        normal = unit((cofactors(linear) @ self.normal[receivers, :, None])[..., 0])
        tangent = (linear @ self.tangent[receivers, :, None])[..., 0]
        along = np.sum(tangent * normal, axis=-1, keepdims=True)
        beside = unit(tangent - along * normal)
        return position, np.stack([beside, np.cross(normal, beside), normal], axis=-1)

    def _block(
        self,
        carry: FloatArray,
        spheres: tuple[FloatArray, FloatArray],
        patches: tuple[FloatArray, FloatArray],
        receivers: IntArray,
    ) -> FloatArray:
        position, axes = self.frames(carry, receivers)
        cluster = self.cluster[receivers]
        near = self.near_spheres[cluster]
        steps = apart(spheres[0], near, position)
        distance2 = np.maximum(sum(step * step for step in steps), SMALLEST)
        sine2 = np.minimum(spheres[1].astype(np.float32)[near] / distance2, 1.0)
        own = self.own_sphere[cluster]
        volume = cap_sums(turned(steps, axes), sine2, (1.0 - own, own), self.order)

        near = self.near_patches[cluster]
        steps = apart(patches[0], near, position)
        distance2 = np.maximum(sum(step * step for step in steps), SMALLEST)
        areas = np.ascontiguousarray(patches[1].T.astype(np.float32))
        facing = -sum(area[near] * step for area, step in zip(areas, steps, strict=True))
        facing /= np.sqrt(distance2)
        seen = np.abs(facing)
        sine2 = seen / (math.pi * distance2 + seen)
        outside = (facing > 0).astype(np.float32)
        skin = cap_sums(turned(steps, axes), sine2, (outside, 1.0 - outside), self.order)
        return np.concatenate([volume, skin], axis=-1)

    @cached_property
    def own_sphere(self) -> FloatArray:
        """(C, K) ones where a sphere rides on the cluster's own joint."""
        return (self.sphere_joint[self.near_spheres] == self.own_joint[:, None]).astype(np.float32)

    def arrays(self) -> dict[str, Any]:
        """See :class:`Surroundings`."""
        names = [field.name for field in dataclasses.fields(self)]
        return {name: np.atleast_1d(getattr(self, name)) for name in names}

    @classmethod
    def from_arrays(cls, arrays: dict[str, Any]) -> SkinSurroundings:
        """The inverse of :meth:`arrays`.

        Raises:
            KeyError: an array is missing.
            ValueError: indices are out of range.
        """
        named = {field.name: arrays[field.name] for field in dataclasses.fields(cls)}
        for name, convert in (("joints", int), ("size", float), ("order", int)):
            named[name] = convert(named[name][0])
        made = cls(**named)
        check_order(made.order)
        bounds = {
            "skin_joint": made.joints, "sphere_joint": made.joints, "patch_joint": made.joints,
            "own_joint": made.joints, "cluster": len(made.own_joint),
            "near_spheres": len(made.sphere_joint), "near_patches": len(made.patch_joint),
        }  # fmt: skip
        for name, bound in bounds.items():
            values = getattr(made, name)
            if values.size and not (values.min() >= 0 and values.max() < bound):
                raise ValueError(f"{name} points outside its table")
        return made


def blended(carry: FloatArray, joint: IntArray, weight: FloatArray) -> FloatArray:
    """Matrices (N, 3, 4) of points carried by joints (N, W) with weights (N, W)."""
    total = carry[joint[:, 0]] * weight[:, 0, None, None]
    for slot in range(1, joint.shape[1]):
        total += carry[joint[:, slot]] * weight[:, slot, None, None]
    return total


def apart(places: FloatArray, near: IntArray, position: FloatArray) -> list[FloatArray]:
    """x, y and z from receivers (N, 3) to places (S, 3) ``near`` them (N, K), (N, K) float32."""
    # Differences in double precision: places may be far from joint 0 and close to each other.
    columns = zip(np.ascontiguousarray(places.T), position.T, strict=True)
    return [(place[near] - here[:, None]).astype(np.float32) for place, here in columns]


def turned(steps: Sequence[FloatArray], axes: FloatArray) -> list[FloatArray]:
    """Components (N, K) in the frames (N, 3, 3) whose columns are the axes."""
    kept = axes.astype(np.float32)
    x, y, z = steps
    return [
        kept[:, 0, axis, None] * x + kept[:, 1, axis, None] * y + kept[:, 2, axis, None] * z
        for axis in range(3)
    ]


def cofactors(linear: FloatArray) -> FloatArray:
    """Cofactor matrices (..., 3, 3): they carry vector areas where ``linear`` carries points."""
    a, b, c = (linear[..., column] for column in range(3))
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)


def unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors (..., 3); a vanishing one stays (nearly) zero."""
    square = np.sum(vectors * vectors, axis=-1, keepdims=True)
    return vectors / np.sqrt(np.maximum(square, SMALLEST))
