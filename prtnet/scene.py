"""Animated scenes, whatever file they come from: poses in, posed geometry and receivers out.

A *pose* is what an engine has at hand at run time, flattened to a vector: for skinned scenes the
joints' model-space matrices (J, 3, 4) and then the morph weights; for point caches the vertex
positions (V, 3). A *receiver* is a unique vertex: split vertices at hard edges are separate
receivers, exact duplicates are one. Two-sided scenes have a front and a back receiver for each.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy.sparse

from prtnet.animation import Clip, LocalPose, Rig
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError, nearest_name

__all__ = ["Geometry", "PointCacheScene", "Receivers", "Scene", "SkinnedScene"]


@dataclass(frozen=True, eq=False)
class Geometry:
    """Posed vertices, float32, in model space."""

    positions: FloatArray  # [P, V, 3] metres
    normals: FloatArray  # [P, V, 3] unit


@dataclass(frozen=True, eq=False)
class Receivers:
    """Where visibility is wanted.

    Attributes:
        vertex: the render vertex each receiver stands for, (V,).
        side: +1 for the front of the surface, -1 for its back, (V,) int8.
        of_vertex: the front receiver of each render vertex, (V_render,).
    """

    vertex: IntArray
    side: IntArray
    of_vertex: IntArray

    def __len__(self) -> int:
        return len(self.vertex)

    def gather(self, geometry: Geometry) -> Geometry:
        """The receivers' positions and outward normals, (P, V, 3) each."""
        normals = geometry.normals[:, self.vertex] * self.side[:, None].astype(np.float32)
        return Geometry(geometry.positions[:, self.vertex], normals)


def unique_rows(*columns: FloatArray) -> tuple[IntArray, IntArray]:
    """First index of every distinct row, in order of appearance, and the row each input maps to."""
    table = np.ascontiguousarray(
        np.concatenate([np.asarray(c, dtype=np.float32).reshape(len(c), -1) for c in columns], 1)
    )
    table = table + 0.0  # -0.0 and 0.0 are the same place
    keys = table.view(np.dtype((np.void, table.dtype.itemsize * table.shape[1]))).ravel()
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.ravel()]


def face_normals(positions: FloatArray, faces: IntArray) -> FloatArray:
    """Area-weighted face normals (..., T, 3): half their length is the triangle's area."""
    a, b, c = (positions[..., faces[:, k], :] for k in range(3))
    return np.cross(b - a, c - a)


def unit(vectors: FloatArray, fallback: Sequence[float] = (0.0, 1.0, 0.0)) -> FloatArray:
    """Unit vectors; those of no usable length become ``fallback``."""
    largest = np.max(np.abs(vectors), axis=-1, keepdims=True)
    good = (largest > 0) & np.isfinite(largest)
    scaled = vectors / np.where(good, largest, 1.0)  # so that squares neither under- nor overflow
    length = np.linalg.norm(scaled, axis=-1, keepdims=True)
    return np.where(good, scaled / np.where(good, length, 1.0), np.asarray(fallback)).astype(
        vectors.dtype
    )


class Scene(ABC):
    """An animated mesh.

    Attributes:
        name: for messages and pictures.
        path: the file it came from; None when made by code.
        sha256: of that file, or of the arrays.
        faces: triangles over render vertices, (T, 3) int32, counter-clockwise from outside.
        clips: the animations.
    """

    name: str
    path: Path | None
    sha256: str
    faces: IntArray
    clips: tuple[Clip, ...]

    @property
    @abstractmethod
    def vertex_count(self) -> int:
        """Number of render vertices."""

    @property
    @abstractmethod
    def pose_size(self) -> int:
        """Length of a flattened pose."""

    @abstractmethod
    def poses(self, clip: Clip, times: FloatArray) -> FloatArray:
        """Flattened poses (P, D) float32 of a clip at ``times`` (P,) in seconds."""

    @abstractmethod
    def geometry(self, poses: FloatArray) -> Geometry:
        """Posed render vertices of flattened poses (P, D)."""

    @abstractmethod
    def _vertex_keys(self) -> tuple[FloatArray, ...]:
        """Arrays (V, …) that are equal for two vertices only where their motion is equal."""

    @abstractmethod
    def rest(self) -> Geometry:
        """The mesh at rest, P = 1: the bind pose, or the first frame of a cache."""

    @cached_property
    def mesh_sha256(self) -> str:
        """Fingerprint of what a model depends on: faces and everything that moves vertices."""
        digest = hashlib.sha256(np.ascontiguousarray(self.faces, dtype=np.int32).tobytes())
        for key in self._vertex_keys():
            digest.update(np.ascontiguousarray(key, dtype=np.float32).tobytes())
        return digest.hexdigest()

    def clip(self, name: str) -> Clip:
        """The clip of that name.

        Raises:
            PrtnetError: there is none; the nearest name is suggested.
        """
        for clip in self.clips:
            if clip.name == name:
                return clip
        known = nearest_name(name, [clip.name for clip in self.clips])
        raise PrtnetError(self.path or self.name, f"has no clip '{name}'; {known}")

    def receivers(self, two_sided: bool = False) -> Receivers:
        """The unique vertices used by faces, and their backs after them if ``two_sided``."""
        first, of_vertex = unique_rows(*self._vertex_keys())
        used = np.zeros(len(first), dtype=bool)
        used[of_vertex[self.faces.ravel()]] = True
        slot = np.cumsum(used) - 1
        vertex = first[used]
        # Vertices of no face have no receiver; receiver 0 stands in so that arrays stay aligned.
        of_vertex = np.where(used[of_vertex], slot[of_vertex], 0).astype(np.int32)
        side = np.ones(len(vertex), dtype=np.int8)
        if two_sided:
            vertex, side = np.tile(vertex, 2), np.concatenate([side, -side])
        return Receivers(vertex.astype(np.int32), side, of_vertex)


