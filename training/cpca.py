"""Clustered principal components: points in clusters, each with a subspace of its own.

"Iterative CPCA" of Sloan, Hall, Hart and Snyder 2003 ("Clustered principal components for
precomputed radiance transfer"), after Kambhatla and Leen 1997: every point joins the cluster whose
subspace leaves least of it, every cluster takes the leading eigenvectors of its points, in turn.

A point is S vectors of D numbers that share a subspace: one vector of transfer; of a receiver's
visibility its coefficients, each a course over poses. What is particular to visibility, clusters of
equal size, is an ``assign`` of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import Each, one_by_one

__all__ = [
    "Components",
    "CpcaConfig",
    "Subspaces",
    "alternate",
    "cluster_points",
    "clustered_components",
    "lost",
    "principal",
    "subspaces",
]

BLOCK = 1 << 21  # numbers of products at a time
POINTS = 1024  # of a sketch at a time
ROUNDING = 1e-13  # eigenvalues below this share of the largest are float64's, not the points'
SKETCH = 12  # numbers that stand for a point while clusters are sought, for each term
GAIN = 1e-3  # rounds go on while they bring this share of the error


@dataclass(frozen=True, eq=False)
class Subspaces:
    """Of every cluster a subspace of D dimensions.

    Attributes:
        values: eigenvalues, the squares that each axis holds, descending, (C, N).
        axes: orthonormal rows, (C, N, D); zero where a cluster has fewer than N.
        mean: that the subspace goes through, (C, D); None where that is the origin.
    """

    values: torch.Tensor
    axes: torch.Tensor
    mean: torch.Tensor | None = None

    def kept(self, counts: IntArray) -> Subspaces:
        """The same with ``counts`` (C,) axes."""
        most = int(counts.max(initial=0))
        inside = torch.arange(most) < torch.as_tensor(counts)[:, None]
        axes = self.axes[:, :most] * inside[..., None]
        return Subspaces(self.values[:, :most] * inside, axes, self.mean)


def principal(rows: torch.Tensor, most: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Leading eigenvalues (R,) of rowsᵀ · rows and its eigenvectors (R, D), R ≤ ``most``.

    Of the smaller of both Gram matrices, in float64. What rounding alone would make is left out.

    Args:
        rows: (K, D).
        most: axes wanted; there are no more than the rank.
    """
    wide = len(rows) < rows.shape[1]
    exact = rows.double()
    values, vectors = torch.linalg.eigh(exact @ exact.T if wide else exact.T @ exact)
    values, vectors = values.flip(0)[:most], vectors.flip(1)[:, :most]
    some = int((values > ROUNDING * len(vectors) * values[:1].clamp(min=0.0)).sum())
    values, vectors = values[:some], vectors[:, :some]
    axes = (exact.T @ vectors / values.sqrt() if wide else vectors).T
    return values.to(rows.dtype), axes.to(rows.dtype)


def subspaces(
    signal: torch.Tensor,
    label: torch.Tensor,
    clusters: int,
    most: int,
    affine: bool = False,
    each: Each = one_by_one,
) -> Subspaces:
    """The best subspace of every cluster; of an empty one nothing.

    Args:
        signal: points (V, S, D).
        label: the cluster of each, (V,).
        clusters: C.
        most: axes N of a cluster.
        affine: through the mean instead of the origin.
        each: goes through clusters.
    """
    width = signal.shape[2]
    most = min(most, width)
    values = torch.zeros(clusters, most, dtype=signal.dtype)
    axes = torch.zeros(clusters, most, width, dtype=signal.dtype)
    mean = torch.zeros(clusters, width, dtype=signal.dtype) if affine else None
    order = torch.argsort(label, stable=True)
    sizes = torch.bincount(label, minlength=clusters).tolist()

    def one(piece: tuple[int, torch.Tensor]) -> None:
        cluster, chosen = piece
        rows = signal[chosen].reshape(-1, width)
        if mean is not None and len(rows):
            mean[cluster] = rows.mean(dim=0)
            rows = rows - mean[cluster]
        if most and len(rows):
            found = principal(rows, most)
            values[cluster, : len(found[0])], axes[cluster, : len(found[0])] = found

    for _ in each(one, enumerate(torch.split(order, sizes))):
        pass
    return Subspaces(values, axes, mean)


