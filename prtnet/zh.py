"""Zonal lobes: functions on the sphere as sums of a few circularly symmetric ones.

A lobe about an axis s* has one coefficient g*_l a band, and a sum of lobes has the coefficients

    f_lm = Σ_i g*_il y_lm(s*_i)                                                       [1, eq. 7]

A rotation turns the axes and leaves the coefficients alone. The axis −s* with g*_l (−1)^l is the
same lobe. For fixed axes the best coefficients are linear least squares, band by band; fits of
axes are ``prtnet.zh_fit``.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.array_library import as_floating
from prtnet.arrays import FloatArray
from prtnet.sh import bands, evaluate, order_of
from prtnet.sh_rotation import band_inverses, checked_rotation, sample_directions

__all__ = [
    "RIDGE",
    "Lobes",
    "LobesApart",
    "apart",
    "bands_apart",
    "best_coefficients",
    "checked",
    "exact_lobes",
    "linear_axis",
    "relative_error",
    "synthesis",
    "zonal_energy",
]

# Lobes that meet represent a derivative with coefficients without bounds, of opposite sign. This
# times ‖g*‖² in the objective keeps them below a thousand times the function's own.
RIDGE = 1e-6


@dataclass(frozen=True)
class Lobes:
    """Sums of N zonal lobes.

    Attributes:
        axes: unit vectors, (..., N, 3).
        coefficients: g*_l of every lobe, (..., N, n).
    """

    axes: FloatArray
    coefficients: FloatArray

    def __getitem__(self, which: Any) -> Lobes:
        """Some of the sums, by any index of their leading axes."""
        return Lobes(self.axes[which], self.coefficients[which])

    def harmonics(self) -> FloatArray:
        """The coefficients of the sum, (..., n²) [1, eq. 7]."""
        return synthesis(evaluate(self.axes, self.coefficients.shape[-1]), self.coefficients)

    def rotated(self, rotation: FloatArray) -> Lobes:
        """The lobes of f(R⁻¹ s): the same about turned axes [1, eq. 10].

        Args:
            rotation: R, (..., 3, 3); its leading axes broadcast with those of the lobes.

        Raises:
            ValueError: not a rotation.
        """
        turned = self.axes @ np.swapaxes(checked_rotation(rotation), -1, -2)
        leading = np.broadcast_shapes(turned.shape[:-2], self.coefficients.shape[:-2])
        shape = (*leading, *self.coefficients.shape[-2:])
        return Lobes(turned, np.broadcast_to(self.coefficients, shape))


@dataclass(frozen=True)
class LobesApart:
    """Sums of N zonal lobes with their lowest bands stored as they are [1, section 3.3].

    The first band needs no axis; of three lobes or more neither does the linear band, which any
    three of them hold: stored apart it is exact, and interpolates.

    Attributes:
        low: coefficients of the first two bands, (..., 4); of one or two lobes only the first is
            stored here, and the others are zero.
        lobes: sums whose coefficients of the bands stored apart are zero.
    """

    low: FloatArray
    lobes: Lobes

    def harmonics(self) -> FloatArray:
        """The coefficients of the sum, (..., n²)."""
        result = self.lobes.harmonics()
        stored = min(result.shape[-1], 4)
        result[..., :stored] += self.low[..., :stored]
        return result

    def rotated(self, rotation: FloatArray) -> LobesApart:
        """Those of f(R⁻¹ s); arguments and errors as ``Lobes.rotated``."""
        lobes = self.lobes.rotated(rotation)
        low = np.broadcast_to(self.low, (*lobes.axes.shape[:-2], 4)).copy()
        axis = linear_axis(low)
        turned = np.squeeze(axis[..., None, :] @ np.swapaxes(rotation, -1, -2), axis=-2)
        low[..., 1:] = turned[..., [1, 2, 0]] * np.array([-1.0, 1.0, -1.0])
        return LobesApart(low, lobes)


def apart(target: FloatArray, lobes: Lobes) -> LobesApart:
    """A fit with the bands apart that its number of lobes asks for, taken from its target.

    Args:
        target: f, (..., n²).
        lobes: fitted to it, (..., N).
    """
    first = bands_apart(lobes.axes.shape[-2])
    low = np.zeros((*target.shape[:-1], 4), dtype=lobes.coefficients.dtype)
    stored = min(first * first, target.shape[-1])
    low[..., :stored] = target[..., :stored]
    coefficients = lobes.coefficients.copy()
    coefficients[..., :first] = 0.0
    return LobesApart(low, Lobes(lobes.axes, coefficients))


def bands_apart(count: int) -> int:
    """How many bands are stored apart from so many lobes."""
    return 2 if count >= 3 else 1


def linear_axis(target: FloatArray) -> FloatArray:
    """The axis of linear bands (..., 4 or more), as long as they are, (..., 3)."""
    return np.asarray(target[..., [3, 1, 2]] * np.array([-1.0, -1.0, 1.0]))


def synthesis(basis: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Σ_i g*_il y_lm(s*_i), (..., n²), of the basis at the axes (..., N, n²)."""
    band = bands(coefficients.shape[-1])
    return np.asarray((basis * coefficients[..., band]).sum(axis=-2))


