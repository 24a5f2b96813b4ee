"""All-frequency transfer fast enough for every frame on a few CPU cores: products, then sums.

What ``runtime.all_frequency`` does, in float32 and on torch's threads. Columns of representatives
that are mostly full, those of coarse wavelets, are multiplied as they are, the others number by
number; of a truncated light only the columns that are lit. The sums of vertices are one product
with a matrix of their weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse
import torch
from torch.nn.functional import embedding_bag

from prtnet.all_frequency import AllFrequencyField, Segment
from prtnet.arrays import FloatArray, IntArray
from prtnet.sparse_columns import sparse_matrix
from runtime.all_frequency import representative_starts

__all__ = ["Products", "Runs", "Sums", "vertex_runs"]

FULL = 0.3  # of a column: from here on its zeros cost less than the places of its numbers
FEW = 0.1  # of the light's coefficients: up to here columns are picked out


@dataclass(frozen=True, eq=False)
class FullColumns:
    """Columns of one segment's representatives that are mostly full, R = C · N · m rows.

    Attributes:
        rows: where theirs are among those of all segments.
        places: of the columns, ascending, (F,).
        numbers: (F, R).
    """

    rows: slice
    places: IntArray
    numbers: torch.Tensor


def divided(one: Segment, rows: int, start: int) -> tuple[FullColumns, Any]:
    """A segment's representatives, times what 1 in a weight stands for: full columns, and the rest.

    Args:
        one: the segment.
        rows: m.
        start: of its rows among those of all segments.
    """
    matrix = sparse_matrix(one.representatives, rows)
    scale = np.repeat(one.scale.ravel() * np.float32(one.step), rows)
    matrix.data *= np.repeat(scale, np.diff(matrix.indptr))
    filled = np.bincount(matrix.indices, minlength=matrix.shape[1])
    full = filled > FULL * max(matrix.shape[0], 1)
    places = np.flatnonzero(full)
    numbers = torch.from_numpy(np.ascontiguousarray(matrix[:, places].toarray().T))
    matrix.data[full[matrix.indices]] = 0.0
    matrix.eliminate_zeros()
    return FullColumns(slice(start, start + matrix.shape[0]), places, numbers), matrix


class Products:
    """T^i of every representative, as often as the light changes.

    Args:
        field: whose representatives.

    Attributes:
        count: of representatives.
        full: columns of each segment that are mostly full.
        sparse: all others, (rows of all segments, 24 (n/2)²), a CSR array.
    """

    def __init__(self, field: AllFrequencyField) -> None:
        self.rows = field.rows
        *starts, self.count = representative_starts(field).tolist()
        parts = [
            divided(one, field.rows, start * field.rows)
            for one, start in zip(field.segments, starts, strict=True)
        ]
        self.full = [full for full, _ in parts]
        self.sparse: Any = scipy.sparse.block_diag([rest for _, rest in parts], format="csr")
        self._by_place: Any = None

    def __call__(self, light: FloatArray) -> FloatArray:
        """(representatives, m, 3) float32, as :func:`runtime.all_frequency.transformed`.

        Args:
            light: Haar coefficients (24, (n/2)², 3); where few are not zero, only their columns
                are read.
        """
        lit = np.asarray(light.any(axis=2))
        few = np.count_nonzero(lit) <= FEW * lit.size
        given = np.ascontiguousarray(light, dtype=np.float32)
        total = self._picked(given, lit) if few else self._all(given)
        for one, shining, known in zip(self.full, given, lit, strict=True):
            if not len(one.places):
                continue
            numbers, coefficients = one.numbers, torch.from_numpy(shining[one.places])
            if few:
                kept = torch.from_numpy(np.flatnonzero(known[one.places]))
                numbers, coefficients = numbers[kept], coefficients[kept]
            # Three rows times a wide matrix: far faster than a tall one times three columns.
            total[one.rows] += (coefficients.T @ numbers).T
        return np.asarray(total.numpy().reshape(-1, self.rows, 3))

    def _all(self, light: FloatArray) -> torch.Tensor:
        """What sparse columns make of all of a light, (rows, 3)."""
        if not self.sparse.shape[0]:
            return torch.zeros((0, 3))
        places, starts, values = (
            torch.from_numpy(part)
            for part in (self.sparse.indices, self.sparse.indptr, self.sparse.data)
        )
        table = torch.from_numpy(light.reshape(-1, 3))
        return embedding_bag(
            places, table, starts, mode="sum", per_sample_weights=values, include_last_offset=True
        )

    def _picked(self, light: FloatArray, lit: Any) -> torch.Tensor:
        """The same of the lit columns only."""
        if self._by_place is None:
            self._by_place = self.sparse.tocsc()
        kept = np.flatnonzero(lit)
        return torch.from_numpy(self._by_place[:, kept] @ light.reshape(-1, 3)[kept])


@dataclass(frozen=True, eq=False)
class Runs:
    """The segments that reach each vertex, vertex after vertex.

    Attributes:
        starts: where a vertex's begin, and the end of the last, (P + 1,) int32.
        first: the first representative of each one's cluster among those of all, (E,) int32.
        weights: of the N representatives from there on, (E, N) int16.
    """

    starts: IntArray
    first: IntArray
    weights: IntArray


def vertex_runs(field: AllFrequencyField) -> Runs:
    """Clusters and weights of every vertex; N is that of the segment that has most."""
    most = max(one.weights.shape[1] for one in field.segments)
    vertices = np.concatenate([one.vertices for one in field.segments])
    order = np.argsort(vertices, kind="stable")
    begins = representative_starts(field)[:-1]
    first = np.concatenate(
        [
            begin + one.labels() * one.weights.shape[1]
            for one, begin in zip(field.segments, begins, strict=True)
        ]
    )
    weights = np.concatenate(
        [np.pad(one.weights, ((0, 0), (0, most - one.weights.shape[1]))) for one in field.segments]
    )
    starts = np.concatenate([[0], np.cumsum(np.bincount(vertices, minlength=len(field)))])
    return Runs(starts.astype(np.int32), first[order].astype(np.int32), weights[order])


class Sums:
    """T_p of every vertex, as often as the products change.

    Args:
        field: whose vertices.
    """

    def __init__(self, field: AllFrequencyField) -> None:
        self.rows = field.rows
        runs = vertex_runs(field)
        terms = runs.weights.shape[1]
        last = max(int(representative_starts(field)[-1]) - 1, 0)  # where padded terms may point
        places = np.minimum(runs.first[:, None] + np.arange(terms, dtype=np.int32), last)
        self._places = torch.from_numpy(places.ravel().astype(np.int32))
        self._starts = torch.from_numpy(runs.starts * np.int32(terms))
        self._weights = torch.from_numpy(runs.weights.ravel().astype(np.float32))

    def __call__(self, sums: FloatArray) -> FloatArray:
        """(P, m, 3) float32 of products (representatives, m, 3) float32."""
        shape = len(self._starts) - 1, self.rows, 3
        if not len(self._places):
            return np.zeros(shape, dtype=np.float32)
        table = torch.from_numpy(sums.reshape(len(sums), -1))
        total = embedding_bag(
            self._places, table, self._starts, mode="sum", per_sample_weights=self._weights,
            include_last_offset=True,
        )  # fmt: skip
        return np.asarray(total.numpy().reshape(shape))
