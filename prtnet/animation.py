"""Keyframed hierarchies: channels, clips and the rig that turns local poses into model space.

Quaternions are (x, y, z, w) as in glTF [1]; interpolation is that of [1], appendix C.

[1] glTF 2.0 specification, Khronos Group.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["Channel", "Clip", "LocalPose", "Rig", "quaternion_to_matrix", "slerp"]

FLOAT32_ROUNDING = 2.0**-23

Path = Literal["translation", "rotation", "scale", "weights"]
Interpolation = Literal["LINEAR", "STEP", "CUBICSPLINE"]


def normalised(quaternion: FloatArray) -> FloatArray:
    """Unit quaternions (..., 4); a zero quaternion becomes the identity."""
    norm = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    identity = np.array([0.0, 0.0, 0.0, 1.0])
    return np.where(norm > 1e-12, quaternion / np.maximum(norm, 1e-12), identity)


def slerp(a: FloatArray, b: FloatArray, t: FloatArray) -> FloatArray:
    """Spherical interpolation of unit quaternions (..., 4), the short way round; ``t`` is (...)."""
    dot = np.sum(a * b, axis=-1, keepdims=True)
    b = np.where(dot < 0, -b, b)
    dot = np.minimum(np.abs(dot), 1.0)
    angle = np.arccos(dot)
    sine = np.sin(angle)
    t = np.asarray(t)[..., None]
    near = sine < 1e-6  # the limit is linear interpolation
    safe = np.where(near, 1.0, sine)
    weight_a = np.where(near, 1.0 - t, np.sin((1.0 - t) * angle) / safe)
    weight_b = np.where(near, t, np.sin(t * angle) / safe)
    return normalised(weight_a * a + weight_b * b)


def quaternion_to_matrix(q: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    x, y, z, w = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


@dataclass(frozen=True, eq=False)
class Channel:
    """One animated property of one node.

    Attributes:
        node: index into the rig's nodes.
        path: which property.
        times: key times in seconds, increasing, (K,); of equal times the last counts from there on.
        values: (K, D), or (K, 3, D) in-tangent, value, out-tangent for CUBICSPLINE.
        interpolation: how to go from key to key; the ends hold their value.
    """

    node: int
    path: Path
    times: FloatArray
    values: FloatArray
    interpolation: Interpolation = "LINEAR"

    def sample(self, times: FloatArray) -> FloatArray:
        """Values (P, D) at ``times`` (P,) in seconds."""
        keys = self.times
        t = np.clip(times, keys[0], keys[-1])
        # Files hold times as float32: what lies within its rounding of a key is at that key.
        reached = np.searchsorted(keys, t + FLOAT32_ROUNDING * np.abs(t), side="right")
        right = np.clip(reached, 1, max(len(keys) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(keys) - 1)
        span = keys[right] - keys[left]
        u = np.where(span > 0, (t - keys[left]) / np.where(span > 0, span, 1.0), 1.0)
        u = np.where(reached >= len(keys), 1.0, np.maximum(u, 0.0))
        if self.interpolation == "STEP":
            # ``u`` is 1 only at the last key.
            result = self.values[np.where(u >= 1.0, right, left)]
        elif self.interpolation == "CUBICSPLINE":
            result = self._hermite(left, right, u, span)
        elif self.path == "rotation":
            a, b = normalised(self.values[left]), normalised(self.values[right])
            return slerp(a, b, u)
        else:
            result = (1 - u)[:, None] * self.values[left] + u[:, None] * self.values[right]
        return normalised(result) if self.path == "rotation" else result

    def _hermite(
        self, left: IntArray, right: IntArray, u: FloatArray, span: FloatArray
    ) -> FloatArray:
        u, span = u[:, None], span[:, None]
        u2, u3 = u * u, u * u * u
        return (
            (2 * u3 - 3 * u2 + 1) * self.values[left, 1]
            + span * (u3 - 2 * u2 + u) * self.values[left, 2]
            + (-2 * u3 + 3 * u2) * self.values[right, 1]
            + span * (u3 - u2) * self.values[right, 0]
        )


@dataclass(frozen=True, eq=False)
class Clip:
    """A named animation from ``start`` to ``end`` seconds.

    Point caches have no channels: their clip only names the time range.
    """

    name: str
    start: float
    end: float
    channels: tuple[Channel, ...] = ()

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return self.end - self.start

    def later(self, time: float, seconds: float) -> float:
        """A time so many seconds on, around where the clip ends."""
        if self.duration <= 0.0:
            return time
        return self.start + (time - self.start + seconds) % self.duration

    def times(self, fps: float | None = None, count: int | None = None) -> FloatArray:
        """Sample times (P,) in seconds, by rate or by count, both ends included."""
        if count is None:
            count = max(1, round(self.duration * (fps if fps is not None else 30.0)) + 1)
        if count == 1:
            return np.array([self.start])
        return np.linspace(self.start, self.end, count)


@dataclass(frozen=True, eq=False)
class LocalPose:
    """A batch of poses as each node's transform relative to its parent, and morph weights."""

    translation: FloatArray  # [P, N, 3]
    rotation: FloatArray  # [P, N, 4] unit quaternions, (x, y, z, w)
    scale: FloatArray  # [P, N, 3]
    weights: FloatArray  # [P, M]

    def __len__(self) -> int:
        return len(self.translation)

    def blended(
        self, other: LocalPose, share: FloatArray, morph_share: FloatArray | None = None
    ) -> LocalPose:
        """On the way to other poses: rotations the short way round, all else in a straight line.

        Args:
            other: as many poses of the same rig.
            share: how far, 0 for this pose, 1 for the other, (P,) or one for each node, (P, N).
            morph_share: the same for morph weights, (P,); needed where ``share`` is (P, N).
        """
        each = share if share.ndim == 2 else share[:, None]
        morphs = (share if morph_share is None else morph_share)[:, None]
        part = np.broadcast_to(each, self.rotation.shape[:2])
        return LocalPose(
            (1 - part)[..., None] * self.translation + part[..., None] * other.translation,
            slerp(self.rotation, other.rotation, part),
            (1 - part)[..., None] * self.scale + part[..., None] * other.scale,
            (1 - morphs) * self.weights + morphs * other.weights,
        )