def exact_lobes(target: FloatArray) -> Lobes:
    """Functions of order n as sums of 2n − 1 lobes about axes that are the same for all.

    Band l has 2l + 1 ≤ 2n − 1 coefficients, and its basis at the axes spans them all: the
    coefficients of the lobes are the smallest that give them. Up to order 6 they are at most
    eight times the function's own.

    Args:
        target: f, (..., n²).

    Returns:
        Axes (..., 2n−1, 3) and coefficients (..., 2n−1, n), in the dtype of ``target``.
    """
    values, dtype = checked(target)
    order = order_of(values)
    parts = [
        values[..., band * band : (band + 1) ** 2] @ inverse
        for band, inverse in enumerate(band_inverses(order))
    ]
    axes = sample_directions(order)
    shared = np.broadcast_to(axes, (*values.shape[:-1], *axes.shape))
    return Lobes(shared.astype(dtype), np.stack(parts, axis=-1).astype(dtype))


def relative_error(target: FloatArray, lobes: Lobes) -> float:
    """√(Σ‖f̃ − f‖² / Σ‖f‖²) over all functions (..., n²); 0 where there is nothing to fit."""
    values, _ = checked(target)
    missed = lobes.harmonics() - values
    largest = max(np.abs(values).max(initial=0.0), np.finfo(np.float64).tiny)  # squares overflow
    error, size = (float(np.linalg.norm(part / largest)) for part in (missed, values))
    return error / size if error > 0 else 0.0


def best_coefficients(basis: FloatArray, target: FloatArray, ridge: float = RIDGE) -> FloatArray:
    """The g*_l (..., N, n) of lobes with the basis (..., N, n²) at their axes that fit f (..., n²).

    Of one lobe this is [1, eq. 18] but for the ridge; of several a system of N unknowns a band.
    """
    order = order_of(target)
    systems, right = [], []
    for band in range(order):
        part = slice(band * band, (band + 1) ** 2)
        own = basis[..., part]
        diagonal = ridge * zonal_energy(band) * np.eye(basis.shape[-2])
        systems.append(own @ np.swapaxes(own, -1, -2) + diagonal)
        right.append(own @ target[..., part, None])
    solved = np.linalg.solve(np.stack(systems, axis=-3), np.stack(right, axis=-3))
    return np.swapaxes(solved[..., 0], -1, -2)


def zonal_energy(band: Any) -> Any:
    """Σ_m y_lm², the same in every direction."""
    return (2 * band + 1) / (4.0 * math.pi)


def checked(target: FloatArray) -> tuple[FloatArray, np.dtype[Any]]:
    """The target as finite float64, and the dtype that results shall have."""
    given = as_floating(target)
    if not np.isfinite(given).all():
        raise ValueError("a coefficient of the function to fit is not finite")
    return given.astype(np.float64), given.dtype
