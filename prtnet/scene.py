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

BLOCK_VERTICES = 2**14  # posed at once: what stays in the cache is four times as fast

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
    """Unit vectors (..., 3); those of no usable length become ``fallback``."""
    x, y, z = (np.abs(vectors[..., axis]) for axis in range(3))
    largest = np.maximum(np.maximum(x, y), z)[..., None]
    good = (largest > 0) & np.isfinite(largest)
    # First to a size whose square neither under- nor overflows, then to length one.
    scaled = np.where(good, vectors / np.where(good, largest, 1.0), np.asarray(fallback))
    length = np.sqrt(np.einsum("...i,...i->...", scaled, scaled))
    return (scaled / length[..., None]).astype(vectors.dtype, copy=False)


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
    def blended(
        self, clips: tuple[Clip, Clip], times: tuple[FloatArray, FloatArray], share: FloatArray
    ) -> FloatArray:
        """Flattened poses (P, D) float32 on the way from one clip to another.

        Joints turn about their parents and keep their lengths; vertices of caches go straight.

        Args:
            clips: from, to.
            times: in either, seconds, (P,) each.
            share: of the second, 0 to 1, (P,).
        """

    def geometry(self, poses: FloatArray) -> Geometry:
        """Posed render vertices of flattened poses (P, D).

        Raises:
            PrtnetError: a vertex does not end at a finite place.
        """
        positions = np.empty((len(poses), self.vertex_count, 3), dtype=np.float32)
        normals = np.empty_like(positions)
        block = max(1, BLOCK_VERTICES // self.vertex_count)
        with np.errstate(over="ignore", invalid="ignore"):
            for start in range(0, len(poses), block):
                part = slice(start, start + block)
                positions[part], normals[part] = self._posed(poses[part])
        self._require_finite(positions)
        return Geometry(positions, normals)

    @abstractmethod
    def _posed(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions and unit normals (P, V, 3) of a block of flattened poses."""

    def _require_finite(self, values: FloatArray) -> None:
        if not np.isfinite(values).all():
            message = "its transforms overflow; check the scales of its nodes and its units"
            raise PrtnetError(self.path or self.name, message)

    @abstractmethod
    def _identity(self) -> tuple[FloatArray | IntArray, ...]:
        """What decides, besides the faces, whether a model of one scene fits another."""

    @abstractmethod
    def _vertex_keys(self) -> tuple[FloatArray, ...]:
        """Arrays (V, …) that are equal for two vertices only where their motion is equal."""

    @abstractmethod
    def rest(self) -> Geometry:
        """The mesh at rest, P = 1: the bind pose, or the first frame of a cache."""

    @cached_property
    def mesh_sha256(self) -> str:
        """Fingerprint of the mesh and of how poses move it: equal where one model fits both."""
        digest = hashlib.sha256()
        for array in (self.faces, *self._identity()):
            digest.update(str(array.shape).encode())
            digest.update((np.asarray(array, dtype=np.float32) + 0.0).tobytes())  # no -0.0
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

    def blended(
        self, clips: tuple[Clip, Clip], times: tuple[FloatArray, FloatArray], share: FloatArray
    ) -> FloatArray:
        one, other = map(self.rig.sample, clips, times)
        return self.flatten(one.blended(other, share))

    def flatten(self, local: LocalPose) -> FloatArray:
        """Flattened poses (P, 12·J + M) float32 of local transforms."""
        with np.errstate(over="ignore", invalid="ignore"):
            matrices = self.rig.model_matrices(local)[:, self.joint_nodes, :3]
            flat = np.concatenate([matrices.reshape(len(local), -1), local.weights], axis=1)
            poses = flat.astype(np.float32)
        self._require_finite(poses)
        return poses

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
        blended = self.weights @ columns
        return blended.reshape(-1, len(poses), 3, 4).transpose(1, 0, 2, 3)

    def _posed(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        matrices = self.vertex_matrices(poses)
        linear, offset = matrices[..., :3], matrices[..., 3]
        morph = poses[:, 12 * self.joint_count :].astype(np.float64)
        bind = np.asarray(self.positions, dtype=np.float64)
        points = bind + np.tensordot(morph, self.morph_positions, axes=1)  # [P, V, 3]
        positions = np.einsum("pvij,pvj->pvi", linear, points) + offset
        if self.normals is None:
            return positions, self._flat_normals(positions, linear)
        rest = np.asarray(self.normals, dtype=np.float64)
        rest = rest + np.tensordot(morph, self.morph_normals, axes=1)
        return positions, unit(transformed_normals(linear, rest))

    def _flat_normals(self, positions: FloatArray, linear: FloatArray) -> FloatArray:
        """The faces' normals (P, V, 3); faces that a pose mirrors stay outward."""
        corner = self.faces[:, 0]
        turned = np.linalg.det(linear[:, corner]) * self._rest_determinants < 0  # [P, T]
        flat = unit(face_normals(positions, self.faces))
        normals = np.zeros_like(positions)
        normals[..., 1] = 1.0
        normals[:, self.faces] = np.where(turned[..., None], -flat, flat)[:, :, None]
        return normals

    @cached_property
    def _rest_determinants(self) -> FloatArray:
        """Determinant of each face's transform at rest, where faces are outward, (T,)."""
        linear = self.vertex_matrices(self.rest_pose())[0, self.faces[:, 0], :, :3]
        return np.linalg.det(linear)

    def rest_pose(self) -> FloatArray:
        """The flattened pose (1, D) that the file gives its nodes and morph weights."""
        return self.flatten(self.rig.rest())

    def rest(self) -> Geometry:
        return self.geometry(self.rest_pose())

    def _vertex_keys(self) -> tuple[FloatArray, ...]:
        if self.normals is None:  # flat: the face's plane is part of what a receiver is
            corner = np.zeros((self.vertex_count, 1), dtype=np.float32)
            corner[self.faces.ravel(), 0] = np.repeat(np.arange(len(self.faces)), 3)
            shade: FloatArray = corner
        else:
            shade = self.normals
        morphs = (np.moveaxis(m, 0, 1) for m in (self.morph_positions, self.morph_normals))
        return (self.positions, shade, *influences(self.weights), *morphs)

    def _identity(self) -> tuple[FloatArray | IntArray, ...]:
        return (*self._vertex_keys(), self.bone_joint, self.bone_inverse_bind)


def influences(weights: scipy.sparse.csr_array) -> tuple[FloatArray, FloatArray]:
    """Columns and values (V, K) of each row, by column and filled up with zeros."""
    rows = weights.copy()
    rows.sum_duplicates()
    rows.eliminate_zeros()
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    slot = np.arange(rows.nnz) - rows.indptr[row]
    columns, values = np.zeros((2, rows.shape[0], int(slot.max(initial=0)) + 1))
    columns[row, slot], values[row, slot] = rows.indices, rows.data
    return columns, values


def transformed_normals(linear: FloatArray, normals: FloatArray) -> FloatArray:
    """Normals (..., 3) where ``linear`` (..., 3, 3) carries points, up to a positive factor.

    The cofactor matrix is det · inverse-transpose: it exists for singular matrices too, and the
    sign of the determinant keeps normals outward under mirroring.
    """
    a, b, c = (tuple(linear[..., row, column] for row in range(3)) for column in range(3))
    cofactors = cross(b, c), cross(c, a), cross(a, b)
    determinant = sum(p * q for p, q in zip(a, cofactors[0], strict=True))
    turned = np.empty(linear.shape[:-1])
    for row in range(3):
        terms = (cofactors[column][row] * normals[..., column] for column in range(3))
        turned[..., row] = np.where(determinant < 0, -1.0, 1.0) * sum(terms)
    return turned


def cross(a: tuple[FloatArray, ...], b: tuple[FloatArray, ...]) -> tuple[FloatArray, ...]:
    """Cross product by components, several times as fast as ``np.cross`` on short last axes."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


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

    def blended(
        self, clips: tuple[Clip, Clip], times: tuple[FloatArray, FloatArray], share: FloatArray
    ) -> FloatArray:
        one, other = map(self.poses, clips, times)
        part = share[:, None]
        return ((1 - part) * one + part * other).astype(np.float32)

    def _posed(self, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
        positions = np.asarray(poses, dtype=np.float32).reshape(len(poses), -1, 3)
        flat = face_normals(positions.astype(np.float64), self.faces)  # [P, T, 3]
        face = np.repeat(np.arange(len(self.faces)), 3)
        corner = scipy.sparse.csr_array(
            (np.ones(self.faces.size), (self.faces.ravel(), face)),
            shape=(self.vertex_count, len(self.faces)),
        )
        summed = corner @ flat.transpose(1, 0, 2).reshape(len(self.faces), -1)
        normals = summed.reshape(self.vertex_count, len(poses), 3).transpose(1, 0, 2)
        return positions, unit(normals)

    def rest(self) -> Geometry:
        return self.geometry(self.frames[:1].reshape(1, -1))

    def _vertex_keys(self) -> tuple[FloatArray, ...]:
        # Normals come from the faces around a vertex: two that move together in a sheet that
        # starts flat have equal normals at first and other ones when it bends.
        normals = self.geometry(self.frames.reshape(len(self.frames), -1)).normals
        return (np.moveaxis(self.frames, 0, 1), np.moveaxis(normals, 0, 1))

    def _identity(self) -> tuple[FloatArray | IntArray, ...]:
        # Another run of the same simulation starts elsewhere and is still the same mesh.
        return (np.array([self.vertex_count]),)
