"""Principal components: of each cluster's visibility, and of its features."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.linalg

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import in_threads

__all__ = ["OutputReduction", "each_cluster", "input_reduction", "reduce_output"]

T = TypeVar("T")
ROUNDING = 1e-12  # variance below this fraction of the signal's is float32's, not the scene's


@dataclass(frozen=True, eq=False)
class OutputReduction:
    """The kept principal components of every cluster's visibility.

    Attributes:
        mean: (C, R · n²) float32; zero in empty slots.
        basis: for each cluster its components, (latents[c], R · n²) float32.
        latents: components kept, (C,).
        targets: the training poses' latents, (C, P, L) float32; zero beyond a cluster's latents.
    """

    mean: FloatArray
    basis: list[FloatArray]
    latents: IntArray
    targets: FloatArray


def choose_counts(
    eigenvalues: FloatArray, variance: float, average: float | None, step: int
) -> IntArray:
    """Components kept in each cluster, (C,), of eigenvalues (C, P), descending.

    The largest eigenvalues of the *whole* model are kept, so that components go where the error
    is: as many as the fraction ``variance`` of all variance needs, at most ``average`` a cluster.
    Counts are then rounded to multiples of ``step``, so that few different sizes remain.
    """
    flat = np.sort(eigenvalues.ravel())[::-1]
    kept = int(np.searchsorted(np.cumsum(flat), variance * flat.sum()) + 1)
    kept = min(kept, int((flat > 0).sum()))
    if average is not None:
        kept = min(kept, int(average * len(eigenvalues)))
    if kept == 0:
        return np.zeros(len(eigenvalues), dtype=np.int64)
    counts = (eigenvalues >= flat[kept - 1]).sum(axis=1)
    rounded = np.rint(counts / step).astype(np.int64) * step
    # A cluster that varies at all keeps one component, whatever the rounding says.
    rounded = np.where((rounded == 0) & (counts > 0), np.minimum(counts, step), rounded)
    return np.minimum(rounded, (eigenvalues > 0).sum(axis=1))


def reduce_output(
    visibility: FloatArray,
    slots: IntArray,
    variance: float,
    average: float | None = None,
    step: int = 4,
) -> OutputReduction:
    """Clustered PCA of visibility (P, V, n²) over poses.

    Eigenvectors come from the Gram matrix of each cluster's poses or values, whichever are fewer;
    once all clusters' eigenvalues are known, only those kept are computed.

    Args:
        visibility: of the training poses; or as many numbers that stand for it.
        slots: receivers of each cluster, (C, R), −1 for empty.
        variance: fraction of the model's total variance to keep.
        average: at most so many components a cluster on average.
        step: component counts are multiples of it.
    """
    poses, _, bands = visibility.shape
    width = slots.shape[1] * bands
    mean = np.zeros((len(slots), width), dtype=np.float32)
    values = np.zeros((len(slots), poses))

    def deviations(cluster: int) -> tuple[FloatArray, FloatArray]:
        own = slots[cluster]
        block = visibility[:, np.maximum(own, 0)] * (own >= 0)[:, None].astype(np.float32)
        block = block.reshape(poses, width)
        mean[cluster] = block.mean(axis=0, dtype=np.float64)
        block = block - mean[cluster]
        gram = block @ block.T if poses <= width else block.T @ block
        return block, gram.astype(np.float64) / poses

    energy = float(np.mean(np.square(visibility[:: max(1, poses // 16)]), dtype=np.float64))
    noise = ROUNDING * energy * width

    def squares(cluster: int) -> None:
        _, gram = deviations(cluster)
        eigenvalues = np.linalg.eigvalsh(gram)
        values[cluster, : len(gram)] = np.where(eigenvalues > noise, eigenvalues, 0.0)[::-1]
        values[cluster, poses - 1 :] = 0.0  # deviations from a mean have one rank less

    each_cluster(squares, len(slots))
    latents = choose_counts(values, variance, average, step)
    targets = np.zeros((len(slots), poses, int(latents.max(initial=0))), dtype=np.float32)

    def components(cluster: int) -> FloatArray:
        block, gram = deviations(cluster)
        count = latents[cluster]
        rows = np.zeros((0, width))
        if count > 0:
            last = len(gram) - 1
            _, vectors = scipy.linalg.eigh(gram, subset_by_index=(last + 1 - count, last))
            rows = vectors.T[::-1]
            if poses <= width:  # components = Vᵀ X / √(P λ): orthonormal rows
                scale = 1.0 / np.sqrt(poses * np.maximum(values[cluster, :count, None], 1e-300))
                rows = (rows @ block) * scale
        found = rows.astype(np.float32)
        targets[cluster, :, :count] = block @ found.T
        return found

    return OutputReduction(mean, each_cluster(components, len(slots)), latents, targets)


def each_cluster(work: Callable[[int], T], clusters: int) -> list[T]:
    """What comes of every cluster; the number of threads has no say."""
    with in_threads() as each:
        return list(each(work, range(clusters)))


def input_reduction(
    features: FloatArray, variance: float, most: int
) -> tuple[FloatArray, FloatArray]:
    """Mean (C, F) and scaled basis (C, F, K) of features (P, C, F): x → (x − mean) · basis.

    All clusters keep as many components as the neediest one, at most ``most``. The basis is
    divided by the root mean variance of the kept components: inputs have about unit scale, and
    components keep their relative size.
    """
    table = np.swapaxes(features, 0, 1)
    table = table.astype(np.float64)
    mean = table.mean(axis=1)
    centred = table - mean[:, None]

    def decomposed(cluster: int) -> tuple[FloatArray, FloatArray]:
        return np.linalg.svd(centred[cluster], full_matrices=False)[1:]

    found = each_cluster(decomposed, len(centred))
    singular, rows = (np.stack(part) for part in zip(*found, strict=True))
    eigenvalues, vectors = singular**2 / table.shape[1], np.swapaxes(rows, 1, 2)
    total = eigenvalues.sum(axis=1, keepdims=True)
    reached = np.cumsum(eigenvalues, axis=1) >= variance * total - 1e-15
    needed = np.argmax(reached, axis=1) + 1
    count = int(min(most, needed.max(), vectors.shape[2]))
    kept = eigenvalues[:, :count].mean(axis=1)
    scale = 1.0 / np.sqrt(np.where(kept > 1e-20, kept, np.inf))  # a constant input gives zero
    basis = vectors[:, :, :count] * scale[:, None, None]
    return mean.astype(np.float32), basis.astype(np.float32)
