from __future__ import annotations

import numpy as np
import pytest

from data_gen.reliefs import PATTERNS, relief, seams_close


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns_fill_zero_to_one_and_tile(name: str) -> None:
    heights = relief(name, (96, 60))
    assert heights.shape == (60, 96)
    assert heights.min() >= 0
    assert 0.8 < heights.max() <= 1
    assert seams_close(heights) == (True, True)
    assert np.ptp(heights) > 0.7


@pytest.mark.parametrize("name", PATTERNS)
def test_patterns_are_periodic(name: str) -> None:
    u = np.linspace(0.01, 0.98, 37)[None]
    v = np.linspace(0.02, 0.93, 29)[:, None]
    one = PATTERNS[name](u, v, np.random.default_rng(4))
    if name != "swirl":  # flat at its border, and beyond
        for shifted in ((u + 1, v), (u, v - 1)):
            again = PATTERNS[name](*shifted, np.random.default_rng(4))
            np.testing.assert_allclose(again, one, atol=1e-9)
    edge = PATTERNS[name](np.array([[0.0]]), v, np.random.default_rng(4))
    other = PATTERNS[name](np.array([[1.0 - 1e-9]]), v, np.random.default_rng(4))
    np.testing.assert_allclose(edge, other, atol=1e-3)


def test_threads_alternate() -> None:
    """Where two threads cross, the one along y is on top at every other crossing."""
    heights = relief("weave", (80, 80))
    middle = heights[10::20, 10::20]
    np.testing.assert_allclose(middle, 1.0, atol=0.01)
    # A little off a crossing, along the upper thread, it is higher than across it.
    along = heights[15::20, 10::20] > heights[10::20, 15::20]
    assert (along[::2, ::2] != along[1::2, ::2]).all()
    assert (along[::2, ::2] != along[::2, 1::2]).all()


def test_seed_scatters_bumps() -> None:
    np.testing.assert_array_equal(relief("bumps", (16, 16), 3), relief("bumps", (16, 16), 3))
    assert np.abs(relief("bumps", (16, 16), 3) - relief("bumps", (16, 16), 4)).max() > 0.1


def test_seams_that_do_not_close() -> None:
    ramp = np.tile(np.linspace(0, 1, 32), (16, 1))
    assert seams_close(ramp) == (False, True)
    assert seams_close(ramp.T) == (True, False)
    noise = np.random.default_rng(0).random((32, 32))
    assert seams_close(noise) == (True, True)
    assert seams_close(np.zeros((1, 1))) == (True, True)
    assert seams_close(np.ones((5, 7))) == (True, True)
