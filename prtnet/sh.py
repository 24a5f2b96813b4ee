"""Real spherical harmonics: basis, gradients, projection, products, windowing.

The basis is orthonormal with Condon–Shortley phase, y_1 = √(3/4π)·(−y, z, −x); coefficient
(l, m) has the index i = l² + l + m, and *order n* means n bands, n² coefficients.

Everything is a polynomial in the Cartesian direction, so poles are ordinary points:
y_{l,±m} = Q_lm(z)·{Re, Im}(x + iy)^m, where Q_lm = √2·(−1)^m·K_lm·d^m P_l/dz^m.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
    [2] Sloan, "Efficient Spherical Harmonic Evaluation", JCGT 2(2), 2013.
    [3] Sloan, "Stupid Spherical Harmonics (SH) Tricks", 2008.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.array_library import Array, as_floating, constant_like, library

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray, IntArray

__all__ = [
    "bands",
    "components",
    "evaluate",
    "evaluate_reference",
    "fibonacci_hemisphere",
    "fibonacci_sphere",
    "gradient",
    "lower_hemisphere",
    "order_of",
    "polynomial",
    "product_matrix",
    "project_function",
    "project_samples",
    "quadrature",
    "triple_product",
    "window",
]

# Powers of z cancel ever more with the band; up to here float32 stays at rounding level.
FAST_ORDER = 6
# Directions evaluated at a time.
BLOCK = 1 << 13


def evaluate(directions: Array, order: int) -> Array:
    """The basis at unit directions.

    Up to order 6 as explicit polynomials, above by the recurrence of ``evaluate_reference``.

    Args:
        directions: unit vectors, (..., 3), NumPy or torch (differentiable). Vectors of another
            length give a polynomial extension of no meaning: normalise first.
        order: number of bands n, at least 1.

    Returns:
        (..., n²), same library and dtype as ``directions``.
    """
    unit, xp = _checked(directions, order)
    flat = unit.reshape(-1, 3)
    if xp is np:
        # Blocks that stay in cache: fresh memory for every term costs more than the terms.
        basis: Any = np.empty((len(flat), order * order), unit.dtype)
        for start in range(0, len(flat), BLOCK):
            part = slice(start, start + BLOCK)
            x, y, z = np.ascontiguousarray(flat[part].T)
            np.stack(components(x, y, z, order), axis=-1, out=basis[part])
    else:
        basis = xp.stack(components(flat[:, 0], flat[:, 1], flat[:, 2], order), -1)
    return basis.reshape(*unit.shape[:-1], order * order)


def components(x: Array, y: Array, z: Array, order: int) -> list[Array]:
    """The basis at unit directions given by their components: n² arrays of their shape.

    What ``evaluate`` stacks; without the stacking where only sums are wanted.
    """
    rows = _polynomial_rows if order <= FAST_ORDER else _recurrence_rows
    return rows([x, y, z], order)


def evaluate_reference(directions: Array, order: int) -> Array:
    """The basis by the three-term recurrence in l: any order. Arguments as ``evaluate``."""
    directions, xp = _checked(directions, order)
    return xp.stack(_recurrence_rows([directions[..., axis] for axis in range(3)], order), -1)


def _polynomial_rows(xyz: Any, order: int) -> list[Any]:
    """Every y_lm, each Q_lm by Horner's rule in z² with exact coefficients [2]."""
    x, y, z = xyz
    cosine, sine = _azimuth(x, y, order)
    squared = z * z
    rows: list[Any] = [None] * (order * order)
    for band in range(order):
        centre = band * band + band
        for m in range(band + 1):
            value, *others = polynomial(band, m)
            for other in others:
                value = value * squared + other
            if (band - m) % 2:
                value = value * z
            if m:
                rows[centre + m] = value * cosine[m]
                rows[centre - m] = value * sine[m]
            else:
                rows[centre] = value if band else value * library(z).ones_like(z)
    return rows


