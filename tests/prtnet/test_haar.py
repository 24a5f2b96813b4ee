from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from prtnet.haar import haar, unhaar

SIDES = (1, 2, 4, 8, 16)


def basis(side: int) -> np.ndarray:
    """Non-standard Haar functions one by one, in Mallat's layout: (h², h, h)."""
    line = np.arange(side)
    found = np.zeros((side, side, side, side))
    found[0, 0] = 1.0 / side
    half = 1
    while half < side:
        wide = side // half  # of a function, in texels
        for row in range(half):
            for column in range(half):
                y, x = line[:, None] - row * wide, line - column * wide
                inside = (y >= 0) & (y < wide) & (x >= 0) & (x < wide)
                across = np.where(x < wide // 2, 1.0, -1.0)
                along = np.where(y < wide // 2, 1.0, -1.0)
                found[row, half + column] = inside * across / wide
                found[half + row, column] = inside * along / wide
                found[half + row, half + column] = inside * across * along / wide
        half *= 2
    return found.reshape(side * side, side, side)


@pytest.mark.parametrize("side", SIDES)
def test_coefficients_are_sums_with_the_wavelets(side):
    functions = basis(side)
    np.testing.assert_allclose(
        functions.reshape(side**2, -1) @ functions.reshape(side**2, -1).T,
        np.eye(side**2),
        atol=1e-12,
    )
    block = np.random.default_rng(side).normal(size=(3, side, side))
    expected = np.einsum("kyx,nyx->nk", functions, block)
    np.testing.assert_allclose(haar(block).reshape(3, -1), expected, atol=1e-12)
    np.testing.assert_allclose(unhaar(expected.reshape(block.shape)), block, atol=1e-12)


@given(arrays(np.float64, (2, 8, 8), elements=st.floats(-1e6, 1e6)))
def test_energy_stays_and_comes_back(block):
    found = haar(block)
    scale = max(1.0, np.abs(block).max())
    assert np.linalg.norm(found) == pytest.approx(np.linalg.norm(block), rel=1e-12, abs=1e-9)
    np.testing.assert_allclose(unhaar(found), block, atol=1e-13 * scale)


def test_kind_of_float_and_argument_stay():
    block = np.ones((5, 4, 4), dtype=np.float32)
    found = haar(block)
    assert found.dtype == np.float32
    np.testing.assert_array_equal(block, 1.0)
    np.testing.assert_array_equal(found[:, 0, 0], 4.0)
    assert np.count_nonzero(found) == 5


@pytest.mark.parametrize("shape", [(3, 3), (4, 2), (4,), (0, 0), (2, 6, 6)])
def test_only_squares_of_a_power_of_two(shape):
    for function in (haar, unhaar):
        with pytest.raises(ValueError, match="Haar"):
            function(np.zeros(shape))
