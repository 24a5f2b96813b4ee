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

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment
from prtnet.arrays import FloatArray, IntArray
from prtnet.console import Report, silent
from prtnet.cores import Each, one_by_one
from prtnet.haar import haar, unhaar
from prtnet.sparse_columns import encode
from prtnet.transfer import Surface
from training.cpca import Components, CpcaConfig, clustered_components

__all__ = [
    "Clustered",
    "CompressConfig",
    "Losses",
    "Stages",
    "clustered",
    "compress",
    "compressed",
    "fitted",
    "sparse_wavelets",
]

MOST = 32767  # what a number of 16 bits holds, on either side
TURNS = 60  # of representatives towards their large numbers; ten fewer cost one in a hundred bytes
TURNED = 8  # clusters at a time
HALVINGS = 32
SPARE = 0.1  # of what clusters lose, at least, is left for numbers that are left out


@dataclass(frozen=True)
class CompressConfig:
    """How much is kept.

    Attributes:
        terms: representatives n of a cluster.
        points_per_cluster: vertices that share them, on average.
        error: Σ‖M̃ − M‖² / Σ‖M‖² of all segments together, if clusters leave room: numbers are
            left out until it is reached.
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


@dataclass(frozen=True, eq=False)
class Clustered:
    """The clusters of a segment, and exact representatives.

    Attributes:
        vertices: those that are not zero, cluster after cluster, (K,) int32.
        starts: of each cluster's run, (C + 1,) int32.
        wavelets: representatives times the roots of their eigenvalues, in Haar wavelets, (C, N, D).
        energy: Σ‖M‖².
        lost: what is left of that without the representatives.
    """

    vertices: IntArray
    starts: IntArray
    wavelets: FloatArray
    energy: float
    lost: float


def compress(
    segments: Callable[[], Iterable[FloatArray]],
    surface: Surface,
    view: FloatArray,
    size: int,
    config: CompressConfig,
    told: Mapping[str, Any] | None = None,
    report: Report = silent,
    each: Each = one_by_one,
) -> AllFrequencyField:
    """The field of the raw transfer of a surface.

    Args:
        segments: makes the raw transfer of each of the 24 in order, (P, m, (n/2)²) float32. It is
            asked twice, for clusters and for weights, and one segment is held at a time.
        surface: P vertices.
        view: view factors (m, S, 3).
        size: texels n a side of a face of the cube map.
        config: how much is kept.
        told: facts for the metadata, beside ``squared_error`` by stage and of every segment.
        report: of progress.
        each: goes through clusters and blocks of points.

    Raises:
        ValueError: there are not 24 segments, or their arrays do not fit the surface.
    """
    shape = (len(surface), len(view), (size // 2) ** 2)

    def clusters() -> Iterator[Clustered]:
        for raw in segments():
            if raw.shape != shape:
                raise ValueError(f"a segment has shape {raw.shape}, expected {shape}")
            yield clustered(raw, config, each)
            del raw  # before the next is made

    def weights(
        found: Sequence[Clustered], kept: Sequence[FloatArray]
    ) -> Iterator[tuple[Segment, float]]:
        for raw, one, own in zip(segments(), found, kept, strict=True):
            yield fitted(raw, one, own, each)
            del raw

    return compressed((clusters, weights), surface, view, size, config, told, report, each)


Stages = tuple[
    Callable[[], Iterable[Clustered]],
    Callable[[Sequence[Clustered], Sequence[FloatArray]], Iterable[tuple[Segment, float]]],
]
"""What makes clusters, and what fits segments to them and to representatives that are kept."""


def compressed(
    stages: Stages,
    surface: Surface,
    view: FloatArray,
    size: int,
    config: CompressConfig,
    told: Mapping[str, Any] | None = None,
    report: Report = silent,
    each: Each = one_by_one,
) -> AllFrequencyField:
    """As :func:`compress`, wherever ``stages`` cluster and fit the 24 segments in order."""
    clusters, weights = stages
    found = []
    for number, cluster in enumerate(clusters(), 1):
        found.append(cluster)
        report("clusters of segments", number, SEGMENTS)
    kept, left = sparse_wavelets(found, config.error, each)
    parts, losses = [], []
    for number, (segment, missed) in enumerate(weights(found, kept)):
        one = found[number]
        parts.append(segment)
        losses.append(Losses(one.energy, one.lost, one.lost + left[number], missed))
        report("weights of segments", number + 1, SEGMENTS)
    facts = {
        **(told or {}),
        "terms": config.terms,
        "points_per_cluster": config.points_per_cluster,
        "squared_error": sum(losses, Losses()).errors(),
        "squared_error_of_segments": [one.errors()["stored"] for one in losses],
    }
    return AllFrequencyField(surface, tuple(parts), view, size, facts)


def clustered(raw: FloatArray, config: CompressConfig, each: Each = one_by_one) -> Clustered:
    """The clusters of a segment (P, m, (n/2)²) and their exact representatives."""
    points = raw.reshape(len(raw), -1)
    reached = int(points.any(axis=1).sum())
    many = config.clusters(reached)
    how = CpcaConfig(many, config.terms, rounds=config.rounds, seed=config.seed)
    found = clustered_components(points, how, each)
    order = np.argsort(found.label, kind="stable")[len(raw) - reached :]
    sizes = np.bincount(found.label[order], minlength=len(found.axes))
    return Clustered(
        order.astype(np.int32),
        np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32),
        scaled_wavelets(found, raw.shape[1:]),
        found.energy,
        found.error * found.energy,
    )


def sparse_wavelets(
    found: Sequence[Clustered], error: float, each: Each = one_by_one
) -> tuple[list[FloatArray], list[float]]:
    """Representatives of all segments without their smallest numbers, and what goes with them.

    One limit holds for all: the last number left out matters as much in every segment, so no
    choice of as many numbers would lose less.

    Args:
        found: clusters of segments.
        error: see :class:`CompressConfig`.
        each: goes through clusters, some at a time.
    """
    energy, lost = sum(one.energy for one in found), sum(one.lost for one in found)
    room = max(error * energy - lost, SPARE * lost)
    wavelets = [one.wavelets for one in found]
    least = limit(wavelets, room)
    for number, one in enumerate(wavelets):
        pieces = np.split(one, range(TURNED, len(one), TURNED))
        wavelets[number] = np.concatenate(list(each(lambda own: turned(own, least), pieces)))
    least = limit(wavelets, room)
    left = [below(one, least) for one in wavelets]
    for number, one in enumerate(wavelets):
        wavelets[number] = np.where(np.abs(one) > least, one, np.float32(0.0))
    return wavelets, left


def scaled_wavelets(found: Components, shape: tuple[int, ...]) -> FloatArray:
    """Representatives times the roots of their eigenvalues, in Haar wavelets, (C, N, m · h²)."""
    clusters, terms, width = found.axes.shape
    side = round(shape[1] ** 0.5)
    blocks = found.axes * np.sqrt(found.values)[..., None]
    blocks = haar(blocks.reshape(clusters, terms, shape[0], side, side))
    return blocks.reshape(clusters, terms, width)


def turned(wavelets: FloatArray, least: float) -> FloatArray:
    """Other representatives (C, N, D) of the same sums, more of whose numbers are small.

    Their weights' columns are orthonormal, and stay so when rows of a cluster are turned by an
    orthogonal matrix and weights with them. In turn numbers up to ``least`` become 0, and rows are
    turned as near to that as can be (orthogonal Procrustes): neither ever takes the two further
    apart, as in learning an orthonormal dictionary.
    """
    if wavelets.size == 0:
        return wavelets
    found = torch.as_tensor(wavelets)
    for _ in range(TURNS):
        kept = torch.where(found.abs() > least, found, 0.0)
        left, _, right = torch.linalg.svd(kept @ found.mT)
        found = left @ right @ found
    return np.asarray(found.numpy())


def below(wavelets: FloatArray, least: float) -> float:
    """The sum of the squares of numbers up to ``least``."""
    small = wavelets[np.abs(wavelets) <= least]
    return float(np.square(small, dtype=np.float64).sum())


def limit(wavelets: Sequence[FloatArray], room: float) -> float:
    """How large numbers are whose squares, and those of all smaller ones, come to ``room``.

    By bisection of the exponent: there are tens of millions of them.
    """
    largest = max((float(np.abs(one).max(initial=0.0)) for one in wavelets), default=0.0)
    if sum(below(one, largest) for one in wavelets) <= room:
        return largest
    low, high = -60.0, 0.0  # powers of two, of the largest
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        least = largest * 2.0**middle
        fits = sum(below(one, least) for one in wavelets) <= room
        low, high = (middle, high) if fits else (low, middle)
    return largest * 2.0**low


def fitted(
    raw: FloatArray, found: Clustered, wavelets: FloatArray, each: Each = one_by_one
) -> tuple[Segment, float]:
    """A segment of representatives and the weights of 16 bits that fit them, and Σ‖M̃ − M‖².

    Every representative is stored as shares of its largest number, so that none saturates however
    different they are.

    Args:
        raw: (P, m, h²).
        found: its clusters.
        wavelets: representatives (C, N, m · h²) without small numbers.
        each: goes through clusters.
    """
    clusters, terms, width = wavelets.shape
    largest = np.abs(wavelets).max(axis=2, initial=0.0, keepdims=True)
    whole = np.rint(wavelets * (MOST / np.where(largest > 0.0, largest, 1.0))).astype(np.int16)
    side = round(raw.shape[2] ** 0.5)
    blocks = whole.astype(np.float32).reshape(clusters, terms, raw.shape[1], side, side)
    rows = (unhaar(blocks) / np.float32(MOST)).reshape(clusters, terms, width)
    points = raw.reshape(len(raw), -1)
    weights = np.zeros((len(found.vertices), terms), dtype=np.int16)
    scale = np.zeros((clusters, terms), dtype=np.float32)

    def one(cluster: int) -> float:
        run = slice(found.starts[cluster], found.starts[cluster + 1])
        own = points[found.vertices[run]]
        weights[run], scale[cluster] = rounded(best_weights(own, rows[cluster]))
        own = own - (weights[run] * scale[cluster]) @ rows[cluster]
        return float(np.square(own, dtype=np.float64).sum())

    lost = sum(each(one, range(clusters)), 0.0)
    sparse = encode(whole.reshape(clusters * terms, width))
    return Segment(found.vertices, found.starts, weights, scale, sparse, 1.0 / MOST), lost


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