@dataclass(frozen=True, eq=False)
class SkinnedScene(Scene):
    """A mesh driven by joints and morph targets.

    A mesh without a skin hangs on its node as on a joint. A *bone* is a joint together with the
    inverse bind matrix of one skin: skins that share joints do not always share those.

    Attributes:
        rig: the node hierarchy.
        joint_nodes: node of every joint, (J,); the order of joints in a pose.
        bone_joint, bone_inverse_bind: joint index (B,) and matrix (B, 3, 4) of every bone.
        weights: skin weights, sparse (V, B), rows sum to one.
        positions, normals: vertices in bind space, (V, 3); ``normals`` is None for flat shading,
            and then no vertex is shared between faces.
        morph_positions, morph_normals: offsets of each morph target, (M, V, 3), in bind space.
    """

    name: str
    path: Path | None
    sha256: str
    faces: IntArray
    clips: tuple[Clip, ...]
    rig: Rig
    joint_nodes: IntArray
    bone_joint: IntArray
    bone_inverse_bind: FloatArray
    weights: scipy.sparse.csr_array
    positions: FloatArray
    normals: FloatArray | None
    morph_positions: FloatArray
    morph_normals: FloatArray

    @property
    def vertex_count(self) -> int:
        return len(self.positions)

    @property
    def joint_count(self) -> int:
        """Number of joints J."""
        return len(self.joint_nodes)

    @property
    def morph_count(self) -> int:
        """Number of morph targets M over all meshes."""
        return len(self.morph_positions)

    @property
    def pose_size(self) -> int:
        return 12 * self.joint_count + self.morph_count

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, in pose order."""
        return tuple(self.rig.names[node] for node in self.joint_nodes)

    @cached_property
    def joint_parents(self) -> IntArray:
        """Joint index of each joint's nearest ancestor that is a joint, -1 where none is, (J,)."""
        joint_of_node = {int(node): joint for joint, node in enumerate(self.joint_nodes)}
        parents = np.full(self.joint_count, -1, dtype=np.int32)
        for joint, node in enumerate(self.joint_nodes):
            ancestor = int(self.rig.parents[node])
            while ancestor >= 0 and ancestor not in joint_of_node:
                ancestor = int(self.rig.parents[ancestor])
            parents[joint] = joint_of_node.get(ancestor, -1)
        return parents

    @cached_property
    def joint_weights(self) -> FloatArray:
        """Dense skin weights by joint, (V, J) float32."""
        gather = np.zeros((len(self.bone_joint), self.joint_count), dtype=np.float32)
        gather[np.arange(len(self.bone_joint)), self.bone_joint] = 1.0
        return np.asarray(self.weights @ gather, dtype=np.float32)

    def poses(self, clip: Clip, times: FloatArray) -> FloatArray:
        return self.flatten(self.rig.sample(clip, times))

    def flatten(self, local: LocalPose) -> FloatArray:
        """Flattened poses (P, 12·J + M) float32 of local transforms."""
        matrices = self.rig.model_matrices(local)[:, self.joint_nodes, :3]
        flat = [matrices.reshape(len(local), -1), local.weights]
        return np.concatenate(flat, axis=1).astype(np.float32)

    def joint_matrices(self, poses: FloatArray) -> FloatArray:
        """Model-space joint matrices (P, J, 3, 4) of flattened poses."""
        return poses[:, : 12 * self.joint_count].reshape(-1, self.joint_count, 3, 4)

    def vertex_matrices(self, poses: FloatArray) -> FloatArray:
        """Blended matrices (P, V, 3, 4) float64 from bind space to model space."""
        joints = np.zeros((len(poses), self.joint_count, 4, 4))
        joints[..., :3, :] = self.joint_matrices(poses)
        joints[..., 3, 3] = 1.0
        bind = np.zeros((len(self.bone_joint), 4, 4))
        bind[:, :3], bind[:, 3, 3] = self.bone_inverse_bind, 1.0
        bones = (joints[:, self.bone_joint] @ bind)[..., :3, :]  # [P, B, 3, 4]
        columns = bones.transpose(1, 0, 2, 3).reshape(len(self.bone_joint), -1)
        blended = np.asarray(self.weights @ columns)
        return blended.reshape(-1, len(poses), 3, 4).transpose(1, 0, 2, 3)

    def geometry(self, poses: FloatArray) -> Geometry:
        matrices = self.vertex_matrices(poses)
        linear, offset = matrices[..., :3], matrices[..., 3]
        morph = poses[:, 12 * self.joint_count :].astype(np.float64)
        bind = np.asarray(self.positions, dtype=np.float64)
        points = bind + np.tensordot(morph, self.morph_positions, axes=1)  # [P, V, 3]
        positions = (linear @ points[..., None])[..., 0] + offset
        if self.normals is None:
            flat = unit(face_normals(positions, self.faces))
            normals = np.zeros_like(positions)
            normals[..., 1] = 1.0
            normals[:, self.faces] = flat[:, :, None]
        else:
            rest = np.asarray(self.normals, dtype=np.float64)
            rest = rest + np.tensordot(morph, self.morph_normals, axes=1)
            normals = unit((normal_matrices(linear) @ rest[..., None])[..., 0])
        return Geometry(positions.astype(np.float32), normals.astype(np.float32))

    def rest_pose(self) -> FloatArray:
        """The flattened pose (1, D) that the file gives its nodes and morph weights."""
        rig = self.rig
        rest = (rig.translation, rig.rotation, rig.scale, rig.weights)
        return self.flatten(LocalPose(*(np.asarray(array)[None] for array in rest)))

    def rest(self) -> Geometry:
        return self.geometry(self.rest_pose())

    def _vertex_keys(self) -> tuple[FloatArray, ...]:
        weights = self.weights.toarray()
        if self.normals is None:  # flat: the face's plane is part of what a receiver is
            corner = np.zeros((self.vertex_count, 1), dtype=np.float32)
            corner[self.faces.ravel(), 0] = np.repeat(np.arange(len(self.faces)), 3)
            shade: FloatArray = corner
        else:
            shade = self.normals
        morphs = (np.moveaxis(m, 0, 1) for m in (self.morph_positions, self.morph_normals))
        return (self.positions, shade, weights, *morphs)