def _recurrence_rows(xyz: Any, order: int) -> list[Any]:
    x, y, z = xyz
    legendre = _legendre(z, order)
    cosine, sine = _azimuth(x, y, order)
    rows: list[Any] = []
    for band in range(order):
        rows.extend(legendre[band][m] * sine[m] for m in range(band, 0, -1))
        rows.append(legendre[band][0])
        rows.extend(legendre[band][m] * cosine[m] for m in range(1, band + 1))
    return rows


def fibonacci_sphere(count: int) -> FloatArray:
    """Nearly uniform unit directions over the sphere, (count, 3) float64; equal weights 4π/N."""
    return _fibonacci(1.0 - (2.0 * np.arange(count) + 1.0) / count)


def fibonacci_hemisphere(count: int) -> FloatArray:
    """Nearly uniform unit directions with z > 0, (count, 3) float64; equal weights 2π/N."""
    return _fibonacci(1.0 - (np.arange(count) + 0.5) / count)


def _fibonacci(z: FloatArray) -> FloatArray:
    golden_angle = math.pi * (3.0 - math.sqrt(5.0))
    azimuth = golden_angle * np.arange(len(z))
    sine = np.sqrt((1.0 - z) * (1.0 + z))
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1)


def _checked(directions: Any, order: int) -> tuple[Any, Any]:
    if order < 1:
        raise ValueError(f"order must be at least 1, not {order}")
    directions = as_floating(directions)
    if directions.ndim == 0 or directions.shape[-1] != 3:
        raise ValueError(f"directions must have shape (..., 3), not {tuple(directions.shape)}")
    return directions, library(directions)


def _azimuth(x: Any, y: Any, order: int) -> tuple[list[Any], list[Any]]:
    """Real and imaginary parts of (x + iy)^m for m < order; those of m = 0 are 1 and 0."""
    cosine: list[Any] = [1.0, x]
    sine: list[Any] = [0.0, y]
    for _ in range(2, order):
        c, s = cosine[-1], sine[-1]
        cosine.append(x * c - y * s)
        sine.append(x * s + y * c)
    return cosine, sine


def _legendre(z: Any, order: int) -> list[list[Any]]:
    """Q_lm(z) as ``result[l][m]``, normalised so that the recurrence cannot overflow [2]."""
    one = library(z).ones_like(z)
    result: list[list[Any]] = []
    diagonal = math.sqrt(1.0 / (4.0 * math.pi))
    for band in range(order):
        if band > 0:
            # √2 enters once, with the step from m = 0 to m = 1.
            diagonal *= -math.sqrt((2 * band + 1) / (2 * band)) * (
                math.sqrt(2.0) if band == 1 else 1.0
            )
        row = []
        for m in range(band):
            scale = math.sqrt((4 * band * band - 1) / (band * band - m * m))
            value = scale * (z * result[band - 1][m])
            if m <= band - 2:
                before = math.sqrt(((band - 1) ** 2 - m * m) / (4 * (band - 1) ** 2 - 1))
                value = value - (scale * before) * result[band - 2][m]
            row.append(value)
        row.append(diagonal * one)
        result.append(row)
    return result


