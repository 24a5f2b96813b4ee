"""Meshes that fields of local transfer are shown on, and how their frames go along.

A patch is laid on by places, in widths and heights of it: on a plane, a vase, or any mesh, which is
divided by the sides of a box that its triangles face. When the mesh moves, tangents go where the
surface takes them ("LDPRT", Sloan, Luna and Snyder 2005, section 5, step 1).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse

from prtnet.arrays import FloatArray, IntArray
from prtnet.frames import deformation_operator, orthonormal_frames
from prtnet.scene import face_normals, unit

__all__ = ["Canvas", "boxed", "plane", "vase"]

GRID = 48  # squares of a plane, a side
AROUND, UP = 96, 96  # squares of a vase
BULGE = 0.35  # of a vase's radius


@dataclass(frozen=True, eq=False)
class Canvas:
    """A mesh, and the frames that a field has there.

    Attributes:
        positions: of vertices, (V, 3) world space.
        tangents: where the x axis of the field points, (V, 3), any length.
        normals: unit, (V, 3).
        faces: (T, 3), counter-clockwise from outside.
        places: of vertices on a patch, in widths and heights of it, (V, 2); None where vertices
            have transfer of their own.
    """

    positions: FloatArray
    tangents: FloatArray
    normals: FloatArray
    faces: IntArray
    places: FloatArray | None = None

    @property
    def frames(self) -> FloatArray:
        """Columns tangent, bitangent, normal of vertices, (V, 3, 3)."""
        return orthonormal_frames(self.tangents, self.normals)

    @cached_property
    def _carry(self) -> scipy.sparse.csr_array:
        """From positions to where triangles carry the tangents: made once for all that moves."""
        every = np.arange(len(self.positions))
        return deformation_operator(self.positions, self.faces, every, self.frames[..., 0])

    def moved(self, positions: FloatArray, normals: FloatArray) -> Canvas:
        """The same where its vertices have moved to, both (V, 3): triangles carry tangents.

        Triangles around a vertex are not quite in its plane: what that turns a tangent by at rest
        is taken back, so that frames go along with a turn of all, exactly.
        """
        rest, carry = self.frames, self._carry
        before, after = (
            orthonormal_frames(carry @ np.asarray(places, dtype=np.float64), upright)
            for places, upright in ((self.positions, self.normals), (positions, normals))
        )
        tangents = np.einsum("vij,vkj,vk->vi", after, before, rest[..., 0])
        return dataclasses.replace(self, positions=positions, tangents=tangents, normals=normals)

    def twisted(self, turns: float) -> Canvas:
        """The same twisted about the vertical through its middle.

        Args:
            turns: from its lowest to its highest point, radians; the middle stays as it is.
        """
        low, high = self.positions.min(axis=0), self.positions.max(axis=0)
        middle, height = (low + high) / 2.0, max(float(high[1] - low[1]), 1e-30)
        p = self.positions.astype(np.float64) - middle
        angle = turns * p[:, 1] / height
        c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros(len(p)), np.ones(len(p))
        rotation = np.array([[c, zero, s], [zero, one, zero], [-s, zero, c]]).transpose(2, 0, 1)
        moved = np.einsum("vij,vj->vi", rotation, p)
        slope = rotation.copy()  # the Jacobian: what is higher is turned further
        slope[:, 0, 1] = turns / height * moved[:, 2]
        slope[:, 2, 1] = -turns / height * moved[:, 0]
        tangents = np.einsum("vij,vj->vi", slope, self.tangents)
        normals = np.einsum("vji,vj->vi", np.linalg.inv(slope), self.normals)
        return dataclasses.replace(
            self, positions=moved + middle, tangents=tangents, normals=unit(normals)
        )


def plane(repeat: float, shape: float = 1.0) -> Canvas:
    """An upright square of side 1 that faces +z.

    Args:
        repeat: widths of the patch from left to right.
        shape: its height over its width.
    """
    u, v = grid(GRID, GRID)
    up = np.broadcast_to([0.0, 0.0, 1.0], (len(u), 3))
    right = np.broadcast_to([1.0, 0.0, 0.0], (len(u), 3))
    positions = np.stack([u - 0.5, v - 0.5, np.zeros(len(u))], axis=-1)
    places = np.stack([u * repeat, v * repeat / shape], axis=-1)
    return Canvas(positions, right, up, squares(GRID, GRID), places)


def vase(repeat: int, shape: float = 1.0) -> Canvas:
    """A vase of height 1: a curve turned about the vertical, without its mouth and foot.

    Args:
        repeat: widths of the patch around it: a whole number, so that they meet.
        shape: the patch's height over its width.
    """
    u, v = grid(AROUND, UP)
    phi, y = 2.0 * math.pi * u, v - 0.5
    swing = 2.0 * math.pi * 0.75
    radius = 0.22 * (1.0 + BULGE * np.cos(swing * (v - 0.35)))
    slope = -0.22 * BULGE * swing * np.sin(swing * (v - 0.35))
    out = np.stack([np.sin(phi), np.zeros(len(phi)), np.cos(phi)], axis=-1)
    tangents = np.stack([np.cos(phi), np.zeros(len(phi)), -np.sin(phi)], axis=-1)
    normals = unit(out - slope[:, None] * [0.0, 1.0, 0.0])
    positions = radius[:, None] * out + y[:, None] * [0.0, 1.0, 0.0]
    line = v[:: AROUND + 1]
    steps = np.hypot(np.diff(radius[:: AROUND + 1]), np.diff(line))
    along = np.concatenate([[0.0], np.cumsum(steps)])
    width = 2.0 * math.pi * float(radius.mean()) / repeat
    places = np.stack([u * repeat, np.repeat(along, AROUND + 1) / (width * shape)], axis=-1)
    return Canvas(positions, tangents, normals, squares(AROUND, UP), places)


def boxed(
    positions: FloatArray, normals: FloatArray, faces: IntArray, size: tuple[float, float]
) -> tuple[Canvas, IntArray]:
    """Any mesh with a patch laid on from the sides of a box: no texture coordinates are needed.

    Args:
        positions: (V, 3).
        normals: unit, (V, 3).
        faces: (T, 3); each belongs to the side that it faces most.
        size: width and height of the patch, in the mesh's units.

    Returns:
        The canvas, whose vertices are split where sides meet, and the vertex each was, (V',).
    """
    facing = face_normals(np.asarray(positions, dtype=np.float64)[None], faces)[0]
    axis = np.abs(facing).argmax(axis=1)
    sign = np.take_along_axis(facing, axis[:, None], axis=1)[:, 0] < 0
    side = 2 * axis + sign
    keys = side[:, None] * len(positions) + faces
    used, corners = np.unique(keys, return_inverse=True)
    own, source = np.divmod(used, len(positions))
    out = np.eye(3)[own // 2] * np.where(own % 2 == 1, -1.0, 1.0)[:, None]
    # y stays up on upright sides; on level ones x is to the right.
    tangents = np.where((own // 2 == 1)[:, None], [1.0, 0.0, 0.0], np.cross([0.0, 1.0, 0.0], out))
    upward = np.cross(out, tangents)
    at = np.asarray(positions)[source]
    places = np.stack([(at * tangents).sum(axis=1), (at * upward).sum(axis=1)], axis=-1) / size
    cut = corners.reshape(-1, 3).astype(np.int32)
    return Canvas(at, tangents, np.asarray(normals)[source], cut, places), source


def grid(columns: int, rows: int) -> tuple[FloatArray, FloatArray]:
    """Coordinates in [0, 1] of the corners of squares, row by row, (V,) each."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns + 1), np.linspace(0.0, 1.0, rows + 1))
    return u.ravel(), v.ravel()


def squares(columns: int, rows: int) -> IntArray:
    """Two triangles of every square of a grid, counter-clockwise where x × y points to us."""
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    a, b, c, d = first, first + 1, first + columns + 2, first + columns + 1
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
