"""Diffuse shading: visibility in local frames, and a light, to radiance at every vertex.

L = albedo/π ∫ light(s) V(s) max(n·s, 0) ds, in NumPy; the reference of what shaders do.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.operators import cosine_matrix
from prtnet.sh import order_of
from prtnet.sh_rotation import rotate

__all__ = ["Surface", "diffuse_radiance", "reflected_light", "world_transfer"]

BLOCK = 1 << 14  # vertices at a time: rotation needs some tens of numbers for each


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh as both renderers take it.

    Attributes:
        positions: vertices, (V, 3) metres in world space.
        faces: triangles, (T, 3), counter-clockwise from the front.
        transfer: world-space transfer vector of each vertex, (V, n²), as ``world_transfer``.
        back_transfer: of the back of each vertex, (V, n²); None for the same as the front.
    """

    positions: FloatArray
    faces: IntArray
    transfer: FloatArray
    back_transfer: FloatArray | None = None


def world_transfer(visibility: FloatArray, frames: FloatArray) -> FloatArray:
    """Coefficients of V(s)·max(n·s, 0) in the world frame.

    Args:
        visibility: in local frames, (V, n²).
        frames: orthonormal, columns (tangent, bitangent, normal), (V, 3, 3).

    Returns:
        (V, n²) float32. Its product with a light of the same order is the irradiance.
    """
    cosine = cosine_matrix(order_of(visibility))
    result = np.empty(visibility.shape, dtype=np.float32)
    for start in range(0, len(visibility), BLOCK):
        part = slice(start, start + BLOCK)
        local = np.asarray(visibility[part], dtype=np.float64) @ cosine  # symmetric
        result[part] = rotate(local, np.asarray(frames[part], dtype=np.float64))
    return result


def reflected_light(light: FloatArray, albedo: float | FloatArray = 1.0) -> FloatArray:
    """Light (n², 3) times the diffuse BRDF albedo/π; ``albedo`` is a number or linear RGB (3,)."""
    return np.asarray(light, dtype=np.float64) * (np.asarray(albedo) / math.pi)


def diffuse_radiance(
    visibility: FloatArray,
    frames: FloatArray,
    light: FloatArray,
    albedo: float | FloatArray = 1.0,
) -> FloatArray:
    """Outgoing radiance of diffuse vertices.

    Args:
        visibility: in local frames, (V, n²).
        frames: orthonormal, columns (tangent, bitangent, normal), (V, 3, 3).
        light: SH coefficients of the environment's radiance, (n², 3) linear RGB, world frame.
        albedo: a number or linear RGB (3,).

    Returns:
        (V, 3) float32 linear RGB. Order-limited light and visibility ring: it may be a little
        below zero.
    """
    radiance = world_transfer(visibility, frames) @ reflected_light(light, albedo)
    return np.asarray(radiance, dtype=np.float32)
