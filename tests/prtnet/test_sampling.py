from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet.sampling import Cells, around, cosine_hemisphere, lattice, linear, shares


def test_a_lattice_is_even_in_both_numbers():
    points = lattice(1000)
    assert np.sort(points[:, 0]) == pytest.approx((np.arange(1000) + 0.5) / 1000)
    # No gap on a circle is much wider than the mean one: a golden turn leaves three lengths.
    gaps = np.diff(np.sort(points[:, 1]))
    assert gaps.max() < 2.0 / 1000
    # Boxes hold their share of points, to a few of them.
    inside = (points < [0.3, 0.7]).all(axis=1)
    assert inside.sum() == pytest.approx(210, abs=5)


@pytest.mark.parametrize("total", [3, 10, 257])
def test_shares_are_whole_and_sum_up(total):
    found = shares(np.array([5.0, 3.0, 1e-9]), total)
    assert found.sum() == total
    assert found.min() >= 1
    assert (np.diff(found) <= 0).all()


def test_everyone_has_a_share_even_of_less():
    assert shares(np.array([5.0, 3.0, 0.0]), 1).tolist() == [1, 1, 1]
    assert shares(np.zeros(4), 8).tolist() == [2, 2, 2, 2]


@pytest.mark.parametrize(("first", "last"), [(1.0, 3.0), (3.0, 1.0), (0.0, 2.0), (2.0, 0.0)])
def test_linear_inverts_its_share(first, last):
    u = np.linspace(0.0, 1.0, 101)
    t = linear(np.full(101, first), np.full(101, last), u)
    # ∫ first (1 − t) + last t, of the whole.
    share = (first * t + (last - first) * t**2 / 2.0) / ((first + last) / 2.0)
    assert share == pytest.approx(u, abs=1e-12)


def test_linear_without_weight_is_even():
    u = np.linspace(0.0, 1.0, 11)
    assert linear(np.zeros(11), np.zeros(11), u) == pytest.approx(u)


@pytest.fixture
def weights() -> np.ndarray:
    found = np.random.default_rng(3).random((3, 5, 7))
    found[0, 2] = 0.0  # a row
    found[1, :, 0] = found[1, :, -1] = 0.0  # columns at the ends
    found[2] = 0.0  # a whole table
    found[1, 4, 3] = 1e-12
    return found


def test_cells_are_drawn_as_often_as_they_weigh(weights):
    cells = Cells(weights)
    side = 400
    line = (np.arange(side) + 0.5) / side
    u = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    for table, weight in enumerate(weights):
        row, column, left = cells.draw(np.full(len(u), table), u)
        drawn = np.bincount(row * 7 + column, minlength=35).reshape(5, 7) / len(u)
        expected = weight / weight.sum() if weight.any() else np.full((5, 7), 1 / 35)
        assert drawn == pytest.approx(expected, abs=2.0 / side)
        assert (drawn[expected == 0.0] == 0.0).all()
        r, c = np.divmod(np.arange(35), 7)
        stated = cells.probability(np.full(35, table), r, c).reshape(5, 7)
        assert stated == pytest.approx(expected, abs=1e-12)
        # What is left of the numbers is even again.
        assert left.mean(axis=0) == pytest.approx([0.5, 0.5], abs=0.01)
        assert left.min() >= 0.0
        assert left.max() < 1.0


def test_the_ends_of_the_numbers_are_cells_with_weight(weights):
    cells = Cells(weights)
    ends = np.array([[0.0, 0.0], [1.0 - 1e-16, 1.0 - 1e-16], [0.0, 1.0 - 1e-16]])
    for table in range(3):
        row, column, _ = cells.draw(np.full(3, table), ends)
        assert (cells.probability(np.full(3, table), row, column) > 0.0).all()


def test_around_is_at_its_drop():
    drop = np.array([1e-14, 1e-6, 0.3, 1.0, 1.9, 2.0])
    found = around(drop, np.linspace(0.0, 6.0, 6))
    assert np.linalg.norm(found, axis=1) == pytest.approx(np.ones(6))
    assert found[:, 2] == pytest.approx(1.0 - drop)
    # sin² = drop (2 − drop), without what 1 − cos² rounds away.
    assert np.hypot(found[:, 0], found[:, 1])[0] == pytest.approx(math.sqrt(2e-14), rel=1e-9)


def test_cosine_hemisphere_has_its_moments():
    drawn = cosine_hemisphere(lattice(4096))
    # ∫z · z/π = 2/3, ∫x² z/π = 1/4
    assert drawn[:, 2].mean() == pytest.approx(2 / 3, abs=1e-3)
    assert (drawn[:, 0] ** 2).mean() == pytest.approx(0.25, abs=1e-3)
    assert drawn[:, :2].mean(axis=0) == pytest.approx([0.0, 0.0], abs=1e-3)
