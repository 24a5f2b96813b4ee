"""All-frequency transfer of a still object: how every vertex answers a cube map of distant light.

"All-Frequency" (Liu, Sloan, Shum and Snyder 2004). A BRDF is a sum of m light factors times m view
factors [eq. 3]; a vertex p has a matrix M_p (m, 6 n²) from the texels of a cube map of light to the
radiance it sends, m numbers that the view factors weigh [eq. 7]. The columns fall into 24 segments,
quarters of the cube's faces. Within a segment the vertices it reaches are in clusters, and their
matrices are sums of a few representatives of their cluster [eq. 11], which are stored in the Haar
wavelets of ``prtnet.haar``, where most of their numbers are zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.limits import LARGEST
from prtnet.transfer import Surface, check_field, check_numbers

__all__ = ["SEGMENTS", "AllFrequencyField", "Segment", "SparseColumns"]

SEGMENTS = 24


@dataclass(frozen=True, eq=False)
class SparseColumns:
    """A matrix (R, D) of whole numbers of 16 bits, column by column in blocks of 256 rows.

    "All-Frequency" section 4, after Ng, Ramamoorthi and Hanrahan 2003: of a column of a block only
    what is not zero is kept, with the row within its block.

    Attributes:
        counts: how many there are in each column of each block, (⌈R / 256⌉, D) uint16.
        rows: the row of each within its block, ascending in a column, (N,) uint8.
        values: (N,) int16, none of them 0.
        shape: R and D.
    """

    counts: IntArray
    rows: IntArray
    values: IntArray
    shape: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Segment:
    """One of the 24 segments of the transfer: clusters of vertices, each with representatives.

    Of vertex ``vertices[k]`` in cluster c the matrix (m, (n/2)²) of this segment is
    Σ_i weights[k, i] · scale[c, i] · step · representatives[c · N + i], in Haar wavelets; of a
    vertex that is not among ``vertices`` it is zero.

    Attributes:
        vertices: those whom the segment's light reaches, grouped by cluster, (K,) int32.
        starts: of each cluster's run in ``vertices``, and the end of the last, (C + 1,) int32.
        weights: (K, N) int16.
        scale: of a cluster's weights, (C, N) float32; zero where a cluster has fewer than N.
        representatives: rows c · N + i; columns r · (n/2)² + the place in the segment of row r.
        step: what 1 stands for in ``representatives``.
    """

    vertices: IntArray
    starts: IntArray
    weights: IntArray
    scale: FloatArray
    representatives: SparseColumns
    step: float

    @property
    def clusters(self) -> int:
        """Clusters C; 0 where no vertex is reached."""
        return len(self.starts) - 1

    def labels(self) -> IntArray:
        """The cluster of each of ``vertices``, (K,)."""
        return np.repeat(np.arange(self.clusters), np.diff(self.starts))


@dataclass(frozen=True, eq=False)
class AllFrequencyField:
    """An object baked for light of all frequencies.

    Attributes:
        surface: K vertices.
        segments: 24 of them: face · 4 + 2 · half of its rows + half of its columns.
        view: view factors, linear RGB, (m, S, 3) float32 over the S = s² cells of
            ``prtnet.hemisphere``'s concentric map, in a vertex's frame.
        size: texels n a side of a face of the cube map.
        metadata: what was baked, and how large the errors are, as JSON can hold it.
    """

    surface: Surface
    segments: tuple[Segment, ...]
    view: FloatArray
    size: int
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError where arrays do not fit each other."""
        check(self)

    def __len__(self) -> int:
        return len(self.surface)

    @property
    def rows(self) -> int:
        """Rows m of every vertex."""
        return len(self.view)


def check(found: AllFrequencyField) -> None:
    """Raise ValueError where arrays do not fit each other, or are not finite."""
    blank = np.zeros((len(found.surface), found.rows, 1), dtype=np.float32)
    check_field({"transfer": blank}, found.surface, found.view)
    if found.size < 4 or found.size % 4:
        raise ValueError(f"faces of {found.size} texels a side have no segments")
    if len(found.segments) != SEGMENTS:
        raise ValueError(f"there are {len(found.segments)} segments, not {SEGMENTS}")
    for number, one in enumerate(found.segments):
        try:
            check_segment(one, len(found), found.rows * (found.size // 2) ** 2)
        except ValueError as error:
            raise ValueError(f"segment {number}: {error}") from error


def check_segment(one: Segment, points: int, columns: int) -> None:
    """Raise ValueError where a segment's arrays do not fit each other, or are not finite."""
    types = {"vertices": np.int32, "starts": np.int32, "weights": np.int16, "scale": np.float32}
    for name, kind in types.items():
        if getattr(one, name).dtype != kind:
            raise ValueError(f"{name} has type {getattr(one, name).dtype}")
    if one.vertices.ndim != 1:
        raise ValueError(f"vertices have shape {one.vertices.shape}")
    if one.starts.ndim != 1 or len(one.starts) < 1 or one.starts[0] != 0:
        raise ValueError("starts do not begin at 0")
    if (np.diff(one.starts) < 1).any() or one.starts[-1] != len(one.vertices):
        raise ValueError("starts leave a cluster empty, or vertices over")
    known = np.unique(one.vertices)
    if len(known) != len(one.vertices) or (len(known) and not 0 <= known[0] <= known[-1] < points):
        raise ValueError("vertices come twice, or are not there")
    if one.weights.shape != (len(one.vertices), one.scale.shape[-1]):
        raise ValueError("weights do not fit the vertices")
    if one.scale.shape[:-1] != (one.clusters,):
        raise ValueError("scale does not fit the clusters")
    check_numbers("scale", one.scale)
    if not 0.0 < one.step <= LARGEST:
        raise ValueError(f"step is {one.step}")
    if one.representatives.shape != (one.scale.size, columns):
        raise ValueError("representatives do not fit the clusters")
    check_sparse(one.representatives)


def check_sparse(one: SparseColumns) -> None:
    """Raise ValueError where the arrays of a sparse matrix do not fit each other."""
    types = {"counts": np.uint16, "rows": np.uint8, "values": np.int16}
    for name, kind in types.items():
        if getattr(one, name).dtype != kind:
            raise ValueError(f"{name} has type {getattr(one, name).dtype}")
    rows, columns = one.shape
    if one.counts.shape != (-(-rows // 256), columns):
        raise ValueError("counts do not fit the blocks")
    total = int(one.counts.sum(dtype=np.int64))
    if one.rows.shape != (total,) or one.values.shape != (total,):
        raise ValueError("counts do not fit the values")
    if total and int(one.counts.max()) > 256:
        raise ValueError("a column of a block holds more than 256 numbers")
    first = np.cumsum(one.counts, dtype=np.int64).ravel() - one.counts.ravel()
    inside = np.ones(total, dtype=bool)
    inside[first[one.counts.ravel() > 0]] = False
    if (np.diff(one.rows.astype(np.int16)) < 1)[inside[1:]].any():
        raise ValueError("rows of a column do not ascend")
    if rows % 256 and total:  # the last block is short
        short = int(one.counts[-1].sum(dtype=np.int64))
        if short and int(one.rows[total - short :].max()) >= rows % 256:
            raise ValueError("a number lies beyond the last row")
