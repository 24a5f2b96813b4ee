"""Zonal lobes where a fit degenerates: poles, antipodes, equal axes, nothing to fit, extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.sh_rotation import rotate
from prtnet.zh import RIDGE, Lobes, best_coefficients, exact_lobes, relative_error
from prtnet.zh_fit import fewest_lobes, fit_lobes
from prtnet.zh_misfit import Misfit

POLES = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
SHAPE = np.array([0.7, 1.1, 0.4, -0.3])


@pytest.mark.parametrize("axis", [*POLES, [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [1e-9, 0.0, 1.0]])
@pytest.mark.parametrize("count", [1, 3])
def test_a_lobe_at_a_pole_or_on_the_equator(axis, count):
    target = Lobes(np.array([axis]), SHAPE[None]).harmonics()
    fit = fit_lobes(target, count)
    assert relative_error(target, fit) < 1e-4
    if count == 1:
        np.testing.assert_allclose(fit.axes[0], axis, atol=1e-5)


def test_opposite_axes_are_the_same_lobe():
    parity = (-1.0) ** np.arange(4)
    up, down = Lobes(POLES[:1], SHAPE[None]), Lobes(POLES[1:], (SHAPE * parity)[None])
    np.testing.assert_allclose(up.harmonics(), down.harmonics(), atol=1e-15)
    # Of the two the fit gives the one whose linear band is positive.
    np.testing.assert_allclose(fit_lobes(down.harmonics(), 1).axes, POLES[:1], atol=1e-5)


def test_two_lamps_opposite_to_each_other_are_one_lobe():
    target = Lobes(POLES, np.stack([SHAPE, [0.2, 0.9, -0.8, 0.5]])).harmonics()
    assert relative_error(target, fit_lobes(target, 1)) < 1e-5


@pytest.mark.parametrize("count", [2, 3, 5])
def test_equal_axes_share_their_coefficients(count):
    axes = np.tile([[0.6, 0.0, 0.8]], (count, 1))
    target = Lobes(axes[:1], SHAPE[None]).harmonics()
    coefficients = best_coefficients(sh.evaluate(axes, 4), target)
    np.testing.assert_allclose(coefficients, np.tile(SHAPE / count, (count, 1)), atol=1e-5)
    value, slope = Misfit(target[None], RIDGE)(np.arange(1), axes.T.reshape(-1, 1))
    assert value < 1e-5
    assert np.isfinite(slope).all()


@pytest.mark.parametrize("gap", [1e-12, 1e-4, 1e-2])
def test_lobes_that_meet_do_not_blow_up(gap):
    # The difference of two lobes over the angle between them: a derivative, which no two lobes
    # are, though two with large coefficients of opposite sign come near.
    angle = np.array([0.0, max(gap, 1e-6)])
    axes = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    target = Lobes(axes, np.stack([-SHAPE, SHAPE]) / max(gap, 1e-6)).harmonics()
    for count in (2, 3):
        fit = fit_lobes(target, count)
        assert np.abs(fit.coefficients).max() < 1000 * np.linalg.norm(target)
        assert relative_error(target, fit) < 0.05


def test_more_lobes_than_anything_needs():
    target = np.random.default_rng(0).normal(size=4)  # order 2: one lobe is enough
    fit = fit_lobes(target, 6)
    assert relative_error(target, fit) < 1e-5
    assert np.abs(fit.coefficients).max() < 4 * np.linalg.norm(target)


def test_a_constant_is_all_in_the_first_band():
    for order in (1, 4):
        target = np.zeros(order * order)
        target[0] = 2.0
        fit = fit_lobes(target, 3)
        np.testing.assert_allclose(fit.coefficients[:, 0].sum(), 2 * math.sqrt(4 * math.pi), 1e-5)
        np.testing.assert_allclose(fit.coefficients[:, 1:], 0, atol=1e-12)
        np.testing.assert_allclose(np.linalg.norm(fit.axes, axis=-1), 1)


@pytest.mark.parametrize("fit", [fit_lobes, exact_lobes, lambda f: fewest_lobes(f, 3, 0.01)])
def test_nothing_to_fit(fit):
    for target in (np.zeros(16), np.zeros((2, 16), np.float32)):
        lobes = fit(target)
        assert (lobes.coefficients == 0).all()
        np.testing.assert_allclose(np.linalg.norm(lobes.axes, axis=-1), 1, atol=1e-6)
        assert relative_error(target, lobes) == 0.0
    assert fit(np.zeros((0, 16))).axes.shape[0] == 0
    assert fit(np.zeros((2, 0, 16))).coefficients.shape[:2] == (2, 0)


def test_a_black_channel_beside_others():
    target = np.random.default_rng(1).normal(size=(3, 16))
    target[1] = 0
    fit = fit_lobes(target, 2)
    assert (fit.coefficients[1] == 0).all()
    np.testing.assert_allclose(fit.axes[[0, 2]], fit_lobes(target[[0, 2]], 2).axes, atol=1e-6)


@pytest.mark.parametrize("scale", [1e-300, 1e-30, 1e30, 1e300])
def test_dim_and_glaring_lights_are_fitted_alike(scale):
    target = np.random.default_rng(2).normal(size=16)
    fit, scaled = fit_lobes(target, 2), fit_lobes(target * scale, 2)
    np.testing.assert_allclose(scaled.axes, fit.axes, atol=1e-6)
    np.testing.assert_allclose(scaled.coefficients / scale, fit.coefficients, atol=1e-6)
    assert relative_error(target * scale, scaled) == pytest.approx(relative_error(target, fit))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("fit", [fit_lobes, exact_lobes, lambda f: fewest_lobes(f, 3, 0.01)])
def test_what_is_not_finite_is_refused(fit, bad):
    target = np.ones((2, 16))
    target[1, 5] = bad
    with pytest.raises(ValueError, match="not finite"):
        fit(target)


def test_impossible_requests_are_refused():
    with pytest.raises(ValueError, match="at least one lobe"):
        fit_lobes(np.ones(9), 0)
    with pytest.raises(ValueError, match="at least one lobe"):
        fewest_lobes(np.ones(9), 0, 0.1)
    with pytest.raises(ValueError, match="not a square"):
        fit_lobes(np.ones(8))


def test_bands_that_cannot_tell_an_axis_from_its_opposite():
    even = Lobes(np.array([[0.48, 0.6, 0.64]]), np.array([[0.3, 0.0, 1.0, 0.0, -0.4]]))
    fit = fit_lobes(even.harmonics(), 1)
    assert abs(fit.axes[0] @ even.axes[0]) == pytest.approx(1)
    np.testing.assert_allclose(fit.coefficients, even.coefficients, atol=1e-5)


def test_exact_lobes_turn_exactly():
    target = np.random.default_rng(3).normal(size=(3, 36))
    for turn in (*Rotation.random(3, rng=0).as_matrix(), np.diag([1.0, -1, -1])):
        turned = exact_lobes(target).rotated(turn).harmonics()
        np.testing.assert_allclose(turned, rotate(target, turn), atol=1e-10)
