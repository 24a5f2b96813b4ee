"""Where shadow rays start: just off the surface, whatever the scale, and never behind it.

Rays that start on a surface hit it again by rounding, so origins are lifted off it by a small
length. Two things make that length safe:

- Scenes are traced in a unit cube (``data_gen.visibility.Tracer``), where 256 units in the last
  place, [1]'s distance, is one length for all coordinates. [1] itself counts them by coordinate,
  which also moves origins along the surface, by how much depends on where they are: on a robot of
  many hard edges the visibility of one pose, turned as a whole, then differed by 4 to 5 %; so
  lifted, by 0.05 %.
- A receiver on the border of its own faces (a hard edge splits it from its neighbours) also moves
  along the surface, inwards. A vertex where a floor meets a wall lies *in* the wall's plane: rays
  into the room would hit it or not by rounding, rays into the wall too. Without this, 1.6 %.

Both moves leave every convex mesh: (ε n + ε τ + t d)·n > 0 for every ray d above the horizon and
τ perpendicular to n, while all points p + x of the mesh have x·n ≤ 0. Convex meshes therefore
report no self-hits.

[1] Wächter, Binder. "A fast and robust method for avoiding self-intersection". Ray Tracing Gems,
    chapter 6, 2019.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from prtnet.arrays import FloatArray, IntArray
from prtnet.scene import Receivers

__all__ = ["LIFT", "border_operator", "departure"]

LIFT = 256 * 2.0**-23  # of the half size of a scene: 256 units in the last place of 1
BORDER_PULL = 0.5  # less than the normal's 1: own faces tilted by up to 63° stay below


def border_operator(faces: IntArray, receivers: Receivers) -> scipy.sparse.csr_array:
    """Matrix (V, V_render) from vertex positions to the inward direction of border receivers.

    The direction is the mean of own faces' centroids, minus the receiver; rows of receivers that
    their faces surround on all sides are empty.
    """
    fronts = int(np.count_nonzero(receivers.side > 0))
    corners = receivers.of_vertex[faces]  # [T, 3] receivers
    edges = np.sort(np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1), axis=-1)
    flat = edges.reshape(-1, 2).astype(np.int64)
    keys, uses = np.unique(flat[:, 0] * fronts + flat[:, 1], return_counts=True)
    border = np.zeros(fronts, dtype=bool)
    border[np.concatenate([keys[uses == 1] // fronts, keys[uses == 1] % fronts])] = True

    rows = np.repeat(corners.ravel(), 3)  # each corner sees its face's three vertices
    columns = np.repeat(faces, 3, axis=0).ravel()
    values = np.where(border[rows], 1.0 / 3.0, 0.0)
    shape = (fronts, len(receivers.of_vertex))
    sums = scipy.sparse.csr_array((values, (rows, columns)), shape=shape)
    faces_of = np.asarray(sums.sum(axis=1)).ravel()
    own = scipy.sparse.csr_array(
        (faces_of, (np.arange(fronts), receivers.vertex[:fronts])), shape=shape
    )
    scale = scipy.sparse.diags_array(1.0 / np.maximum(faces_of, 1.0))
    operator = scipy.sparse.csr_array(scale @ (sums - own))
    operator.eliminate_zeros()
    both = [operator] * (len(receivers) // fronts)
    return scipy.sparse.csr_array(scipy.sparse.vstack(both))


def departure(normals: FloatArray, inward: FloatArray) -> FloatArray:
    """Directions (V, 3) in which origins leave the surface: the normal, pulled inwards at borders.

    Args:
        normals: unit, (V, 3).
        inward: ``border_operator`` times the posed positions, (V, 3); zero away from borders.
    """
    along = inward - np.sum(inward * normals, axis=1, keepdims=True) * normals
    length = np.linalg.norm(along, axis=1, keepdims=True)
    size = np.linalg.norm(inward, axis=1, keepdims=True)
    # A direction that is nearly the normal itself is rounding, not a direction.
    usable = length > 1e-3 * size
    return normals + np.where(usable, BORDER_PULL * along / np.where(usable, length, 1.0), 0.0)
