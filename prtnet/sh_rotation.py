"""Rotation of spherical-harmonic vectors.

A rotation R takes f to f'(s) = f(R⁻¹ s), and its matrix M satisfies y(R s) = M y(s). Each band
keeps to itself: M is block diagonal with orthogonal blocks of 2l + 1 rows.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable
from functools import lru_cache, reduce
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.array_library import Array, as_floating, constant_like, library
from prtnet.sh import evaluate, evaluate_reference, fibonacci_sphere, order_of

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray

__all__ = [
    "band_inverses",
    "checked_rotation",
    "rotate",
    "rotate_zxzxz",
    "rotation_matrix",
    "sample_directions",
    "zxzxz",
    "zxzxz_multiplications",
]

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
    turn: Any = checked_rotation(rotation)
    rotated = _rotated_samples(turn, order)  # [..., K, n²]
    xp = library(turn)
    shape = (*turn.shape[:-2], order * order, order * order)
    result = xp.zeros(shape, dtype=turn.dtype, device=turn.device)
    for band, inverse in enumerate(band_inverses(order)):
        part = slice(band * band, (band + 1) * (band + 1))
        # Y(R d) = Y(d) Mᵀ
        solved = constant_like(inverse, turn) @ rotated[..., part]
        result[..., part, part] = xp.swapaxes(solved, -1, -2)
    return result


def rotate(coefficients: Array, rotation: Array) -> Array:
    """Coefficients of f(R⁻¹ s), (..., n²), without forming the matrices.

    Args:
        coefficients: f, (..., n²).
        rotation: R, (..., 3, 3); its leading axes broadcast with those of ``coefficients``.
    """
    vector, turn = as_floating(coefficients), checked_rotation(rotation)
    order = order_of(vector)
    rotated = _rotated_samples(turn, order)
    parts = []
    for band, inverse in enumerate(band_inverses(order)):
        part = slice(band * band, (band + 1) * (band + 1))
        # M f = Y(R d)ᵀ (pinv(Y(d))ᵀ f): f as lobes along d_k, which R carries along.
        lobes = vector[..., part] @ constant_like(inverse, vector)
        parts.append((lobes[..., None, :] @ rotated[..., part])[..., 0, :])
    return library(turn).concatenate(parts, -1)


def rotate_zxzxz(coefficients: Array, rotation: Array) -> Array:
    """Coefficients of f(R⁻¹ s) by the zxzxz method of [1, section 3.4].

    R = Rz(α) Ry(β) Rz(γ) with Ry(β) = Rx(−90°) Rz(β) Rx(90°). A turn about z mixes only the pairs
    (l, ±m), by the angle m·α; a quarter turn about x is a constant, sparse matrix. The linear band
    is the axis (−f_11, −f_1−1, f_10), turned by R itself. ``zxzxz_multiplications`` counts them.
    Not differentiable where R keeps the z axis or turns it over; ``rotate`` is.

    Args:
        coefficients: f, (..., n²).
        rotation: R, (..., 3, 3); its leading axes broadcast with those of ``coefficients``.
    """
    vector: Any = as_floating(coefficients)
    turn: Any = checked_rotation(rotation)
    xp = library(turn)
    order = order_of(vector)
    entries = [[turn[..., row, column] for column in range(3)] for row in range(3)]
    shape = (*np.broadcast_shapes(vector.shape[:-1], turn.shape[:-2]), order * order)
    vector = xp.broadcast_to(vector, shape)
    rows = [vector[..., index] for index in range(order * order)]
    return xp.stack(zxzxz(rows, entries, _euler_zyz(entries), order), -1)


def zxzxz_multiplications(order: int) -> int:
    """Multiplications ``rotate_zxzxz`` makes for one vector, counted by running its arithmetic.

    The counts are those of the table in [1]: 53, 121, 217, 345, 509, 713, 961 for n = 3 … 9. They
    are reached with 9 for the linear band and, in every higher band l, 4 for each of the l pairs
    (l, ±m) in each of three turns about z; one for every entry of two quarter turns about x that
    the mirror symmetries allow, ±1 included (l² + l + 1 entries each); and 2 for each of three
    angles to get the cosine and sine of l times the angle from those of l − 1 and l − 2: in all
    2l² + 14l + 8. Band 8 has two entries that vanish by accident, (±6, ±2); skipping them too
    would make n = 9 cost 957. Additions, signs and the conversion to Euler angles do not count.
    """
    counter = [0]
    rows = [_Counted(counter) for _ in range(order * order)]
    entries = [[_Counted(counter) for _ in range(3)] for _ in range(3)]
    zxzxz(rows, entries, [(_Counted(counter), _Counted(counter)) for _ in range(3)], order)
    return counter[0]


class _Counted:
    """A number that is not there, which counts the multiplications it takes part in."""

    def __init__(self, counter: list[int]) -> None:
        self.counter = counter

    def __mul__(self, _: object) -> _Counted:
        self.counter[0] += 1
        return self

    __rmul__ = __mul__

    def __add__(self, _: object) -> _Counted:
        return self

    __radd__ = __sub__ = __rsub__ = __add__

    def __neg__(self) -> _Counted:
        return self


def zxzxz(rows: list[Any], entries: list[list[Any]], angles: list[Any], order: int) -> list[Any]:
    """``rotate_zxzxz`` on anything with arithmetic: what counts, or writes down, its steps.

    Args:
        rows: the n² coefficients.
        entries: R, row by row.
        angles: (cos, sin) of α, β, γ.
        order: bands n.

    Returns:
        The n² coefficients turned.
    """
    result = rows[:1]
    if order > 1:
        axis = (-rows[3], -rows[1], rows[2])
        x, y, z = (
            _total(entry * part for entry, part in zip(row, axis, strict=True)) for row in entries
        )
        result += [-y, z, -x]
    if order > 2:
        alpha, beta, gamma = (_multiples(cosine, sine, order) for cosine, sine in angles)
    for band in range(2, order):
        quarter = _quarter_turn(band)
        part = rows[band * band : (band + 1) * (band + 1)]
        part = _turn_sparse(_turn_z(part, gamma, band), quarter, 2 * band + 1)
        back = [(column, row, value) for row, column, value in quarter]
        part = _turn_sparse(_turn_z(part, beta, band), back, 2 * band + 1)
        result += _turn_z(part, alpha, band)
    return result


def _multiples(cosine: Any, sine: Any, order: int) -> tuple[list[Any], list[Any]]:
    """The cos mα and sin mα for 1 ≤ m < order (index m − 1), by Chebyshev's recurrence."""
    twice = cosine + cosine
    cosines, sines = [cosine, twice * cosine - 1.0], [sine, twice * sine]
    for _ in range(3, order):
        cosines.append(twice * cosines[-1] - cosines[-2])
        sines.append(twice * sines[-1] - sines[-2])
    return cosines, sines