@cache
def polynomial(band: int, m: int) -> tuple[float, ...]:
    """Q_lm's coefficients, highest power of z first, every second power (the rest vanish).

    y_{l,±m} = Q_lm(z) · {Re, Im}(x + iy)^m.
    """
    ratio = Fraction(math.factorial(band - m), math.factorial(band + m)) * (2 * band + 1)
    scale = (-1) ** m * math.sqrt((2 if m else 1) * ratio / (4.0 * math.pi))
    coefficients = []
    for k in range((band - m) // 2 + 1):
        # P_l = 2^−l Σ_k (−1)^k C(l, k) C(2l − 2k, l) z^(l − 2k), differentiated m times.
        value = math.comb(band, k) * math.comb(2 * band - 2 * k, band)
        exact = Fraction((-1) ** k * value * math.perm(band - 2 * k, m), 2**band)
        coefficients.append(scale * float(exact))
    return tuple(coefficients)


def gradient(directions: Array, order: int) -> Array:
    """∇(y_lm ∘ h), h(s) = s/‖s‖: how the basis changes with an unconstrained axis [1, eq. 20–21].

    J_h = (I − ŝŝᵀ)/‖s‖ removes the radial part, so the result does not depend on how the
    polynomials are extended off the sphere.

    Args:
        directions: vectors of any length but zero, (..., 3).
        order: number of bands n.

    Returns:
        (..., n², 3), same library and dtype as ``directions``.
    """
    directions, xp = _checked(directions, order)
    length = (directions * directions).sum(-1)[..., None] ** 0.5
    unit = directions / length
    x, y, z = (unit[..., axis] for axis in range(3))
    legendre = _legendre(z, order)
    cosine, sine = _azimuth(x, y, order)
    zero = x * 0
    rows = []
    for band in range(order):
        for m in range(-band, band + 1):
            k = abs(m)
            # dQ_lm/dz = −√((l − m)(l + m + 1))·Q_l,m+1; Q_l0 lacks the √2 of the others.
            slope = zero
            if k < band:
                step = math.sqrt((band - k) * (band + k + 1) / (1 if k else 2))
                slope = -step * legendre[band][k + 1]
            # d(x + iy)^m = m·(x + iy)^(m−1)·(dx + i dy)
            real, imaginary = (cosine[k - 1], sine[k - 1]) if k else (zero, zero)
            radial = k * legendre[band][k]
            if m >= 0:
                rows.append(xp.stack([radial * real, -radial * imaginary, slope * cosine[k]], -1))
            else:
                rows.append(xp.stack([radial * imaginary, radial * real, slope * sine[k]], -1))
    ambient = xp.stack(rows, -2)  # [..., n², 3]
    along = (ambient * unit[..., None, :]).sum(-1)[..., None]
    return (ambient - along * unit[..., None, :]) / length[..., None]


def quadrature(degree: int) -> tuple[FloatArray, FloatArray]:
    """Directions (N, 3) and weights (N,) that integrate polynomials up to ``degree`` exactly.

    Gauss–Legendre in z times uniform azimuth; the weights sum to 4π. The product of a function
    of order a and one of order b has degree a + b − 2.
    """
    z, z_weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    count = degree + 1
    azimuth = 2.0 * math.pi / count * np.arange(count)
    sine = np.sqrt((1.0 - z) * (1.0 + z))[:, None]
    directions = np.stack(
        np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), z[:, None]), axis=-1
    )
    weights = np.repeat(z_weights * (2.0 * math.pi / count), count)
    return directions.reshape(-1, 3), weights


def project_samples(values: Array, directions: Array, weights: Array | float, order: int) -> Array:
    """Coefficients of a function known at samples: Σ_k w_k f(s_k) y(s_k).

    Args:
        values: f at the samples, (N, ...); trailing axes (colours, receivers) are kept.
        directions: unit vectors, (N, 3).
        weights: solid angle of each sample in steradians, (N,), or one number for all.
        order: number of bands n.

    Returns:
        (n², ...).
    """
    if len(values) != len(directions):
        raise ValueError(f"{len(values)} values for {len(directions)} directions")
    values, directions = as_floating(values), as_floating(directions)
    flat = values.reshape(len(values), math.prod(values.shape[1:]))
    total: Any = 0.0
    for start in range(0, max(len(flat), 1), BLOCK):
        part = slice(start, start + BLOCK)
        weight = weights if isinstance(weights, int | float) else weights[part, None]
        total = total + evaluate(directions[part], order).T @ (weight * flat[part])
    return total.reshape(order * order, *values.shape[1:])