@dataclass(frozen=True, eq=False)
class Rig:
    """A node hierarchy at rest; parents come before their children.

    Attributes:
        names: node names, (N).
        parents: index of each node's parent, -1 for a root, (N,).
        translation, rotation, scale: rest transform relative to the parent, (N, 3|4|3).
        offset: a fixed matrix after the transform, (N, 4, 4): identity unless the file gave the
            node as a matrix, which may hold shear that no translation, rotation and scale can.
        weights: rest morph weights of all meshes one after the other, (M,).
        weights_of_node: the slice of ``weights`` that a node's ``weights`` channel drives.
    """

    names: tuple[str, ...]
    parents: IntArray
    translation: FloatArray
    rotation: FloatArray
    scale: FloatArray
    offset: FloatArray
    weights: FloatArray
    weights_of_node: dict[int, slice]

    def rest(self, count: int = 1) -> LocalPose:
        """The rest pose, ``count`` times."""
        arrays = (self.translation, self.rotation, self.scale, self.weights)
        return LocalPose(*(np.repeat(np.array(a, float)[None], count, axis=0) for a in arrays))

    def sample(self, clip: Clip, times: FloatArray) -> LocalPose:
        """The clip's local poses at ``times`` (P,); nodes it does not move stay at rest."""
        pose = self.rest(len(times))
        for channel in clip.channels:
            values = channel.sample(times)
            if channel.path == "weights":
                pose.weights[:, self.weights_of_node[channel.node]] = values
            else:
                getattr(pose, channel.path)[:, channel.node] = values
        return pose

    def local_matrices(self, pose: LocalPose) -> FloatArray:
        """Matrices (P, N, 4, 4) of all nodes relative to their parents, float64."""
        count, nodes = pose.translation.shape[:2]
        local = np.zeros((count, nodes, 4, 4))
        local[..., :3, :3] = quaternion_to_matrix(pose.rotation) * pose.scale[..., None, :]
        local[..., :3, 3] = pose.translation
        local[..., 3, 3] = 1.0
        return local @ self.offset

    def model_matrices(self, pose: LocalPose) -> FloatArray:
        """Model-space matrices (P, N, 4, 4) of all nodes, float64."""
        matrices = self.local_matrices(pose)
        for node, parent in enumerate(self.parents):
            if parent >= 0:
                matrices[:, node] = matrices[:, parent] @ matrices[:, node]
        return matrices
