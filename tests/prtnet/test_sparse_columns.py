from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prtnet.all_frequency import check_sparse
from prtnet.sparse_columns import byte_count, decode, encode, multiply, sparse_matrix


def random_matrix(rows: int, columns: int, density: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    values = rng.integers(-32768, 32768, (rows, columns)).astype(np.int16)
    return np.where(rng.random((rows, columns)) < density, values, np.int16(0))


matrices = st.builds(
    random_matrix,
    st.sampled_from([0, 1, 2, 255, 256, 257, 512, 700]),
    st.integers(0, 12),
    st.sampled_from([0.0, 0.02, 0.3, 1.0]),
    st.integers(0, 9),
)


def slowly(matrix: np.ndarray) -> tuple[list[list[int]], list[int], list[int]]:
    """Counts, rows and values, number by number."""
    counts: list[list[int]] = []
    rows, values = [], []
    for start in range(0, len(matrix), 256):
        block = matrix[start : start + 256]
        counts.append([])
        for column in range(matrix.shape[1]):
            found = [row for row in range(len(block)) if block[row, column]]
            counts[-1].append(len(found))
            rows += found
            values += [int(block[row, column]) for row in found]
    return counts, rows, values


@given(matrices)
@settings(max_examples=60)
def test_a_matrix_comes_back_and_is_stored_as_the_format_says(matrix: np.ndarray) -> None:
    sparse = encode(matrix)
    check_sparse(sparse)
    counts, rows, values = slowly(matrix)
    assert sparse.counts.tolist() == counts
    assert sparse.rows.tolist() == rows
    assert sparse.values.tolist() == values
    back = decode(sparse)
    assert back.dtype == np.int16
    np.testing.assert_array_equal(back, matrix)
    assert byte_count(sparse) == 3 * np.count_nonzero(matrix) + 2 * sparse.counts.size


@given(matrices, st.sampled_from([(), (1,), (3,)]))
@settings(max_examples=40)
def test_products_are_those_of_the_whole_matrix(matrix: np.ndarray, trail: tuple[int, ...]) -> None:
    vectors = np.random.default_rng(5).normal(size=(matrix.shape[1], *trail))
    got = multiply(encode(matrix), vectors)
    want = matrix.astype(np.float64) @ vectors
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=1e-6 * 32768 * 12)


def test_parts_of_rows_become_rows() -> None:
    matrix = random_matrix(300, 12, 0.3, 1)
    found = sparse_matrix(encode(matrix), 3)
    np.testing.assert_array_equal(found.toarray(), matrix.reshape(900, 4))
    with pytest.raises(ValueError, match="12 columns have no 5 parts"):
        sparse_matrix(encode(matrix), 5)


@pytest.mark.parametrize("matrix", [np.zeros(3, np.int16), np.zeros((2, 2), np.int32)])
def test_other_arrays_are_refused(matrix: np.ndarray) -> None:
    with pytest.raises(ValueError, match="a matrix of int16 is wanted"):
        encode(matrix)
