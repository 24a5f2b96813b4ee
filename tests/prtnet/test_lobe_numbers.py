from __future__ import annotations

import numpy as np
import pytest

from prtnet.lobe_numbers import LobeNumbers
from prtnet.zh import Lobes
from prtnet.zh_fit import fit_lobes

COUNTS = [1, 2, 3]


def random_lobes(count, order, seed=0):
    """Of five poses and seven receivers."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(5, 7, count, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    return Lobes(axes, rng.normal(size=(5, 7, count, order)))


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 6])
def test_numbers_of_lobes_are_those_lobes(count, order):
    """Lobe by lobe but for the first band, of which only the sum shows."""
    numbers = LobeNumbers(count, order)
    lobes = random_lobes(count, order)
    given = numbers.of(lobes)
    assert given.shape == (5, 7, numbers.size)
    assert numbers.size == 1 + count * (order + 2)
    again = numbers.lobes(given)
    assert np.allclose(again.coefficients[..., 1:], lobes.coefficients[..., 1:])
    if order > 1:
        assert np.allclose(again.axes, lobes.axes, atol=1e-3)
    for harmonics in (again.harmonics(), numbers.harmonics(given)):
        assert np.allclose(harmonics, lobes.harmonics(), atol=1e-4)


@pytest.mark.parametrize("count", COUNTS)
def test_an_error_of_a_number_is_an_error_of_a_coefficient(count):
    """A small step in numbers moves what lobes far apart stand for by at most about as much."""
    numbers = LobeNumbers(1, 4)
    given = numbers.of(random_lobes(1, 4))
    rng = np.random.default_rng(count)
    step = 1e-5 * rng.normal(size=given.shape)
    moved = np.linalg.norm(numbers.harmonics(given + step) - numbers.harmonics(given), axis=-1)
    assert (moved <= 4.0 * np.linalg.norm(step, axis=-1)).all()  # a band l turns l times as fast
    assert moved.max() > 1e-6


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_dtype_stays(dtype):
    numbers = LobeNumbers(2, 4)
    given = numbers.of(random_lobes(2, 4)).astype(dtype)
    assert numbers.harmonics(given).dtype == dtype
    assert numbers.lobes(given).axes.dtype == dtype
    assert numbers.lobes(given).coefficients.dtype == dtype


def test_fits_hold_the_first_band_exactly_and_follow_their_start():
    numbers = LobeNumbers(2, 4)
    rng = np.random.default_rng(3)
    true = random_lobes(2, 4)
    target = true.harmonics() + 0.01 * rng.normal(size=(5, 7, 16))
    start = Lobes(true.axes[0], true.coefficients[0])
    found = numbers.fitted(target, start)
    assert np.array_equal(found[..., 0], target[..., 0])
    swapped = Lobes(start.axes[:, ::-1], start.coefficients[:, ::-1])
    other = numbers.lobes(numbers.fitted(target[0], swapped))
    own = numbers.lobes(found[0])
    assert np.allclose(other.axes[:, ::-1], own.axes, atol=1e-3)
    error = np.linalg.norm(numbers.harmonics(found[0]) - target[0], axis=-1)
    assert (error <= 0.1 * np.linalg.norm(target[0], axis=-1)).all()


def test_lobes_that_vanish_have_no_say_in_a_mean():
    numbers = LobeNumbers(1, 4)
    lobes = random_lobes(1, 4)
    scale = np.zeros((5, 1, 1, 1))
    scale[0] = 1.0
    faint = Lobes(lobes.axes, lobes.coefficients * scale)
    mean = numbers.lobes(numbers.of(faint).mean(axis=0))
    assert np.allclose(mean.axes, lobes.axes[0], atol=1e-4)


@pytest.mark.parametrize("count", COUNTS)
def test_no_numbers_point_to_the_normal(count):
    numbers = LobeNumbers(count, 4)
    lobes = numbers.lobes(np.zeros((3, numbers.size), dtype=np.float32))
    assert np.array_equal(lobes.axes, np.broadcast_to([0.0, 0.0, 1.0], (3, count, 3)))
    assert not lobes.coefficients.any()
    opposite = np.zeros((1, numbers.size))
    opposite[..., 3:-1:3] = -1e-6  # just what is added
    assert np.isfinite(numbers.harmonics(opposite)).all()


def test_start_of_a_fit_is_any_fit():
    """The numbers of functions that are sums of lobes are nearly theirs."""
    numbers = LobeNumbers(1, 4)
    lobes = random_lobes(1, 4)
    target = lobes.harmonics()
    found = numbers.fitted(target, fit_lobes(target, 1, ridge=1e-2))
    assert np.allclose(numbers.harmonics(found), target, atol=0.02 * np.abs(target).max())
