from __future__ import annotations

import numpy as np
import pytest

from prtnet.novelty import fade, novelty, pose_novelty

LOW = np.array([[-1.0, -2.0], [0.0, 0.0]], dtype=np.float32)
HIGH = np.array([[1.0, 2.0], [3.0, 4.0]], dtype=np.float32)


def test_inside_the_box_nothing_is_new():
    corners = np.stack([LOW, HIGH, (LOW + HIGH) / 2])
    assert np.array_equal(novelty(corners, LOW, HIGH), np.zeros((3, 2)))
    assert np.array_equal(fade(novelty(corners, LOW, HIGH)), np.ones((3, 2)))


def test_outside_it_is_the_distance_in_half_diagonals():
    inputs = np.array([[[1.0, 2.0 + 5.0**0.5], [3.0 + 3.0, 4.0 + 4.0]]])
    each = novelty(inputs, LOW, HIGH)
    assert each == pytest.approx(np.array([[1.0, 2.0]]))
    assert pose_novelty(each) == pytest.approx([1.5])


def test_units_of_the_inputs_do_not_matter():
    inputs = np.random.default_rng(0).normal(0, 5, (4, 2, 2))
    assert novelty(1e3 * inputs, 1e3 * LOW, 1e3 * HIGH) == pytest.approx(novelty(inputs, LOW, HIGH))


def test_fade_falls_from_one_to_nothing():
    each = np.array([0.0, 1e-9, 0.1, 1.0, 10.0, 1e6, 1e200])
    with np.errstate(over="ignore"):
        strength = fade(each)
    assert strength[:2].tolist() == [1.0, 1.0]
    assert (np.diff(strength) <= 0).all()
    assert strength[3] == pytest.approx(0.5)
    assert strength[-1] == 0.0


def test_box_without_extent():
    """One training pose: anything else is new, and it is still a number."""
    point = np.zeros((1, 2), dtype=np.float32)
    each = novelty(np.array([[[0.0, 0.0]], [[0.3, 0.0]]]), point, point)
    assert each[0, 0] == 0.0
    assert np.isfinite(each).all()
    assert fade(each)[1, 0] < 1e-9
