"""Radiance of local transfer in deformed frames, in NumPy: lobes two ways, and full harmonics.

    r = Σ_i Σ_lm y_lm(R s*_i) g*_il e_lm                                  directly   [1, eq. 13]
    r = Σ_i Σ_l ê_l(R s*_i) g*_il,  ê_l(s) = Σ_m y_lm(s) e_lm           by a table   [1, eq. 24–25]

A frame R takes the point's frame to the world; it may be a mirror image, as of the back of a relief
that bulges to both sides: lobes are the same in a mirror. The reference of ``runtime.lobe_shader``.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.hemisphere import places
from prtnet.reflection import LOWEST
from prtnet.sh import bands, evaluate, order_of
from prtnet.sh_rotation import rotate
from prtnet.zh import LobesApart, linear_axis

__all__ = [
    "TABLE",
    "LobeLight",
    "light_table",
    "rows_radiance",
    "seen_in",
    "view_factors",
]

TABLE = (64, 32)  # longitudes and latitudes, as in [1]
BLOCK = 1 << 14  # points at a time


@dataclass(frozen=True, eq=False)
class LobeLight:
    """Distant light of three colours.

    Attributes:
        harmonics: e, world frame, (n², 3).
        table: ê of ``light_table``, for lobes to be looked up in; None to evaluate them.
    """

    harmonics: FloatArray
    table: FloatArray | None = None


def light_table(harmonics: FloatArray, size: tuple[int, int] = TABLE) -> FloatArray:
    """ê_l [1, eq. 24] at latitudes and longitudes about +z, (latitudes, longitudes, n, 3).

    The first and last rows are the poles; columns are the middles of equal parts of the circle.

    Args:
        harmonics: of light, (n², 3).
        size: longitudes and latitudes.
    """
    order = order_of(harmonics.T)
    polar = math.pi * np.arange(size[1]) / (size[1] - 1)
    around = 2.0 * math.pi * (np.arange(size[0]) + 0.5) / size[0]
    z, phi = np.broadcast_arrays(np.cos(polar)[:, None], around)
    across = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    basis = evaluate(np.stack([across * np.cos(phi), across * np.sin(phi), z], axis=-1), order)
    products = basis[..., None] * harmonics
    return np.asarray(np.add.reduceat(products, np.arange(order) ** 2, axis=-2))


def looked_up(table: FloatArray, axes: FloatArray) -> FloatArray:
    """ê_l at unit vectors (..., 3), between the entries of a table, (..., n, 3)."""
    height, width = table.shape[:2]
    column = np.arctan2(axes[..., 1], axes[..., 0]) * (width / (2.0 * math.pi)) - 0.5
    row = np.arccos(np.clip(axes[..., 2], -1.0, 1.0)) * ((height - 1) / math.pi)
    left, above = np.floor(column).astype(int), np.floor(row).astype(int).clip(0, height - 2)
    x, y = (column - left)[..., None, None], (row - above)[..., None, None]
    total = np.zeros((*axes.shape[:-1], *table.shape[2:]))
    for down, up_share in ((0, 1.0 - y), (1, y)):
        for right, side_share in ((0, 1.0 - x), (1, x)):
            total += up_share * side_share * table[above + down, (left + right) % width]
    return total


def rows_radiance(
    points: LobesApart | FloatArray, frames: FloatArray, light: LobeLight
) -> FloatArray:
    """What rows of points make of distant light, (P, R, 3).

    Args:
        points: lobes (P, R, N), or full transfer (P, R, n²), which is turned exactly.
        frames: R, orthonormal, (P, 3, 3); of determinant 1 or −1.
        light: of the order of the points.
    """
    parts = []
    for start in range(0, len(frames), BLOCK):
        part, turn = slice(start, start + BLOCK), frames[start : start + BLOCK].astype(np.float64)
        if isinstance(points, LobesApart):
            lobes = LobesApart(points.low[part], points.lobes[part])
            parts.append(lobes_radiance(lobes, turn, light))
        else:
            parts.append(full_radiance(points[part], turn, light))
    return np.concatenate(parts) if parts else np.zeros((0, 1, 3))


def lobes_radiance(points: LobesApart, frames: FloatArray, light: LobeLight) -> FloatArray:
    """Of lobes (P, R, N) [1, eq. 13 or 25]."""
    e = light.harmonics
    axes = np.einsum("pij,prnj->prni", frames, points.lobes.axes)
    g = points.lobes.coefficients
    if light.table is None:
        y = evaluate(axes, g.shape[-1])
        total = np.einsum("prni,ic->prc", y * g[..., bands(g.shape[-1])], e)
    else:
        total = np.einsum("prnlc,prnl->prc", looked_up(light.table, axes), g)
    total = total + points.low[..., :1] * e[0]
    if len(e) > 1:
        low = np.einsum("pij,prj->pri", frames, linear_axis(points.low))
        total = total + low @ linear_axis(e.T).T
    return np.asarray(total)


def full_radiance(points: FloatArray, frames: FloatArray, light: LobeLight) -> FloatArray:
    """Of full transfer (P, R, n²), by rotation of its harmonics."""
    band = bands(order_of(points))
    m = np.arange(len(band)) - band * (band + 1)
    mirrored = np.linalg.det(frames) < 0
    # z → −z first, and then a rotation.
    parity = np.where((band + m) % 2 == 1, -1.0, 1.0)
    whole = np.where(mirrored[:, None, None], points * parity, points)
    turn = frames * np.where(mirrored[:, None, None], [1.0, 1.0, -1.0], 1.0)
    return np.asarray(rotate(whole, turn[:, None]) @ light.harmonics)


def view_factors(view: FloatArray, directions: FloatArray) -> FloatArray:
    """u_b(v), between the middles of cells, (P, R, 3).

    Args:
        view: of a field, (R, S, 3).
        directions: v towards the eye, in the frame of the relief's normal, (P, 3); those below
            its horizon are taken on it.
    """
    size = round(view.shape[1] ** 0.5)
    up = np.maximum(directions[:, 2:], LOWEST)
    above = np.concatenate([directions[:, :2], up], axis=1)
    above = above / np.linalg.norm(above, axis=1, keepdims=True)
    at = ((places(above, "concentric") + 1.0) * (size / 2.0) - 0.5).clip(0, size - 1)
    first = np.floor(at).astype(int).clip(0, max(size - 2, 0))
    share = at - first
    table = view.reshape(len(view), size, size, 3)
    total = np.zeros((len(view), len(directions), 3))
    for y in (0, 1):
        for x in (0, 1):
            row, column = (np.minimum(first[:, k] + step, size - 1) for k, step in ((1, y), (0, x)))
            weight = np.abs(1 - x - share[:, 0]) * np.abs(1 - y - share[:, 1])
            total += weight[:, None] * table[:, row, column]
    return total.swapaxes(0, 1)


def seen_in(rows: FloatArray, factors: FloatArray | None) -> FloatArray:
    """Radiance towards the eye (P, 3) of rows (P, R, 3) [1, eq. 16]; of matte ones, whole."""
    return rows[:, 0] if factors is None else np.asarray((rows * factors).sum(axis=1))
