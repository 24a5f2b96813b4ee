"""Rotation of spherical-harmonic vectors.

A rotation R takes f to f'(s) = f(R⁻¹ s), and its matrix M satisfies y(R s) = M y(s). Each band
keeps to itself: M is block diagonal with orthogonal blocks of 2l + 1 rows.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.array_library import Array, as_floating, constant_like, library
from prtnet.sh import evaluate, evaluate_reference, fibonacci_sphere, order_of

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray

__all__ = ["rotate", "rotation_matrix"]

# float32 frames that have been through a few products stay well inside.
ORTHOGONALITY_TOLERANCE = 1e-3


def rotation_matrix(rotation: Array, order: int) -> Array:
    """M with f'= M f the coefficients of f'(s) = f(R⁻¹ s), any order, batched.

    At a few fixed directions d_k, y(R d_k) = M y(d_k) determines M: evaluate and solve band by
    band with a pseudo-inverse made once.

    Args:
        rotation: R, (..., 3, 3), NumPy or torch (differentiable).
        order: number of bands n.

    Returns:
        (..., n², n²), same library and dtype as ``rotation``.

    Raises:
        ValueError: a matrix is not orthogonal, or is a reflection (determinant −1).
    """
    rotation, rotated = _rotated_samples(rotation, order)  # [..., K, n²]
    xp = library(rotation)
    shape = (*rotation.shape[:-2], order * order, order * order)
    result = xp.zeros(shape, dtype=rotation.dtype, device=rotation.device)
    for band, inverse in enumerate(_band_inverses(order)):
        part = slice(band * band, (band + 1) * (band + 1))
        # Y(R d) = Y(d) Mᵀ
        solved = constant_like(inverse, rotation) @ rotated[..., part]
        result[..., part, part] = xp.swapaxes(solved, -1, -2)
    return result


def rotate(coefficients: Array, rotation: Array) -> Array:
    """Coefficients of f(R⁻¹ s), (..., n²), without forming the matrices.

    Args:
        coefficients: f, (..., n²).
        rotation: R, (..., 3, 3); its leading axes broadcast with those of ``coefficients``.
    """
    coefficients = as_floating(coefficients)
    order = order_of(coefficients)
    rotation, rotated = _rotated_samples(rotation, order)
    xp = library(rotation)
    parts = []
    for band, inverse in enumerate(_band_inverses(order)):
        part = slice(band * band, (band + 1) * (band + 1))
        # M f = Y(R d)ᵀ (pinv(Y(d))ᵀ f): f as lobes along d_k, which R carries along.
        lobes = coefficients[..., part] @ constant_like(inverse, coefficients)
        parts.append((lobes[..., None, :] @ rotated[..., part])[..., 0, :])
    return xp.concatenate(parts, -1)


def _rotated_samples(rotation: Any, order: int) -> tuple[Any, Any]:
    rotation = _checked(rotation)
    directions = constant_like(_sample_directions(order), rotation)
    return rotation, evaluate(directions @ rotation.swapaxes(-1, -2), order)


def _checked(rotation: Any) -> Any:
    rotation = as_floating(rotation)
    if rotation.ndim < 2 or tuple(rotation.shape[-2:]) != (3, 3):
        raise ValueError(f"a rotation must have shape (..., 3, 3), not {tuple(rotation.shape)}")
    xp = library(rotation)
    first, second, third = (rotation[..., axis] for axis in range(3))
    # first × second = third with all three of unit length: orthogonal and right-handed.
    gram = rotation.swapaxes(-1, -2) @ rotation - constant_like(np.eye(3), rotation)
    if not bool((abs(gram) <= ORTHOGONALITY_TOLERANCE).all()):
        raise ValueError("not a rotation: its columns are not orthonormal")
    handed = (xp.linalg.cross(first, second) * third).sum(-1)
    if not bool((handed > 0).all()):
        raise ValueError("a reflection (determinant −1), not a rotation: flip one axis of it")
    return rotation


@lru_cache
def _sample_directions(order: int) -> FloatArray:
    """2n − 1 directions at which the highest band is well conditioned, (K, 3)."""
    from scipy.linalg import qr

    candidates = fibonacci_sphere(200 * order)
    highest = evaluate_reference(candidates, order)[:, (order - 1) ** 2 :]
    chosen = qr(highest.T, pivoting=True, mode="r")[1][: 2 * order - 1]
    return candidates[chosen]


@lru_cache
def _band_inverses(order: int) -> list[FloatArray]:
    """Pseudo-inverse (2l+1, K) of each band at the sample directions."""
    basis = evaluate_reference(_sample_directions(order), order)
    return [np.linalg.pinv(basis[:, band * band : (band + 1) ** 2]) for band in range(order)]
