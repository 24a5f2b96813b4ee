"""How far sums of lobes with the best coefficients are from functions, and its slope: many at once.

Only axes are unknown: for given axes the coefficients are least squares, a system of N unknowns a
band ("variable projection"). By the addition theorem

    Σ_m y_lm(a) y_lm(b) = (2l + 1)/4π P_l(a·b)

the matrix of that system is Legendre polynomials of the cosines between axes, and its right side
the bands of the function at the axes: no basis is stored, and a column of every array is a problem,
so that every operation runs over neighbouring numbers.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from itertools import combinations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.sh import order_of, polynomial
from prtnet.zh import zonal_energy

__all__ = ["BandValues", "Cosines", "Misfit", "parts_of"]


class Misfit:
    """The objective ‖f̃ − f‖² + ε‖g*‖² of functions f at the best coefficients g* of given axes.

    The first band is left out, which any lobe holds exactly.

    Args:
        target: f, (B, n²).
        ridge: ε over the (2l + 1)/4π of every band.
    """

    def __init__(self, target: FloatArray, ridge: float) -> None:
        self.order = order_of(target)
        self.ridge = ridge
        rest = np.ascontiguousarray(target[:, 1:].T)
        self.size = (rest * rest).sum(axis=0)
        self.parts = parts_of(target)
        self.energy = zonal_energy(np.arange(1, self.order))[:, None, None]

    def __call__(self, which: IntArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values (K,) and slopes (3N, K) of the functions ``which`` (K,) at axes (3N, K).

        A column holds the x of all axes, then y, then z: vectors of any length but zero.
        """
        size = self.size[which]
        if self.order == 1:
            return size, np.zeros_like(points)
        axes = points.reshape(3, len(points) // 3, len(which))
        length = np.sqrt((axes * axes).sum(axis=0))
        unit = axes / length
        value = BandValues(unit, [part[..., which] for part in self.parts])
        cosines = Cosines(unit, self.order)
        right = value.bands / self.energy
        g = solved(cosines.kernel, right, self.ridge)
        left = size - (g * value.bands).sum(axis=(0, 1))
        slope = cosines.slope(g, self.energy) - value.slope(g)
        slope -= (slope * unit).sum(axis=0) * unit
        slope *= 2.0 / length
        return left, slope.reshape(points.shape)


def parts_of(target: FloatArray) -> list[FloatArray]:
    """Functions (B, n²) without their first band, for every |m|: (bands from |m|, 2 (m, −m), B)."""
    order = order_of(target)
    return [
        np.stack([target[:, [b * b + b + m, b * b + b - m]].T for b in bands_of(m, order)])
        for m in range(order if order > 1 else 0)
    ]


class BandValues:
    """The bands of functions at axes, f_l(a), without the first.

    Args:
        unit: axes (3, N, K).
        parts: the functions, as ``parts_of`` gives them.

    Attributes:
        bands: values (n − 1, N, K).
    """

    def __init__(self, unit: FloatArray, parts: list[FloatArray]) -> None:
        order = len(parts)
        x, y, z = unit
        table = associated(order) @ powers(z, order).reshape(order, -1)
        self.legendre = table.reshape(2, -1, *z.shape)
        self.parts = parts
        self.cosine, self.sine = [np.ones_like(x), x], [np.zeros_like(x), y]
        for _ in range(2, order):
            c, s = self.cosine[-1], self.sine[-1]
            self.cosine.append(x * c - y * s)
            self.sine.append(x * s + y * c)
        self.bands = np.zeros((order - 1, *z.shape))
        self.turned = []
        first = 0
        for m, part in enumerate(parts):
            turned = part[:, 0, None] * self.cosine[m]
            if m:
                turned += part[:, 1, None] * self.sine[m]
            self.turned.append(turned)
            self.bands[max(m, 1) - 1 :] += self.legendre[0, first : first + len(part)] * turned
            first += len(part)

    def slope(self, g: FloatArray) -> FloatArray:
        """Σ_l g_l ∇f_l(a), (3, N, K), but for a part along the axis."""
        x, y, z = result = np.zeros((3, *g.shape[1:]))
        first = 0
        for m, part in enumerate(self.parts):
            weight = g[max(m, 1) - 1 :]
            value, slope = self.legendre[:, first : first + len(part)]
            z += (slope * weight * self.turned[m]).sum(axis=0)
            if m:
                weighted = value * weight
                a = (weighted * part[:, 0, None]).sum(axis=0)
                b = (weighted * part[:, 1, None]).sum(axis=0)
                x += m * (a * self.cosine[m - 1] + b * self.sine[m - 1])
                y += m * (b * self.cosine[m - 1] - a * self.sine[m - 1])
            first += len(part)
        return result


class Cosines:
    """Legendre polynomials of the cosines between axes, without the first.

    Args:
        unit: axes (3, N, K).
        order: number of bands n.

    Attributes:
        kernel: P_l(a_i · a_j) by pairs i < j, (n − 1, K) each.
        bend: P_l′ of the same, (n − 1, pairs, K).
    """

    def __init__(self, unit: FloatArray, order: int) -> None:
        self.unit = unit
        self.pairs = list(combinations(range(unit.shape[1]), 2))
        shape = (2, order - 1, len(self.pairs), unit.shape[2])
        t = np.empty(shape[2:])
        for k, (i, j) in enumerate(self.pairs):
            t[k] = (unit[:, i] * unit[:, j]).sum(axis=0)
        table = (legendre(order) @ powers(t, order).reshape(order, -1)).reshape(shape)
        self.kernel = {pair: table[0, :, k] for k, pair in enumerate(self.pairs)}
        self.bend = table[1]

    def times(self, g: FloatArray) -> FloatArray:
        """Σ_j P_l(a_i · a_j) g_jl, (n − 1, N, K)."""
        result = g.copy()
        for (i, j), kernel in self.kernel.items():
            result[:, i] += kernel * g[:, j]
            result[:, j] += kernel * g[:, i]
        return result

    def slope(self, g: FloatArray, energy: FloatArray) -> FloatArray:
        """Σ_l (2l + 1)/4π Σ_j g_il g_jl P_l′(a_i · a_j) a_j, (3, N, K), but for j = i."""
        result = np.zeros_like(self.unit)
        weighted = g * energy
        for k, (i, j) in enumerate(self.pairs):
            pull = (weighted[:, i] * g[:, j] * self.bend[:, k]).sum(axis=0)
            result[:, i] += pull * self.unit[:, j]
            result[:, j] += pull * self.unit[:, i]
        return result


def solved(
    kernel: Mapping[tuple[int, int], FloatArray], right: FloatArray, ridge: float
) -> FloatArray:
    """(P + ε I)⁻¹ r of symmetric P with a diagonal of ones: by elimination, without pivots.

    Args:
        kernel: P above its diagonal, (L, K) a pair.
        right: r, (L, N, K).
        ridge: ε.
    """
    count = right.shape[1]
    rows = [[np.full_like(right[:, i], 1.0 + ridge)] for i in range(count)]
    for i, row in enumerate(rows):
        row += [kernel[i, j].copy() for j in range(i + 1, count)]
        row.append(right[:, i].copy())
    for k in range(count):
        for i in range(k + 1, count):
            factor = rows[k][i - k] / rows[k][0]
            for j in range(len(rows[i])):
                rows[i][j] -= factor * rows[k][i - k + j]
    result = np.empty_like(right)
    for k in reversed(range(count)):
        rest = rows[k][-1]
        for j in range(k + 1, count):
            rest -= rows[k][j - k] * result[:, j]
        np.divide(rest, rows[k][0], out=result[:, k])
    return result


def powers(t: FloatArray, order: int) -> FloatArray:
    """t⁰ … tⁿ⁻¹, (n, ...)."""
    result = np.empty((order, *t.shape))
    result[0] = 1.0
    for k in range(1, order):
        np.multiply(result[k - 1], t, out=result[k])
    return result


def bands_of(m: int, order: int) -> range:
    """The bands above the first that have an order m."""
    return range(max(m, 1), order)


@cache
def associated(order: int) -> FloatArray:
    """Q_lm(z) and its derivative as sums of powers of z: rows by m, then by l."""
    values = []
    for m in range(order):
        for band in bands_of(m, order):
            row = np.zeros(order)
            falling = polynomial(band, m)
            row[band - m - 2 * np.arange(len(falling))] = falling
            values.append(row)
    return with_derivative(np.stack(values))


@cache
def legendre(order: int) -> FloatArray:
    """P_l(t) of bands above the first, and P_l′(t), as sums of powers of t."""
    rows = [
        np.array(polynomial(band, 0)) * math.sqrt(4.0 * math.pi / (2 * band + 1))
        for band in range(1, order)
    ]
    values = np.zeros((order - 1, order))
    for band, falling in enumerate(rows, start=1):
        values[band - 1, band - 2 * np.arange(len(falling))] = falling
    return with_derivative(values)


def with_derivative(rows: FloatArray) -> FloatArray:
    """Rows of coefficients of rising powers, and below them those of the derivatives."""
    slopes = np.zeros_like(rows)
    slopes[:, :-1] = rows[:, 1:] * np.arange(1, rows.shape[1])
    return np.concatenate([rows, slopes])