def project_function(
    function: Callable[[FloatArray], FloatArray], order: int, degree: int = 127
) -> FloatArray:
    """Coefficients of a function of direction by quadrature.

    Args:
        function: takes unit directions (N, 3) float64, returns (N, ...).
        order: number of bands n.
        degree: of polynomials integrated exactly: with the default, smooth functions come out to
            rounding, and a step is sampled at 64 heights × 128 azimuths.

    Returns:
        (n², ...).
    """
    directions, weights = quadrature(degree)
    return project_samples(np.asarray(function(directions)), directions, weights, order)


def triple_product(
    order_a: int, order_b: int | None = None, order_out: int | None = None
) -> FloatArray:
    """Γ_ijk = ∫ y_i y_j y_k, (a², b², out²) float64, read-only; exact zeros where it vanishes.

    Args:
        order_a: bands of the first factor.
        order_b: bands of the second factor; as the first when None.
        order_out: bands kept of the product; as the first factor when None. The whole product
            has a + b − 1 bands.
    """
    return _triple_product(order_a, order_b or order_a, order_out or order_a)


@lru_cache(maxsize=32)
def _triple_product(order_a: int, order_b: int, order_out: int) -> FloatArray:
    directions, weights = quadrature(order_a + order_b + order_out - 3)
    a, b, out = (evaluate_reference(directions, order) for order in (order_a, order_b, order_out))
    pairs = a[:, :, None] * (weights[:, None] * b)[:, None, :]
    gamma = (pairs.reshape(len(directions), -1).T @ out).reshape(a.shape[1], b.shape[1], -1)
    # Selection rules make most entries zero; what is left of those is rounding.
    gamma[np.abs(gamma) < 1e-12] = 0.0
    gamma.flags.writeable = False
    return gamma


def product_matrix(
    coefficients: Array, order_in: int | None = None, order_out: int | None = None
) -> Array:
    """The linear operator g → f·g of a function f: M_kj = Σ_i f_i Γ_ijk.

    Symmetric when ``order_in`` equals ``order_out``; its order-n truncation of f·g is exact.

    Args:
        coefficients: f, (..., n²).
        order_in: bands of g; as f when None.
        order_out: bands kept of f·g; as ``order_in`` when None.

    Returns:
        (..., out², in²), same library and dtype as ``coefficients``.
    """
    coefficients = as_floating(coefficients)
    order = order_of(coefficients)
    order_in = order_in or order
    gamma = triple_product(order, order_in, order_out or order_in)
    operator = gamma.transpose(0, 2, 1).reshape(len(gamma), -1)
    flat = coefficients @ constant_like(operator, coefficients)
    return flat.reshape(*coefficients.shape[:-1], gamma.shape[2], gamma.shape[1])


def lower_hemisphere(order: int) -> FloatArray:
    """Coefficients (n²) of what is 1 below the horizon z = 0 and 0 above it."""
    z, weight = np.polynomial.legendre.leggauss(order)
    z = (z - 1.0) / 2.0
    values = evaluate(np.stack([np.sqrt(1.0 - z * z), 0.0 * z, z], axis=1), order)
    degree = np.arange(order)
    zonal = np.zeros(order**2)
    zonal[degree * (degree + 1)] = math.pi * (weight @ values)[degree * (degree + 1)]
    return zonal


def window(order: int, gamma: float) -> FloatArray:
    """Factors 1/(1 + γ(l(l+1))²) against ringing, one a coefficient, (n²,) float64 [3]."""
    band = bands(order).astype(np.float64)
    return 1.0 / (1.0 + gamma * (band * (band + 1.0)) ** 2)


def bands(order: int) -> IntArray:
    """The band l of every coefficient, (n²,)."""
    return np.repeat(np.arange(order), 2 * np.arange(order) + 1)


def order_of(coefficients: Any) -> int:
    """The order n of an array whose last axis holds n² coefficients."""
    count = coefficients.shape[-1]
    order = math.isqrt(count)
    if order < 1 or order * order != count:
        raise ValueError(f"the last axis holds {count} coefficients, which is not a square")
    return order
