"""Subsurface scatter between the points of a surface, by the dipole of ``prtnet.dipole``.

    exit(X)_i = Σ_j R_d(|x_i − x_j|) A_j X_j

over straight distances, so thin parts let light through [1]. Each point stands for a disc of its
area: its own disc's integral is in closed form, and for near points R_d is averaged over discs of
both areas' mean, which keeps the sum right where R_d is narrower than the spacing. Far away points
are taken together in cells, as in [1]: near cells point by point, far ones as one.

The dipole is of a half space. Where a body is thin or hollow, straight distances are short, and the
sum over all places may exceed 1: light out of nothing. There it is scaled down, alike for the place
where light enters and the place where it leaves, until none sends on more than it takes.

[1] Jensen and Buhler, "A Rapid Hierarchical Rendering Technique for Translucent Materials",
    SIGGRAPH 2002.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse
from scipy.spatial import KDTree

from prtnet.arrays import FloatArray, IntArray
from prtnet.dipole import Medium

__all__ = ["TAIL", "DiscKernel", "Scattering", "exit_matrix", "scattering", "shifts_of"]

TAIL = 1e-3  # share of the plane's reflectance beyond the pairs that count
FAR = 2.5  # widths of a cell: closer cells count point by point
ACROSS = 16  # cells between a point and the farthest that counts
AVERAGED = 6.0  # disc radii: beyond, the middle of a disc is as good as its mean
BLOCK_PAIRS = 1 << 22
ROUNDS = 20  # of scaling


class DiscKernel:
    """Means of R_d over discs: a table over radius and distance, in the disc's radii.

    Args:
        medium: what scatters.
        radii: of the discs, metres, (K,).
    """

    COLUMNS = 97  # distances up to AVERAGED

    def __init__(self, medium: Medium, radii: FloatArray) -> None:
        self.medium = medium
        smallest, largest = float(radii.min()), float(radii.max())
        count = 1 + math.ceil(16.0 * math.log2(max(largest / smallest, 1.0)))
        self.first = math.log2(smallest)
        self.step = (math.log2(max(largest, smallest)) - self.first) / max(count - 1, 1) or 1.0
        steps = 2.0 ** (self.first + self.step * np.arange(count))
        rings, angles = 24, 24
        r2, weight = np.polynomial.legendre.leggauss(rings)
        rho = np.sqrt(0.5 * (r2 + 1.0))[:, None]
        weight = np.broadcast_to(0.5 * weight[:, None] / angles, (rings, angles))
        phi = math.pi * (np.arange(angles) + 0.5) / angles
        x = np.linspace(0.0, AVERAGED, self.COLUMNS)[:, None, None]
        offset = np.sqrt(np.maximum(x * x + rho * rho - 2.0 * x * rho * np.cos(phi), 0.0))
        self.table = np.stack(
            [(weight * medium.profile(radius * offset)).sum(axis=(1, 2)) for radius in steps]
        )
        self.table[:, 0] = medium.within(steps) / (math.pi * steps**2)

    def __call__(self, distance: FloatArray, radius: FloatArray) -> FloatArray:
        """Means (...) at distances (...) from the middles of discs with radii (...), metres."""
        value = self.medium.profile(distance)
        near = np.flatnonzero(distance < AVERAGED * radius)
        r = radius[near]
        column = distance[near] / r * ((self.COLUMNS - 1) / AVERAGED)
        row = np.clip((np.log2(r) - self.first) / self.step, 0.0, len(self.table) - 1.0)
        c, d = np.minimum(column.astype(np.int64), self.COLUMNS - 2), row.astype(np.int64)
        e = np.minimum(d + 1, len(self.table) - 1)
        s, t = column - c, row - d
        low = (1 - s) * self.table[d, c] + s * self.table[d, c + 1]
        high = (1 - s) * self.table[e, c] + s * self.table[e, c + 1]
        value[near] = (1 - t) * low + t * high
        return value


@dataclass(frozen=True, eq=False)
class Scattering:
    """The operator as near pairs, and far cells.

    Attributes:
        near: (K, K).
        far: (K, C), from cells.
        cells: (C, K), sums over the points of cells by area.
        scale: of light that enters, and of light that leaves, (K,).
    """

    near: scipy.sparse.csr_array
    far: scipy.sparse.csr_array
    cells: scipy.sparse.csr_array
    scale: FloatArray

    def __call__(self, irradiance: FloatArray) -> FloatArray:
        """Exit radiance (K, n²) of irradiance over π (K, n²)."""
        entering = self.scale[:, None] * irradiance
        leaving = self.near @ entering + self.far @ (self.cells @ entering)
        return np.asarray(self.scale[:, None] * leaving)

    def limited(self) -> Scattering:
        """The same where no place sends on more than all of the light that there is."""
        held = self
        for _ in range(ROUNDS):
            sums = held(np.ones((len(self.scale), 1)))[:, 0]
            if sums.max() <= 1.0:
                return held
            held = dataclasses.replace(held, scale=held.scale / np.sqrt(np.maximum(sums, 1.0)))
        most = held(np.ones((len(self.scale), 1))).max()
        return dataclasses.replace(held, scale=held.scale / math.sqrt(max(most, 1.0)))


def radii_of(areas: FloatArray) -> FloatArray:
    """Of discs with these areas."""
    return np.sqrt(areas / math.pi)


def exit_matrix(
    positions: FloatArray,
    areas: FloatArray,
    medium: Medium,
    shifts: FloatArray,
) -> FloatArray:
    """Slow and obvious: the dense operator (K, K), no cells, no end to its reach, no limit.

    Args:
        positions: of what light enters, (K, 3) metres.
        areas: (K,) square metres.
        medium: what scatters.
        shifts: of the surface's copies, (N, 3) metres; zeros (1, 3) for one.
    """
    kernel = DiscKernel(medium, radii_of(areas))
    radii = radii_of(0.5 * (areas[:, None] + areas))
    total = np.zeros((len(positions), len(positions)))
    for shift in shifts:
        between = positions[:, None] - (positions + shift)[None]
        distance = np.sqrt(np.einsum("ijk,ijk->ij", between, between))
        total += kernel(distance.ravel(), radii.ravel()).reshape(distance.shape)
    return total * areas


def cell_labels(positions: FloatArray, width: float) -> IntArray:
    """The cell of every point, 0 … C − 1, (K,)."""
    place = np.floor((positions - positions.min(axis=0)) / width).astype(np.int64)
    return np.unique(place, axis=0, return_inverse=True)[1].reshape(-1)


def scattering(
    positions: FloatArray,
    areas: FloatArray,
    medium: Medium,
    period: tuple[float | None, float | None] = (None, None),
) -> Scattering:
    """The operator of points (K, 3), in metres.

    Args:
        positions: of what light enters, (K, 3).
        areas: of the points, (K,), all above 0.
        medium: what scatters.
        period: along x and y, of a surface that tiles; None where it does not.
    """
    spacing = float(np.sqrt(np.median(areas)))
    span = float(np.ptp(positions, axis=0).max())
    tiled = max([length or 0.0 for length in period])
    reach = min(medium.reach(TAIL), 2.0 * span if tiled == 0 else 4.0 * max(span, tiled))
    width = max(2.0 * spacing, reach / ACROSS)
    reach = max(reach, 2.0 * FAR * width)
    label = cell_labels(positions, width)
    count = int(label.max()) + 1
    weight = np.bincount(label, areas, count)
    share = areas / weight[label]
    sums = [np.bincount(label, share * positions[:, k], count) for k in range(3)]
    centre = np.stack(sums, axis=1).astype(np.float64)
    cells = scipy.sparse.csr_array(
        (areas, (label, np.arange(len(label)))), shape=(count, len(label))
    )
    kernel = DiscKernel(medium, radii_of(areas))
    pairs = Pairs(positions, areas, label, centre, kernel, reach, width, shifts_of(period, reach))
    near, far = [], []
    for rows in pairs.blocks():
        one, other = pairs.of(rows)
        near.append(one)
        far.append(other)
    return Scattering(
        scipy.sparse.csr_array(scipy.sparse.vstack(near)),
        scipy.sparse.csr_array(scipy.sparse.vstack(far)),
        cells,
        np.ones(len(positions)),
    ).limited()


def shifts_of(period: tuple[float | None, float | None], reach: float) -> FloatArray:
    """Where copies of a tile lie that may be within reach, (N, 3) metres."""
    lines = []
    for length in period:
        most = 0 if length is None else math.ceil(reach / length) + 1
        lines.append(np.arange(-most, most + 1) * (length or 0.0))
    x, y = np.meshgrid(*lines)
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


class Pairs:
    """Pairs within reach of blocks of places: near points, and far cells.

    Args:
        positions: of what light enters, (K, 3).
        areas: (K,).
        label: the cell of each, (K,).
        centre: of the cells, (C, 3).
        kernel: R_d.
        reach: of the pairs that count, metres.
        width: of a cell, metres.
        shifts: of the surface's copies, (N, 3) metres.
    """

    def __init__(
        self,
        positions: FloatArray,
        areas: FloatArray,
        label: IntArray,
        centre: FloatArray,
        kernel: DiscKernel,
        reach: float,
        width: float,
        shifts: FloatArray,
    ) -> None:
        self.positions, self.areas, self.centre, self.shifts = positions, areas, centre, shifts
        self.kernel, self.reach, self.width = kernel, reach, width
        copies = (centre[None] + shifts[:, None]).reshape(-1, 3)
        low, high = positions.min(axis=0) - 2.0 * reach, positions.max(axis=0) + 2.0 * reach
        self.copy = np.flatnonzero(((copies >= low) & (copies <= high)).all(axis=1))
        self.tree = KDTree(copies[self.copy])
        self.order = np.argsort(label, kind="stable")
        self.start = np.searchsorted(label[self.order], np.arange(len(centre) + 1))

    def blocks(self) -> Iterator[slice]:
        """Blocks of points, few enough for their pairs."""
        places = self.positions
        some = places[:: max(1, len(places) // 64)]
        found = self.tree.query_ball_point(some, self.reach, return_length=True)
        near = self.tree.query_ball_point(some, FAR * self.width, return_length=True)
        points = len(self.positions) / len(self.centre)
        each = float(np.max(found + points * near))
        step = max(1, int(BLOCK_PAIRS / max(each, 1.0)))
        for start in range(0, len(places), step):
            yield slice(start, min(start + step, len(places)))

    def of(self, part: slice) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
        """Near (B, K) and far (B, C) entries of a block of points."""
        places = self.positions[part]
        found = KDTree(places).sparse_distance_matrix(self.tree, self.reach, output_type="ndarray")
        row, copy = found["i"], self.copy[found["j"]]
        shift, cell = np.divmod(copy, len(self.centre))
        close = found["v"] < FAR * self.width
        away = self.kernel.medium.profile(found["v"][~close])
        far = scipy.sparse.csr_array(
            (away.astype(np.float32), (row[~close], cell[~close])),
            shape=(len(places), len(self.centre)),
        )
        row, shift, cell = row[close], shift[close], cell[close]
        first, last = self.start[cell], self.start[cell + 1]
        size = last - first
        row, shift = np.repeat(row, size), np.repeat(shift, size)
        within = np.arange(size.sum()) - np.repeat(np.cumsum(size) - size, size)
        point = self.order[np.repeat(first, size) + within]
        between = places[row] - self.positions[point] - self.shifts[shift]
        distance = np.sqrt(np.einsum("ij,ij->i", between, between))
        areas = self.areas[point]
        both = 0.5 * (areas + self.areas[part][row])
        value = self.kernel(distance, radii_of(both)) * areas
        near = scipy.sparse.csr_array(
            (value.astype(np.float32), (row, point)), shape=(len(places), len(self.positions))
        )
        return near, far