def normal_matrices(linear: FloatArray) -> FloatArray:
    """Matrices (..., 3, 3) that carry normals where ``linear`` carries points, up to scale.

    The cofactor matrix is det · inverse-transpose: it exists for singular matrices too, and the
    sign of the determinant keeps normals outward under mirroring.
    """
    a, b, c = linear[..., 0], linear[..., 1], linear[..., 2]
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    sign = np.sign(np.sum(a * cofactor[..., 0], axis=-1))
    return cofactor * np.where(sign == 0, 1.0, sign)[..., None, None]


@dataclass(frozen=True, eq=False)
class PointCacheScene(Scene):
    """A mesh given as its vertices in every frame.

    Attributes:
        frames: vertex positions, (F, V, 3) float32.
        fps: frames a second.
    """

    name: str
    path: Path | None
    sha256: str
    faces: IntArray
    clips: tuple[Clip, ...]
    frames: FloatArray
    fps: float

    @property
    def vertex_count(self) -> int:
        return int(self.frames.shape[1])

    @property
    def pose_size(self) -> int:
        return 3 * self.vertex_count

    def poses(self, clip: Clip, times: FloatArray) -> FloatArray:
        held = np.clip(times, clip.start, clip.end)
        frame = np.clip(held * self.fps, 0, len(self.frames) - 1)
        left = np.floor(frame + 1e-6).astype(int)
        u = np.maximum(frame - left, 0.0)[:, None, None].astype(np.float32)
        right = np.minimum(left + 1, len(self.frames) - 1)
        blended = np.where(
            u > 0, (1 - u) * self.frames[left] + u * self.frames[right], self.frames[left]
        )
        return blended.reshape(len(frame), -1).astype(np.float32)

    def geometry(self, poses: FloatArray) -> Geometry:
        positions = np.asarray(poses, dtype=np.float32).reshape(len(poses), -1, 3)
        flat = face_normals(positions.astype(np.float64), self.faces)  # [P, T, 3]
        face = np.repeat(np.arange(len(self.faces)), 3)
        corner = scipy.sparse.csr_array(
            (np.ones(self.faces.size), (self.faces.ravel(), face)),
            shape=(self.vertex_count, len(self.faces)),
        )
        summed = corner @ flat.transpose(1, 0, 2).reshape(len(self.faces), -1)
        normals = summed.reshape(self.vertex_count, len(poses), 3).transpose(1, 0, 2)
        return Geometry(positions, unit(normals).astype(np.float32))

    def rest(self) -> Geometry:
        return self.geometry(self.frames[:1].reshape(1, -1))

    def _vertex_keys(self) -> tuple[FloatArray, ...]:
        # A vertex is welded only with one of equal motion *and* equal normal: the normals come
        # from the faces around it, so its own index belongs to the key where faces differ.
        rest = self.rest().normals[0]
        return (np.moveaxis(self.frames, 0, 1), rest)