def lost(signal: torch.Tensor, found: Subspaces, each: Each = one_by_one) -> torch.Tensor:
    """What each cluster's subspace leaves of each point (V, S, D), squared, (V, C).

    ``each`` goes through blocks of points.
    """
    clusters, terms, width = found.axes.shape
    flat = found.axes.reshape(-1, width)
    step = max(1, BLOCK // max(1, signal.shape[1] * clusters * max(terms, 1)))

    def one(own: torch.Tensor) -> torch.Tensor:
        left = torch.square(own).sum(dim=(1, 2))[:, None].expand(-1, clusters)
        held = (own @ flat.T).reshape(*own.shape[:2], clusters, terms)
        if found.mean is not None:
            left = left - 2.0 * own.sum(dim=1) @ found.mean.T
            left = left + own.shape[1] * torch.square(found.mean).sum(dim=1)
            held = held - (found.axes @ found.mean[..., None])[..., 0]
        return left - torch.square(held).sum(dim=(1, 3))

    return torch.cat(list(each(one, torch.split(signal, step))))


def alternate(
    signal: torch.Tensor,
    label: torch.Tensor,
    fit: Callable[[torch.Tensor], Subspaces],
    assign: Callable[[torch.Tensor], torch.Tensor],
    rounds: int,
    gain: float = 0.0,
    each: Each = one_by_one,
) -> torch.Tensor:
    """Clusters (V,) after rounds of subspaces and assignment; those that lose least.

    Args:
        signal: points (V, S, D).
        label: clusters to start from, (V,).
        fit: subspaces of clusters.
        assign: clusters of what each subspace leaves of each point, (V, C).
        rounds: at most.
        gain: the share of what is lost that a round has to bring for another to follow.
        each: goes through blocks of points.
    """
    best, least = label, float("inf")
    for _ in range(rounds):
        left = lost(signal, fit(label), each)
        total = float(left.gather(1, label[:, None]).sum(dtype=torch.float64))
        if not total < least * (1.0 - gain):
            return best if total >= least else label
        best, least = label, total
        label = assign(left)
    return best


@dataclass(frozen=True)
class CpcaConfig:
    """How points are put into clusters.

    Attributes:
        clusters: C; where there are fewer points, as many as points.
        terms: axes n of a cluster.
        affine: subspaces go through the mean of their points instead of the origin.
        rounds: of assignment and subspaces at most, for each number of terms on the way to n.
        seed: of the clusters to start from.
    """

    clusters: int
    terms: int = 16
    affine: bool = False
    rounds: int = 12
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that make no clusters."""
        if self.clusters < 1 or self.terms < 0 or self.rounds < 1:
            raise ValueError("at least one cluster and one round are needed, and 0 terms")


@dataclass(frozen=True, eq=False)
class Components:
    """Points (V, D) as sums of their cluster's components.

    Attributes:
        label: the cluster of each point, (V,) int64; −1 where a point is zero.
        axes: (C, N, D) float32, orthonormal rows; zero where a cluster has fewer than N.
        values: squares that each axis holds, descending, (C, N) float32.
        mean: (C, D) float32; None of linear ones.
        weights: (V, N) float32, point = mean + weights · axes, nearly.
        energy: Σ ‖point‖².
        error: Σ ‖difference‖² over ``energy``; 0 where all points are zero.
    """

    label: IntArray
    axes: FloatArray
    values: FloatArray
    mean: FloatArray | None
    weights: FloatArray
    energy: float
    error: float


def nearest(left: torch.Tensor) -> torch.Tensor:
    """Each point's cluster, (V,), of what each cluster leaves of each, (V, C): none is empty.

    A cluster that nobody would choose gets the point that is worst off where it is, unless it is
    there alone. There are at least as many points as clusters.
    """
    own, label = left.min(dim=1)
    sizes = torch.bincount(label, minlength=left.shape[1])
    empty = torch.nonzero(sizes == 0)[:, 0].tolist()
    worst = iter(torch.argsort(own, descending=True, stable=True).tolist() if empty else [])
    for cluster in empty:
        point = next(point for point in worst if sizes[label[point]] > 1)
        sizes[label[point]] -= 1
        label[point], sizes[cluster] = cluster, 1
    return label


def sketch(points: torch.Tensor, width: int, seed: int, each: Each = one_by_one) -> torch.Tensor:
    """Points (V, D) in ``width`` numbers: nearly their leading principal components.

    The range of a random matrix after one step of subspace iteration (Halko, Martinsson and Tropp
    2011, algorithm 4.4). ``each`` goes through blocks of points.
    """
    if min(points.shape) <= width:
        return points
    chance = torch.Generator().manual_seed(seed)
    guess = torch.randn(points.shape[1], width, generator=chance, dtype=points.dtype)
    blocks = torch.split(points, POINTS)
    spread = torch.zeros_like(guess)
    for part in each(lambda own: own.T @ (own @ guess), blocks):
        spread += part
    basis, _ = torch.linalg.qr(spread)
    return torch.cat(list(each(lambda own: own @ basis, blocks)))


def scattered(points: torch.Tensor, count: int, seed: int) -> torch.Tensor:
    """Which points (V, D) are far apart, (count,): k-means++ (Arthur and Vassilvitskii 2007).

    Each next one by chance, by the square of its distance from the nearest that is taken.
    """
    chance = torch.Generator().manual_seed(seed)
    taken = torch.randint(len(points), (1,), generator=chance)
    square = torch.square(points).sum(dim=1)
    near = torch.full_like(square, float("inf"))
    while len(taken) < count:
        last = points[taken[-1]]
        near = torch.minimum(near, (square - 2.0 * points @ last + last @ last).clamp(min=0.0))
        near[taken] = 0.0
        share = near.double() if near.any() else torch.ones(len(points), dtype=torch.float64)
        share[taken] = 0.0
        ends = torch.cumsum(share, dim=0)
        draw = torch.rand(1, generator=chance, dtype=torch.float64) * ends[-1]
        taken = torch.cat(
            [taken, torch.searchsorted(ends, draw, right=True).clamp(max=len(points) - 1)]
        )
    return taken


def cluster_points(
    points: torch.Tensor, config: CpcaConfig, each: Each = one_by_one
) -> torch.Tensor:
    """The cluster of each point (V, D), (V,): none of the clusters is empty.

    From k-means, clusters of a mean and no axis, the number of axes is doubled until it is n, so
    that early rounds tell apart what is far apart. All of it happens in a sketch of the points: an
    error in it costs a point the second best cluster, and nothing of what is kept of the point.
    ``each`` goes through clusters and blocks of points.
    """
    clusters = min(config.clusters, len(points))
    if clusters < 2:
        return torch.zeros(len(points), dtype=torch.int64)
    signal = sketch(points, SKETCH * max(1, config.terms), config.seed, each)
    centres = signal[scattered(signal, clusters, config.seed)]
    none = torch.zeros(clusters, 0, dtype=points.dtype)
    start = Subspaces(none, none[..., None].expand(-1, -1, signal.shape[1]), centres)
    signal = signal[:, None]
    label = nearest(lost(signal, start, each))
    for terms in steps(config.terms):
        affine = config.affine or terms == 0

        def fit(label: torch.Tensor, terms: int = terms, affine: bool = affine) -> Subspaces:
            return subspaces(signal, label, clusters, terms, affine, each)

        label = alternate(signal, label, fit, nearest, config.rounds, GAIN, each)
    return label


def steps(terms: int) -> list[int]:
    """0, 1, 2, 4 and so on, and the last number itself."""
    return [0, *(1 << k for k in range(terms.bit_length()) if 1 << k < terms), *[terms][:terms]]


def clustered_components(
    points: FloatArray, config: CpcaConfig, each: Each = one_by_one
) -> Components:
    """Clusters of points (V, D) float32 and their components; ``each`` goes through pieces.

    Points that are zero are in no cluster. Axes, weights and error are those of the points
    themselves, whatever was sketched on the way.

    Raises:
        ValueError: points are not finite.
    """
    if not np.isfinite(points).all():
        raise ValueError("points hold values that are not finite")
    label = np.full(len(points), -1, dtype=np.int64)
    some = np.flatnonzero(points.any(axis=1))
    own = torch.as_tensor(np.ascontiguousarray(points[some], dtype=np.float32))
    clusters = min(config.clusters, len(some))
    within = cluster_points(own, config, each)
    found = subspaces(own[:, None], within, clusters, config.terms, config.affine, each)
    label[some] = within.numpy()
    weights = np.zeros((len(points), found.axes.shape[1]), dtype=np.float32)

    def one(cluster: int) -> float:
        chosen = torch.nonzero(within == cluster)[:, 0]
        rows = own[chosen] if found.mean is None else own[chosen] - found.mean[cluster]
        held = rows @ found.axes[cluster].T
        weights[some[chosen.numpy()]] = held.numpy()
        rows = rows - held @ found.axes[cluster]
        return float(torch.square(rows).sum(dtype=torch.float64))

    error = sum(each(one, range(clusters)), 0.0)
    energy = float(torch.square(own).sum(dtype=torch.float64))
    return Components(
        label,
        found.axes.numpy(),
        found.values.numpy(),
        None if found.mean is None else found.mean.numpy(),
        weights,
        energy,
        error / energy if energy else 0.0,
    )
