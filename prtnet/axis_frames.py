"""Turns by the smallest angle from one direction to another, and frames about an axis.

Where many ways are the shortest, to the opposite direction, one of them is taken.
"""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.scene import unit

__all__ = ["any_tangent", "frame_about", "rolled"]


def frame_about(axis: FloatArray) -> FloatArray:
    """Rotations (..., 3, 3), float64, that take +z to unit vectors (..., 3) by the shortest way."""
    end = np.asarray(axis, dtype=np.float64)[..., None, :]
    return np.swapaxes(rolled(np.eye(3), np.array([0.0, 0.0, 1.0]), end), -1, -2)


def rolled(vectors: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Vectors (..., 3) after the smallest turn from unit vectors ``start`` to ``end``, (..., 3)."""
    across = np.cross(start, end)  # the axis, times the sine
    # Between almost opposite ones rounding takes it out of the plane beside the start.
    beside = across - np.sum(across * start, axis=-1, keepdims=True) * start
    axis = np.where(beside.any(axis=-1, keepdims=True), unit(beside), any_tangent(start))
    cosine = np.sum(start * end, axis=-1, keepdims=True)
    along = np.sum(axis * vectors, axis=-1, keepdims=True)
    return cosine * vectors + np.cross(across, vectors) + (1.0 - cosine) * along * axis


def any_tangent(normals: FloatArray) -> FloatArray:
    """Some unit vector perpendicular to each unit normal (..., 3)."""
    axis = np.zeros_like(normals)
    smallest = np.argmin(np.abs(normals), axis=-1)[..., None]
    np.put_along_axis(axis, smallest, 1.0, axis=-1)
    return unit(np.cross(normals, axis), (1.0, 0.0, 0.0))