def _turn_z(rows: list[Any], multiples: tuple[list[Any], list[Any]], band: int) -> list[Any]:
    """Turn one band about z: (f_m, f_−m) belong to cos mφ and sin mφ."""
    result = list(rows)
    for m, cosine, sine in zip(range(1, band + 1), *multiples, strict=False):
        even, odd = rows[band + m], rows[band - m]
        result[band + m] = cosine * even - sine * odd
        result[band - m] = sine * even + cosine * odd
    return result


def _turn_sparse(rows: list[Any], entries: list[tuple[int, int, float]], width: int) -> list[Any]:
    terms: list[list[Any]] = [[] for _ in range(width)]
    for row, column, value in entries:
        terms[row].append(value * rows[column])
    return [_total(part) for part in terms]


@lru_cache
def _quarter_turn(band: int) -> list[tuple[int, int, float]]:
    """The (row, column, value) of one band of the rotation by 90° about x, less its zeros.

    The turn takes y to z and z to −y, so it only joins functions alike under x → −x, the one's
    parity under y → −y being the other's under z → −z. (The third parity follows: their product
    is that of the band.)
    """
    quarter = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    matrix = rotation_matrix(quarter, band + 1)[band * band :, band * band :]
    m = np.arange(-band, band + 1)
    y_even, z_even = m >= 0, (band + m) % 2 == 0
    x_even = y_even == (m % 2 == 0)
    joined = (x_even[:, None] == x_even) & (z_even[:, None] == y_even)
    rows, columns = np.nonzero(joined)
    return [(int(i), int(j), float(matrix[i, j])) for i, j in zip(rows, columns, strict=True)]


def _total(terms: Iterable[Any]) -> Any:
    """The sum without the 0 that ``sum`` starts from."""
    return reduce(operator.add, terms)


def _euler_zyz(entries: list[list[Any]]) -> list[tuple[Any, Any]]:
    """(cos, sin) of α, β, γ with R = Rz(α) Ry(β) Rz(γ).

    γ is read from Rz(−α) R, so it makes up for whatever α came out as: near the poles, where the
    third column says nothing about α, their sum is still right.
    """
    (r00, r01, r02), (r10, r11, r12), (_, _, r22) = entries
    length = (r02 * r02 + r12 * r12) ** 0.5
    pole = length == 0
    # Adding the truth value makes 0/0 into 1/1: α = 0 at the poles.
    cosine, sine = (r02 + pole) / (length + pole), r12 / (length + pole)
    return [
        (cosine, sine),
        (r22, cosine * r02 + sine * r12),
        (cosine * r11 - sine * r01, cosine * r10 - sine * r00),
    ]


def _rotated_samples(rotation: Any, order: int) -> Any:
    """The basis at R d_k, (..., K, n²)."""
    directions = constant_like(sample_directions(order), rotation)
    return evaluate(directions @ rotation.swapaxes(-1, -2), order)


def checked_rotation(rotation: Any) -> Any:
    """The rotation (..., 3, 3) itself, floating. Raises ValueError where it is none."""
    rotation = as_floating(rotation)
    if rotation.ndim < 2 or tuple(rotation.shape[-2:]) != (3, 3):
        raise ValueError(f"a rotation must have shape (..., 3, 3), not {tuple(rotation.shape)}")
    xp = library(rotation)
    gram = rotation.swapaxes(-1, -2) @ rotation - constant_like(np.eye(3), rotation)
    if not bool((abs(gram) <= ORTHOGONALITY_TOLERANCE).all()):
        raise ValueError("not a rotation: its columns are not orthonormal")
    first, second, third = (rotation[..., axis] for axis in range(3))
    handed = (xp.linalg.cross(first, second) * third).sum(-1)
    if not bool((handed > 0).all()):
        raise ValueError("a reflection (determinant −1), not a rotation: flip one axis of it")
    return rotation


@lru_cache
def sample_directions(order: int) -> FloatArray:
    """2n − 1 directions at which the highest band is well conditioned, (K, 3), read-only."""
    from scipy.linalg import qr

    candidates = fibonacci_sphere(200 * order)
    highest = evaluate_reference(candidates, order)[:, (order - 1) ** 2 :]
    chosen = qr(highest.T, pivoting=True, mode="r")[1][: 2 * order - 1]
    result = candidates[chosen]
    result.flags.writeable = False
    return result


@lru_cache
def band_inverses(order: int) -> list[FloatArray]:
    """Pseudo-inverse (2l+1, K) of each band at the sample directions."""
    basis = evaluate_reference(sample_directions(order), order)
    return [np.linalg.pinv(basis[:, band * band : (band + 1) ** 2]) for band in range(order)]
