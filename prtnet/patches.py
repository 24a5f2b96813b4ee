"""What each receiver of a deforming sheet sees of the surface around it, in its own frame.

Two views. *Control points*: vertices that lie at rest on rings around the receiver, where they are
now, in the receiver's frame; they say exactly how the surface near by is bent. *Patches*: the
surface cut into pieces, small ones near the receiver and large ones far away; one of vector area A
(half the sum of its faces' cross products) in direction u at distance d covers a cap with
sin² θ = |A·u| / (π d² + |A·u|), the solid angle of a small disc, and never more than a half-space.
The caps' spherical harmonics are summed, above the horizon only.

Visibility follows from these by a law that is the same at every receiver, in every pose, whatever
the sheet as a whole does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy.sparse

from prtnet import sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.limits import check_order
from prtnet.occluders import cap_integrals
from prtnet.scene import face_normals
from prtnet.surroundings import Surroundings, fade

__all__ = ["PatchSurroundings", "flipped"]

SMALLEST = 1e-20  # squared lengths below it are no direction; the sheet's size is one
BLOCK_PAIRS = 500_000  # of receivers and patches, at a time


@dataclass(frozen=True, eq=False)
class PatchSurroundings(Surroundings):
    """Flattened poses (P, D) of a point cache to features (P, V, F) float32 of its receivers.

    Features: x of all control points over the radius of their rings, then y, z; then the order²
    sums over patches. Lengths are in units of the sheet's size. Back receivers follow the front
    ones, in frames turned by half a turn about the tangent.

    Attributes:
        faces: triangles over render vertices, (T, 3).
        vertex: the render vertex of each front receiver, (R,).
        two_sided: whether back receivers follow.
        carry_vertex, carry_weight: the tangent of each front receiver as a weighted sum of vertex
            positions, (R, A); see ``prtnet.frames``.
        control: the control points of each front receiver, render vertices (R, M).
        radius: of the ring of each, (M,).
        patch: the patch of each render vertex at every level of detail, (levels, vertices); all
            levels count on from each other.
        area: of the surface at rest around each render vertex, (vertices,).
        near: the patches each front receiver looks at, (R, K); −1 for none.
        size: the length that is one.
        order: of the spherical harmonics, at most ``MOST_ORDER``.
    """

    kind: ClassVar[str] = "patches"
    MOST_ORDER: ClassVar[int] = 4  # what the ONNX graph has closed forms for
    faces: IntArray
    vertex: IntArray
    two_sided: bool
    carry_vertex: IntArray
    carry_weight: FloatArray
    control: IntArray
    radius: FloatArray
    patch: IntArray
    area: FloatArray
    near: IntArray
    size: float
    order: int

    @property
    def feature_count(self) -> int:
        """Number of features F."""
        return 3 * len(self.radius) + self.order**2

    @property
    def receiver_count(self) -> int:
        """Number of receivers V."""
        return len(self.vertex) * (2 if self.two_sided else 1)

    @cached_property
    def around(self) -> scipy.sparse.csr_array:
        """(R, T): ones where a face meets the vertex of a receiver."""
        return self._corners[self.vertex]

    @cached_property
    def carry(self) -> scipy.sparse.csr_array:
        """(R, vertices): from positions to carried tangents.

        Weights that are rounded when they are stored do not add up to zero; what is left of them
        is taken from the receiver's own vertex, so that the place of the sheet does not matter.
        """
        rows = np.repeat(np.arange(len(self.vertex)), 1 + self.carry_vertex.shape[1])
        weight = self.carry_weight.astype(np.float64)
        weight = np.concatenate([weight, -weight.sum(axis=1, keepdims=True)], axis=1)
        vertex = np.concatenate([self.carry_vertex, self.vertex[:, None]], axis=1)
        return scipy.sparse.csr_array(
            (weight.ravel(), (rows, vertex.ravel())),
            shape=(len(self.vertex), self.patch.shape[1]),
        )

    @cached_property
    def centring(self) -> scipy.sparse.csr_array:
        """(S, vertices): from positions to patches' centroids, by area at rest."""
        members = self._members.astype(np.float64).multiply(self.area.astype(np.float64)).tocsr()
        total = np.maximum(members.sum(axis=1), np.finfo(np.float64).tiny)
        return scipy.sparse.csr_array(members.multiply(1.0 / total[:, None]))

    @cached_property
    def facing(self) -> scipy.sparse.csr_array:
        """(S, T): from faces' cross products to patches' vector areas; a face has three corners."""
        return scipy.sparse.csr_array(self._members @ self._corners / 6.0)

    @cached_property
    def _members(self) -> scipy.sparse.csr_array:
        columns = np.tile(np.arange(self.patch.shape[1]), len(self.patch))
        ones = np.ones(self.patch.size)
        shape = (int(self.patch.max()) + 1, self.patch.shape[1])
        return scipy.sparse.csr_array((ones, (self.patch.ravel(), columns)), shape=shape)

    @cached_property
    def _corners(self) -> scipy.sparse.csr_array:
        columns = np.repeat(np.arange(len(self.faces)), 3)
        shape = (self.patch.shape[1], len(self.faces))
        return scipy.sparse.csr_array(
            (np.ones(self.faces.size), (self.faces.ravel(), columns)), shape=shape
        )

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Features (P, V, F) of flattened poses (P, D)."""
        count = max(1, BLOCK_PAIRS // max(1, self.near.size))
        out = np.empty((len(poses), self.receiver_count, self.feature_count), dtype=np.float32)
        for start in range(0, len(poses), count):
            out[start : start + count] = self._block(poses[start : start + count])
        return out

    def _block(self, poses: FloatArray) -> FloatArray:
        points = poses.astype(np.float64).reshape(len(poses), -1, 3)
        points = points / self.size
        crosses = face_normals(points, self.faces)
        axes = self.axes(points, crosses)  # [P, R, 3, 3]
        here = points[:, self.vertex, None]
        control = (points[:, self.control] - here) @ axes / self.radius[:, None]
        control = np.swapaxes(control, 2, 3)  # [P, R, 3, M]
        front, every = self.caps(points, crosses, axes)
        sides = [[control, front]]
        if self.two_sided:
            turn = np.array([[1.0], [-1.0], [-1.0]])
            sides.append([control * turn, (every - front) * flipped(self.order)])
        count = len(poses), len(self.vertex), -1
        return np.concatenate(
            [np.concatenate([c.reshape(count), f], axis=2) for c, f in sides], axis=1
        )

    def axes(self, points: FloatArray, crosses: FloatArray) -> FloatArray:
        """Frames of the front receivers, columns tangent, bitangent, normal, (P, R, 3, 3)."""
        normal = directions(applied(self.around, crosses))
        tangent = applied(self.carry, points)
        along = np.sum(tangent * normal, axis=-1, keepdims=True)
        tangent = directions(tangent - along * normal)
        return np.stack([tangent, np.cross(normal, tangent), normal], axis=-1)

    def caps(
        self, points: FloatArray, crosses: FloatArray, axes: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Sums (P, R, n²) of what patches cover above the horizon of the front, and of all."""
        away = applied(self.centring, points)[:, self.near] - points[:, self.vertex, None]
        distance2 = np.maximum(np.sum(away * away, axis=-1), SMALLEST)
        toward = away / np.sqrt(distance2)[..., None]  # [P, R, K, 3]
        areas = applied(self.facing, crosses)[:, self.near]
        seen = np.abs(np.sum(areas * toward, axis=-1)) * (self.near >= 0)
        sine2 = seen / (math.pi * distance2 + seen)
        local = toward @ axes
        above = fade(local[..., 2], sine2)
        integrals = 2.0 * math.pi * cap_integrals(np.sqrt(1.0 - sine2), self.order)
        covered = integrals[..., sh.bands(self.order)] * sh.evaluate(local, self.order)
        front = np.einsum("prk,prki->pri", above, covered)
        return front, covered.sum(axis=2)

    def arrays(self) -> dict[str, Any]:
        """The arrays that define it, for a model file."""
        return {f.name: np.atleast_1d(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, Any]) -> PatchSurroundings:
        """The inverse of :meth:`arrays`.

        Raises:
            KeyError: an array is missing.
            ValueError: indices are out of range.
        """
        named = {f.name: arrays[f.name] for f in fields(cls)}
        for name, convert in (("two_sided", bool), ("size", float), ("order", int)):
            named[name] = convert(named[name][0])
        made = cls(**named)
        check_order(made.order)
        vertices, patches = made.patch.shape[1], int(made.patch.max()) + 1
        if patches > made.patch.size:
            raise ValueError("patch counts more patches than vertices")
        bounds = {
            "faces": vertices, "vertex": vertices, "carry_vertex": vertices, "control": vertices,
            "patch": patches, "near": patches,
        }  # fmt: skip
        for name, bound in bounds.items():
            lowest = -1 if name == "near" else 0
            if getattr(made, name).min() < lowest or getattr(made, name).max() >= bound:
                raise ValueError(f"{name} points outside its table")
        return made


def applied(matrix: scipy.sparse.csr_array, values: FloatArray) -> FloatArray:
    """A sparse matrix (M, N) times vectors (P, N, 3): (P, M, 3)."""
    count = len(values)
    columns = values.transpose(1, 0, 2).reshape(matrix.shape[1], -1)
    return np.ascontiguousarray((matrix @ columns).reshape(-1, count, 3).transpose(1, 0, 2))


def directions(vectors: FloatArray) -> FloatArray:
    """Unit vectors (..., 3); a vanishing one stays (nearly) zero."""
    square = np.sum(vectors * vectors, axis=-1, keepdims=True)
    return vectors / np.sqrt(np.maximum(square, SMALLEST))


def flipped(order: int) -> FloatArray:
    """The signs (order²,) that half a turn about x gives the spherical harmonics.

    (x, −y, −z) has the azimuth −φ and the polar cosine −c: P_l^m(−c) = (−1)^(l+m) P_l^m(c), and
    the sine of negative m changes its sign.
    """
    signs = [
        (-1.0) ** (degree + abs(m)) * (-1.0 if m < 0 else 1.0)
        for degree in range(order)
        for m in range(-degree, degree + 1)
    ]
    return np.array(signs)
