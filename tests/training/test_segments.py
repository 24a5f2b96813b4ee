from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from training.segments import mean_shift, rotation_sequences


def test_mean_shift_finds_the_groups_and_leaves_no_point_out():
    rng = np.random.default_rng(0)
    centres = 5.0 * np.eye(4)
    owner = rng.integers(0, 4, 3000)
    points = centres[owner] + 0.2 * rng.normal(size=(3000, 4))
    label = mean_shift(points, 2.0, most=300)
    assert label.shape == (3000,)
    assert len(set(zip(owner.tolist(), label.tolist(), strict=True))) == 4
    assert set(label.tolist()) == {0, 1, 2, 3}
    assert mean_shift(np.zeros((5, 2)), 1.0).tolist() == [0] * 5
    assert set(mean_shift(points, 100.0).tolist()) == {0}


def test_a_mode_climbs_to_the_density():
    """One blob of twice the kernel's width is one segment, not one for every point."""
    points = np.random.default_rng(1).normal(size=(800, 2))
    assert len(set(mean_shift(points, 1.5).tolist())) <= 2


def test_rotation_sequences_measure_angles():
    rng = np.random.default_rng(2)
    turns = Rotation.random(12, rng=rng).as_matrix().reshape(3, 4, 3, 3)  # [S, V, 3, 3]
    rest = Rotation.random(4, rng=rng).as_matrix()
    posed = turns @ rest
    flat = rotation_sequences(rest[..., 2], rest[..., 0], posed[..., 2], posed[..., 0])
    between = Rotation.from_matrix(turns[:, 0]).inv() * Rotation.from_matrix(turns[:, 1])
    expected = np.sqrt(np.mean(np.sin(between.magnitude() / 2) ** 2))
    assert np.linalg.norm(flat[0] - flat[1]) == pytest.approx(expected, rel=1e-6)


def test_receivers_that_turn_alike_are_alike_wherever_they_face():
    rng = np.random.default_rng(3)
    turns = Rotation.random(5, rng=rng).as_matrix()[:, None]
    rest = Rotation.random(6, rng=rng).as_matrix()
    posed = turns @ rest
    flat = rotation_sequences(rest[..., 2], rest[..., 0], posed[..., 2], posed[..., 0])
    assert np.ptp(flat, axis=0).max() < 1e-6
