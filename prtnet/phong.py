"""The Phong lobe as a linear operator on spherical harmonics, for any real exponent α ≥ 0 [1].

In a frame whose +z is the lobe's axis (the mirrored view), over the hemisphere around that axis,

    t_lm = (α + 1)/2π Σ M^α[l'm', lm] v_l'm',    M^α[l'm', lm] = ∫_{z>0} z^α y_l'm' y_lm ds  [1, 2]

takes visibility v to what light is to be dotted with. The factor makes the lobe's integral 1: α = 0
is the mean over the hemisphere, α = 1 is diffuse transfer over π (M^1 is the clamped cosine's
matrix), α → ∞ a mirror.

Turning around z changes nothing, so M^α mixes only equal m, and ±m alike: n(n+1)(n+2)/6 distinct
entries, 44 of 256 not zero at order 4. In the entry of l, l' and m the polynomial Q_lm Q_l'm is
taken apart into Gegenbauer polynomials C of index m + 1/2, scaled to 1 at z = 1. By their
linearization formula all coefficients are positive, and the integrals

    I_mL(α) = ∫₀¹ z^α (1 − z²)^m C_L(z) dz

follow one another with factors alone:

    I_m0 = Π_{j=1..m} 2j/(α + 1 + 2j) / (α + 1)
    I_m1 = Π_{j=1..m} 2j/(α + 2 + 2j) / (α + 2)
    I_m,L+2 = I_mL (α − L)/(α + L + 2m + 3)

So nothing cancels for α ≥ 2n − 4, and little below: float32 keeps its digits entry by entry up to
any exponent. In powers of z, with the integrals 1/(α + k + 1), it loses 1e-5 of the largest entry
at order 6 and 6e-4 at order 8, and all digits of the entries of m > 0, which fall like α^−m. So
M^α tends to rank one: it is there to multiply with, not to be solved.

The appendix of [1] at order 4, in its hexadecimal indices, against quadrature. It leaves out the
factor (α + 1)/2π of its own eq. 2. Of the 19 entries that it lists 16 are right; the others, as a
scanned copy has them:

    M_0B   is M_0C (an entry of two different m is zero)
    M_BB   has α₄ where it is α₅: 21(2α² + 4α + 5)/(2 α₁ α₃ α₅ α₇); printed twice, once right
    M_6C   has α₁α₂α₆ where it is α₂α₄α₆: √35 (α² + 2α + 6)/(2 α₂ α₄ α₆)
    M_66   is missing: 5(α² + 2α + 3)/(2 α₁ α₃ α₅)

Eq. 1 has 2l + l for 2l + 1, and eq. 2 (z·s)^α inside the maximum, which is to clamp z·s.

Papers:
    [1] Nowrouzezahrai, Kalogerakis, Simari and Fiume, "Shadowed Relighting of Dynamic Geometry with
        1D BRDFs", 2008, section 4.2 and appendix A.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from prtnet.array_library import Array, as_floating, constant_like, library
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.sh import evaluate_reference, order_of

__all__ = ["Block", "blocks", "integrals", "phong_matrix", "phong_transfer", "phong_zonal"]


@dataclass(frozen=True, eq=False)
class Block:
    """What M^α does to the coefficients of ±m, K = n − m of either sign.

    Attributes:
        m: at least 0.
        indices: l² + l + m of l = m … n − 1, (K,), and l² + l − m where that is another.
        weights: (α + 1)/2π M^α[l, l'] = Σ_L weights[L, place[l, l']] (α + 1) I_mL, a column for
            each l ≤ l', (2K − 1, K(K + 1)/2); positive where L + l + l' is even and
            |l − l'| ≤ L ≤ l + l' − 2m, zero elsewhere.
        place: the column of each entry, (K, K).
    """

    m: int
    indices: tuple[IntArray, ...]
    weights: FloatArray
    place: IntArray


@lru_cache
def blocks(order: int) -> tuple[Block, ...]:
    """The structure of M^α of n bands: a block for each m = 0 … n − 1, whatever the exponent."""
    return tuple(_block(m, order) for m in range(order))


def _block(m: int, order: int) -> Block:
    z, quadrature = np.polynomial.legendre.leggauss(2 * order)
    around = 2.0 * math.pi if m == 0 else math.pi  # ∫ cos²(m φ) dφ
    band = np.arange(m, order)
    index = band * band + band + m
    arc = np.stack([np.sqrt((1.0 - z) * (1.0 + z)), 0.0 * z, z], axis=1)
    basis = evaluate_reference(arc, order)[:, index]  # Q_lm (1 − z²)^(m/2)
    count = 2 * len(band) - 1
    polynomials = np.stack(_gegenbauer(z, m, count))
    sizes = (polynomials**2 * (1.0 - z * z) ** m) @ quadrature
    first, second = np.triu_indices(len(band))
    weights = (polynomials * quadrature) @ (basis[:, first] * basis[:, second])
    weights *= around / (2.0 * math.pi) / sizes[:, None]
    degree, total = np.arange(count)[:, None], band[first] + band[second]
    reached = (degree >= band[second] - band[first]) & (degree <= total - 2 * m)
    weights[~reached | ((degree + total) % 2 == 1)] = 0.0
    place = np.zeros((len(band), len(band)), dtype=np.intp)
    place[first, second] = place[second, first] = np.arange(len(first))
    weights.flags.writeable = False
    return Block(m, (index, index - 2 * m) if m else (index,), weights, place)


def _gegenbauer(z: FloatArray, m: int, count: int) -> list[FloatArray]:
    """C_L of index m + 1/2 over its value at 1, for L < count; Legendre's for m = 0."""
    rows = [np.ones_like(z), z]
    for degree in range(1, count - 1):
        step = (2 * degree + 2 * m + 1) * z * rows[-1] - degree * rows[-2]
        rows.append(step / (degree + 2 * m + 1))
    return rows[:count]


