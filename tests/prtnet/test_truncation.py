from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet.cube_map import segment_coefficients, solid_angles
from prtnet.truncation import area_weights, transfer_weights, truncated
from tests.all_frequency import ball, dense_segment, random_field


@given(count=st.integers(0, 400), seed=st.integers(0, 5))
def test_magnitude_leaves_the_least_of_the_light(count, seed):
    light = np.random.default_rng(seed).normal(size=(24, 16, 3)) ** 3
    kept = truncated(light, count)
    chosen = kept.any(axis=-1)
    assert chosen.sum() == min(count, 384)
    np.testing.assert_array_equal(kept[chosen], light[chosen])
    squares = np.sort((light**2).sum(axis=-1).ravel())
    left = squares[: max(0, 384 - count)].sum()
    assert ((kept - light) ** 2).sum() == pytest.approx(left, rel=1e-12, abs=1e-12)


def test_a_constant_light_is_one_coefficient_a_segment():
    light = segment_coefficients(np.full((6, 8, 8, 3), 0.7))
    np.testing.assert_allclose(truncated(light, 24), light, atol=1e-12)
    assert not np.allclose(truncated(light, 23), light)


def test_equal_ones_are_kept_in_order():
    light = np.ones((24, 4, 3), dtype=np.float32)
    kept = truncated(light, 5)
    assert kept.dtype == np.float32
    np.testing.assert_array_equal(np.flatnonzero(kept[..., 0]), np.arange(5))
    with pytest.raises(ValueError, match="kept"):
        truncated(light, -1)


def test_areas_are_integrals_of_wavelets():
    size = 8
    found = area_weights(size)
    assert found.shape == (24, 16)
    area = solid_angles(size)
    whole = np.array([area[:4, :4], area[:4, 4:], area[4:, :4], area[4:, 4:]])
    # The mean of a segment, and its widest differences: ¼ in all texels.
    for wavelet in (0, 1, 4, 5):
        np.testing.assert_allclose(found[:, wavelet], np.tile(whole.sum(axis=(1, 2)) / 4, 6))
    # The difference along the rows of the first two by two texels: ½ in each.
    np.testing.assert_allclose(found[:4, 2], whole[:, :2, :2].sum(axis=(1, 2)) / 2)
    assert found[:, 0].sum() == pytest.approx(math.pi)


def test_weights_of_transfer_are_those_of_all_matrices():
    fields = [random_field(1, rows=3), random_field(2, ball(2), rows=2)]
    squares = np.zeros((24, 16))
    for field in fields:
        for number, one in enumerate(field.segments):
            dense = dense_segment(one, len(field)).reshape(-1, 16)
            squares[number] += np.square(dense).sum(axis=0)
    rows = sum(len(field) * field.rows for field in fields)
    np.testing.assert_allclose(transfer_weights(fields), np.sqrt(squares / rows), rtol=1e-6)


def test_what_is_answered_more_is_kept_before_what_is_brighter():
    """Shading by the transfer-weighted choice is closer than by the largest."""
    rng = np.random.default_rng(2)
    strength = rng.uniform(0.01, 1.0, size=(24, 16)) ** 3
    waves = rng.normal(size=(24, 200, 1, 16)) * strength[:, None, None]
    light = rng.normal(size=(24, 16, 3))
    sent = np.einsum("gpmk,gkc->pc", waves, light)
    errors = [
        np.linalg.norm(np.einsum("gpmk,gkc->pc", waves, truncated(light, 100, one)) - sent)
        for one in (None, strength)
    ]
    assert errors[1] < 0.6 * errors[0]
