"""Compression of all-frequency transfer, a segment of light after another.

"All-Frequency" (Liu, Sloan, Shum and Snyder 2004) sections 4 and 5: vertices that a segment does
not reach are left out, the others are put into clusters by their principal components, the
representatives are taken to Haar wavelets, rounded to 16 bits with small numbers left out, and
stored as sparse columns; the weights take 16 bits.

Beyond the paper, three things keep errors small. Representatives are held against each other by
how much a number of theirs matters to their cluster: a representative times the root of its
eigenvalue has weights whose squares sum to 1, so leaving out its number x adds x² to what all
vertices together lose, whichever representative it is. The numbers left out are the smallest that
fill the error asked for; before, representatives are turned within their cluster, which changes no
sum of them, until more of their numbers are small. And weights are fitted anew, to the
representatives as they are stored.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment
from prtnet.arrays import FloatArray, IntArray
from prtnet.console import Report, silent
from prtnet.haar import haar, unhaar
from prtnet.sparse_columns import encode
from prtnet.transfer import Surface
from training.cpca import Components, CpcaConfig, clustered_components

__all__ = ["CompressConfig", "Losses", "clustered", "compress", "compressed", "stored"]

MOST = 32767  # what a number of 16 bits holds, on either side
TURNS = 60  # of representatives towards their large numbers; ten fewer cost one in a hundred bytes
SPARE = 0.1  # of what clusters lose, at least, is left for numbers that are left out


@dataclass(frozen=True)
class CompressConfig:
    """How much is kept.

    Attributes:
        terms: representatives n of a cluster.
        points_per_cluster: vertices that share them, on average.
        error: Σ‖M̃ − M‖² / Σ‖M‖² of every segment, if its clusters leave room: numbers are left out
            until it is reached.
        rounds: of clusters, for each number of terms on the way.
        seed: of the clusters.
    """

    terms: int = 16
    points_per_cluster: int = 200
    error: float = 0.002
    rounds: int = 12
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        if self.terms < 1 or self.points_per_cluster < 1 or not 0.0 <= self.error < 1.0:
            raise ValueError("terms and points of a cluster start at 1, errors are from 0 to 1")

    def clusters(self, points: int) -> int:
        """How many there are of so many points."""
        return max(1, round(points / self.points_per_cluster))


@dataclass(frozen=True)
class Losses:
    """What became of the squares of a segment, or of all of them.

    Attributes:
        energy: Σ‖M‖².
        clustered: what clusters of n exact representatives lose.
        thresholded: that, and the numbers that are left out.
        stored: Σ‖M̃ − M‖², with all rounded and weights fitted to that.
    """

    energy: float = 0.0
    clustered: float = 0.0
    thresholded: float = 0.0
    stored: float = 0.0

    def __add__(self, other: Losses) -> Losses:
        names = vars(self)
        return Losses(**{name: getattr(self, name) + getattr(other, name) for name in names})

    def errors(self) -> dict[str, float]:
        """Shares of the energy, by stage."""
        names = ("clustered", "thresholded", "stored")
        return {name: getattr(self, name) / (self.energy or 1.0) for name in names}


def compress(
    segments: Iterable[FloatArray],
    surface: Surface,
    view: FloatArray,
    size: int,
    config: CompressConfig,
    told: Mapping[str, Any] | None = None,
    report: Report = silent,
) -> AllFrequencyField:
    """The field of the raw transfer of a surface.

    Args:
        segments: of each of the 24 in order (P, m, (n/2)²) float32; only one is held.
        surface: P vertices.
        view: view factors (m, S, 3).
        size: texels n a side of a face of the cube map.
        config: how much is kept.
        told: facts for the metadata, beside ``squared_error`` by stage and of every segment.
        report: of progress.

    Raises:
        ValueError: there are not 24 segments, or their arrays do not fit the surface.
    """
    shape = (len(surface), len(view), (size // 2) ** 2)
    found, losses = [], []
    for number, raw in enumerate(segments, 1):
        if raw.shape != shape:
            raise ValueError(f"a segment has shape {raw.shape}, expected {shape}")
        segment, lost = compressed(raw, config)
        found.append(segment)
        losses.append(lost)
        error = lost.errors()["stored"]
        report("compressed segments", number, SEGMENTS, f"error {100 * error:.2f} %")
        del raw  # before the next is made
    whole = sum(losses, Losses())
    facts = {
        **(told or {}),
        "terms": config.terms,
        "points_per_cluster": config.points_per_cluster,
        "squared_error": whole.errors(),
        "squared_error_of_segments": [one.errors()["stored"] for one in losses],
    }
    return AllFrequencyField(surface, tuple(found), view, size, facts)


def compressed(raw: FloatArray, config: CompressConfig) -> tuple[Segment, Losses]:
    """A segment (P, m, (n/2)²) as it is stored, and what that loses."""
    return stored(raw, clustered(raw, config), config.error)


def clustered(raw: FloatArray, config: CompressConfig) -> Components:
    """The clusters of a segment and their exact representatives."""
    points = raw.reshape(len(raw), -1)
    many = config.clusters(int(points.any(axis=1).sum()))
    how = CpcaConfig(many, config.terms, rounds=config.rounds, seed=config.seed)
    return clustered_components(points, how)


def stored(raw: FloatArray, found: Components, error: float) -> tuple[Segment, Losses]:
    """A segment as it is stored, and what that loses.

    Args:
        raw: (P, m, (n/2)²).
        found: its clusters.
        error: to be reached, see :class:`CompressConfig`.
    """
    reached = int((found.label >= 0).sum())
    order = np.argsort(found.label, kind="stable")[len(raw) - reached :]
    sizes = np.bincount(found.label[order], minlength=len(found.axes))
    starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    lost = found.error * found.energy
    room = max(error * found.energy - lost, SPARE * lost)
    wavelets = scaled_wavelets(found, raw.shape[1:])
    kept, left = thresholded(turned(wavelets, room), room)
    points, shape = raw.reshape(len(raw), -1), raw.shape[1:]
    segment, missed = fitted(points, order.astype(np.int32), starts, kept, shape)
    return segment, Losses(found.energy, lost, lost + left, missed)


def scaled_wavelets(found: Components, shape: tuple[int, ...]) -> FloatArray:
    """Representatives times the roots of their eigenvalues, in Haar wavelets, (C, N, m · h²)."""
    clusters, terms, width = found.axes.shape
    side = round(shape[1] ** 0.5)
    blocks = found.axes * np.sqrt(found.values)[..., None]
    blocks = haar(blocks.reshape(clusters, terms, shape[0], side, side))
    return blocks.reshape(clusters, terms, width)


def turned(wavelets: FloatArray, room: float) -> FloatArray:
    """Other representatives (C, N, D) of the same sums, more of whose numbers are small.

    Their weights' columns are orthonormal, and stay so when rows of a cluster are turned by an
    orthogonal matrix and weights with them. In turn numbers that would be left out become 0, and
    rows are turned as near to that as can be (orthogonal Procrustes): neither ever takes the two
    further apart, as in learning an orthonormal dictionary.

    Args:
        wavelets: representatives times the roots of their eigenvalues.
        room: what the squares of the numbers left out come to.
    """
    if wavelets.size == 0:
        return wavelets
    found = torch.as_tensor(wavelets)
    _, least = smallest(wavelets, room)
    for _ in range(TURNS):
        kept = torch.where(found.abs() > least, found, 0.0)
        left, _, right = torch.linalg.svd(kept @ found.mT)
        found = left @ right @ found
    return np.asarray(found.numpy())


def smallest(wavelets: FloatArray, room: float) -> tuple[float, float]:
    """Of the smallest numbers whose squares fit into ``room`` the sum of squares; the largest."""
    square = np.sort(np.square(wavelets, dtype=np.float64).ravel())
    total = np.cumsum(square)
    count = int(np.searchsorted(total, room, side="right"))
    if count == 0:
        return 0.0, 0.0
    return float(total[count - 1]), float(np.sqrt(square[count - 1]))


def thresholded(wavelets: FloatArray, room: float) -> tuple[FloatArray, float]:
    """The same without the smallest numbers, of squares of ``room`` together, and what is gone."""
    left, least = smallest(wavelets, room)
    return np.where(np.abs(wavelets) > least, wavelets, np.float32(0.0)), left


def fitted(
    points: FloatArray,
    order: IntArray,
    starts: IntArray,
    wavelets: FloatArray,
    shape: tuple[int, ...],
) -> tuple[Segment, float]:
    """A segment of representatives and the weights of 16 bits that fit them, and Σ‖M̃ − M‖².

    Every representative is stored as shares of its largest number, so that none saturates however
    different they are.

    Args:
        points: raw transfer (P, m · h²).
        order: vertices by cluster, (K,).
        starts: of each cluster's run.
        wavelets: representatives (C, N, m · h²).
        shape: m and h².
    """
    clusters, terms, width = wavelets.shape
    side = round(shape[1] ** 0.5)
    largest = np.abs(wavelets).max(axis=2, initial=0.0, keepdims=True)
    whole = np.rint(wavelets * (MOST / np.where(largest > 0.0, largest, 1.0))).astype(np.int16)
    rows = unhaar(whole.astype(np.float32).reshape(clusters, terms, shape[0], side, side) / MOST)
    rows = rows.reshape(clusters, terms, width)
    weights = np.zeros((len(order), terms), dtype=np.int16)
    scale = np.zeros((clusters, terms), dtype=np.float32)
    lost = 0.0
    for cluster in range(clusters):
        run = slice(starts[cluster], starts[cluster + 1])
        own = points[order[run]]
        weights[run], scale[cluster] = rounded(best_weights(own, rows[cluster]))
        own = own - (weights[run] * scale[cluster]) @ rows[cluster]
        lost += float(np.square(own, dtype=np.float64).sum())
    sparse = encode(whole.reshape(clusters * terms, width))
    return Segment(order, starts, weights, scale, sparse, 1.0 / MOST), lost


def best_weights(points: FloatArray, rows: FloatArray) -> FloatArray:
    """Weights (K, N) float64 of rows (N, D) whose sums are nearest to points (K, D)."""
    exact = rows.astype(np.float64)
    gram = exact @ exact.T
    inverse = np.linalg.pinv(gram, rcond=1e-9, hermitian=True)
    return np.asarray((points @ rows.T).astype(np.float64) @ inverse)


def rounded(weights: FloatArray) -> tuple[IntArray, FloatArray]:
    """Weights (K, N) as numbers of 16 bits, and what 1 stands for in each column, (N,) float32."""
    scale = (np.abs(weights).max(axis=0, initial=0.0) / MOST).astype(np.float32)
    safe = np.where(scale > 0.0, scale, np.float32(1.0))
    return np.clip(np.rint(weights / safe), -MOST, MOST).astype(np.int16), scale
