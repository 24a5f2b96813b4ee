"""Matrices of whole numbers, most of them zero, as ``prtnet.all_frequency`` stores them.

Ng, Ramamoorthi and Hanrahan 2003 and "All-Frequency" (Liu et al. 2004) section 4: columns in blocks
of 256 rows, so that a number's row within its block takes one byte. There is no loop over columns:
blocks, columns and rows of what is not zero, in this order, are the order of a sort.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse

from prtnet.all_frequency import SparseColumns
from prtnet.arrays import FloatArray, IntArray

__all__ = ["BLOCK", "byte_count", "decode", "encode", "multiply", "sparse_matrix"]

BLOCK = 256  # rows that one byte tells apart


def encode(matrix: IntArray) -> SparseColumns:
    """What is not zero of a matrix (R, D).

    Raises:
        ValueError: it is no matrix of int16.
    """
    if matrix.ndim != 2 or matrix.dtype != np.int16:
        raise ValueError(f"a matrix of int16 is wanted, not {matrix.ndim} axes of {matrix.dtype}")
    blocks = -(-len(matrix) // BLOCK)
    counts = np.zeros((blocks, matrix.shape[1]), dtype=np.uint16)
    rows, values = [], []
    for block in range(blocks):
        columns = np.ascontiguousarray(matrix[block * BLOCK : (block + 1) * BLOCK].T)  # [D, ≤ 256]
        kept = columns != 0
        counts[block] = kept.sum(axis=1)
        rows.append(np.nonzero(kept)[1].astype(np.uint8))
        values.append(columns[kept])
    return SparseColumns(
        counts,
        np.concatenate([np.zeros(0, dtype=np.uint8), *rows]),
        np.concatenate([np.zeros(0, dtype=np.int16), *values]),
        (matrix.shape[0], matrix.shape[1]),
    )


def indices(sparse: SparseColumns) -> tuple[IntArray, IntArray]:
    """Row and column of every number that is stored, (N,) each."""
    blocks, columns = sparse.counts.shape
    runs = np.repeat(np.arange(blocks * columns, dtype=np.int32), sparse.counts.ravel())
    block, column = np.divmod(runs, np.int32(max(columns, 1)))
    return block * BLOCK + sparse.rows, column


def decode(sparse: SparseColumns) -> IntArray:
    """The whole matrix (R, D) int16."""
    matrix = np.zeros(sparse.shape, dtype=np.int16)
    matrix[indices(sparse)] = sparse.values
    return matrix


def sparse_matrix(sparse: SparseColumns, parts: int = 1) -> Any:
    """A SciPy CSR array of float32 (R · parts, D / parts), to multiply with many times.

    Row k · parts + r is the r-th part of row k: of representatives of ``parts`` rows each, which
    all meet the same light, one matrix.

    Raises:
        ValueError: D has no such parts.
    """
    rows, width = sparse.shape
    if parts < 1 or width % parts:
        raise ValueError(f"{width} columns have no {parts} parts")
    row, column = indices(sparse)
    part, place = np.divmod(column, np.int32(max(width // parts, 1)))
    shape = (rows * parts, width // parts)
    found = scipy.sparse.coo_array(
        (sparse.values.astype(np.float32), (row * np.int32(parts) + part, place)), shape=shape
    )
    return found.tocsr()


def multiply(sparse: SparseColumns, vectors: FloatArray) -> FloatArray:
    """The matrix times a vector (D,) or times vectors (D, K) side by side, float32."""
    return np.asarray(sparse_matrix(sparse) @ vectors.astype(np.float32))


def byte_count(sparse: SparseColumns) -> int:
    """Bytes that it takes: three of every number, two of every column of a block."""
    return int(sparse.counts.nbytes + sparse.rows.nbytes + sparse.values.nbytes)