def integrals(alpha: Array, order: int) -> list[list[Array]]:
    """(α + 1) I_mL as ``result[m][L]``, L = 0 … 2(n − 1 − m): n² arrays of the shape of α.

    Between −1 and 1 for every α.
    """
    exponent: Any = alpha
    even = library(exponent).ones_like(exponent)
    odd = (exponent + 1.0) / (exponent + 2.0)
    rows = []
    for m in range(order):
        if m:
            even = even * (2 * m / (exponent + (1.0 + 2 * m)))
            odd = odd * (2 * m / (exponent + (2.0 + 2 * m)))
        row = [even, odd]
        for degree in range(2 * (order - 1 - m) - 1):
            ratio = (exponent - degree) / (exponent + (degree + 2 * m + 3.0))
            row.append(row[degree] * ratio)
        rows.append(row[: 2 * (order - m) - 1])
    return rows


def phong_matrix(alpha: Array | float, order: int) -> Array:
    """M^α, without the factor (α + 1)/2π.

    Args:
        alpha: exponents (...), NumPy, torch (differentiable) or a number.
        order: number of bands n.

    Returns:
        Symmetric (..., n², n²), of the library and dtype of ``alpha``.

    Raises:
        PrtnetError: an exponent is negative or not finite.
    """
    exponent: Any = _checked(alpha)
    xp = library(exponent)
    shape = (*exponent.shape, order * order, order * order)
    result = xp.zeros(shape, dtype=exponent.dtype, device=exponent.device)
    factor = (2.0 * math.pi / (exponent + 1.0))[..., None, None]
    for block, entries in zip(blocks(order), _entries(exponent, order), strict=True):
        for index in block.indices:
            result[..., index[:, None], index] = factor * entries
    return result


def phong_transfer(alpha: Array | float, coefficients: Array) -> Array:
    """Multiply with the lobe: (α + 1)/2π M^α v, block by block [1, eq. 2].

    Light of the same order in the same frame · the result is the radiance.

    Args:
        alpha: exponents; their shape (...) broadcasts with the leading axes of ``coefficients``.
        coefficients: v in the frame whose +z is the lobe's axis, (..., n²).

    Returns:
        (..., n²), of the library and dtype of ``coefficients``.

    Raises:
        PrtnetError: an exponent is negative or not finite.
    """
    vector: Any = as_floating(coefficients)
    order = order_of(vector)
    exponent = _checked(alpha, vector)
    xp = library(vector)
    parts, places = [], []
    for block, entries in zip(blocks(order), _entries(exponent, order), strict=True):
        for index in block.indices:
            parts.append((entries @ vector[..., index, None])[..., 0])
            places.append(index)
    return xp.concatenate(parts, -1)[..., np.argsort(np.concatenate(places))]


def phong_zonal(alpha: Array | float, order: int) -> Array:
    """What the lobe multiplies band l of a function by where nothing is in the way (Funk–Hecke).

    (α + 1)/2π ∫_{s·a>0} f(s) (s·a)^α ds = Σ_l k_l f_l(a), with f_l the band of f alone.

    Args:
        alpha: exponents (...), as for ``phong_matrix``.
        order: number of bands n.

    Returns:
        k_l, (..., n): 1, 2/3, 1/4, 0, … for the cosine lobe α = 1.

    Raises:
        PrtnetError: an exponent is negative or not finite.
    """
    exponent = _checked(alpha)
    row = integrals(exponent, order)[0]
    return library(exponent).stack(row[:order], -1)


def _entries(exponent: Any, order: int) -> list[Any]:
    """The blocks of (α + 1)/2π M^α, (..., K, K) for each m."""
    xp = library(exponent)
    result = []
    for block, row in zip(blocks(order), integrals(exponent, order), strict=True):
        entries = xp.stack(row, -1) @ constant_like(block.weights, exponent)
        result.append(entries[..., block.place])
    return result


def _checked(alpha: Any, example: Any = None) -> Any:
    """Exponents as an array, of the library and dtype of ``example`` where they are plain."""
    exponent = as_floating(alpha)
    if example is not None and library(exponent) is np:
        exponent = constant_like(exponent, example)
    xp = library(exponent)
    if not bool(((exponent >= 0) & xp.isfinite(exponent)).all()):
        raise PrtnetError("Phong exponent", "must be finite, at least 0")
    return exponent
