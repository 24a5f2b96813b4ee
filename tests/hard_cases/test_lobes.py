"""Zonal lobes where a fit degenerates: poles, antipodes, equal axes, nothing to fit, extremes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.sh_rotation import rotate
from prtnet.zh import (
    RIDGE,
    Lobes,
    best_coefficients,
    exact_lobes,
    relative_error,
    zonal_energy,
)
from prtnet.zh_fit import FINE_RIDGE, fewest_lobes, fit_lobes, follow_lobes
from prtnet.zh_misfit import Misfit
from prtnet.zh_order import aligned
from prtnet.zh_surface import bilinear, coherent_lobes, interpolated
from tests.hard_cases.measured import above, below, close, equal, finite, refuses

POLES = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
SHAPE = np.array([0.7, 1.1, 0.4, -0.3])
# Fits are made in float64: what float32 loses is the target's rounding and the result's. What a fit
# near its function misses in float64 is its ridge.
NEAR = {"float32": 1e-6, "float64": 5e-10}
ROUNDED = {"float32": 2e-7, "float64": 1e-14}


def typed(lobes: Lobes, dtype: str) -> Lobes:
    """The same: they have the dtype of what they were fitted to."""
    assert lobes.axes.dtype == lobes.coefficients.dtype == dtype
    return lobes


@pytest.mark.parametrize("axis", [*POLES, [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [1e-9, 0.0, 1.0]])
@pytest.mark.parametrize("count", [1, 3])
def test_a_lobe_at_a_pole_or_on_the_equator(axis, count, dtype):
    target = Lobes(np.array([axis]), SHAPE[None]).harmonics().astype(dtype)
    fit = typed(fit_lobes(target, count), dtype)
    below(relative_error(target, fit), NEAR[dtype])
    if count == 1:
        close(fit.axes[0], axis, atol=ROUNDED[dtype])


def test_opposite_axes_are_the_same_lobe(dtype):
    parity = (-1.0) ** np.arange(4)
    up, down = (
        Lobes(axes.astype(dtype), shape[None].astype(dtype)).harmonics()
        for axes, shape in ((POLES[:1], SHAPE), (POLES[1:], SHAPE * parity))
    )
    assert up.dtype == dtype
    close(up, down, atol={"float32": 1e-6, "float64": 1e-15}[dtype])
    # Of the two the fit gives the one whose linear band is positive.
    close(fit_lobes(down, 1).axes, POLES[:1], atol=ROUNDED[dtype])


def test_two_lamps_opposite_to_each_other_are_one_lobe(dtype):
    lamps = Lobes(POLES, np.stack([SHAPE, [0.2, 0.9, -0.8, 0.5]]))
    target = lamps.harmonics().astype(dtype)
    below(relative_error(target, fit_lobes(target, 1)), NEAR[dtype])


@pytest.mark.parametrize("count", [2, 3, 5])
def test_equal_axes_share_their_coefficients(count, dtype):
    """Of matrices of ones 1 + the ridge is left of every diagonal: all in closed form."""
    axes = np.tile([[0.6, 0.0, 0.8]], (count, 1)).astype(dtype)
    target = Lobes(axes[:1], SHAPE[None].astype(dtype)).harmonics()
    coefficients = best_coefficients(sh.evaluate(axes, 4), target)
    shared = np.tile(SHAPE / (count + RIDGE), (count, 1))
    close(coefficients, shared, atol={"float32": 1e-6, "float64": 1e-9}[dtype])
    value, slope = Misfit(target[None], RIDGE)(np.arange(1), axes.T.reshape(-1, 1))
    missed = (SHAPE[1:] ** 2 @ zonal_energy(np.arange(1, 4))) * RIDGE / (count + RIDGE)
    close(value, missed, atol={"float32": 1e-6, "float64": 1e-14}[dtype])
    finite(slope)


@pytest.mark.parametrize("gap", [1e-12, 1e-4, 1e-2])
def test_lobes_that_meet_do_not_blow_up(gap, dtype):
    # The difference of two lobes over the angle between them: a derivative, which no two lobes
    # are, though two with large coefficients of opposite sign come near. How near the ridge says,
    # not the precision.
    angle = np.array([0.0, max(gap, 1e-6)])
    axes = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], axis=-1)
    steep = Lobes(axes, np.stack([-SHAPE, SHAPE]) / max(gap, 1e-6))
    target = steep.harmonics().astype(dtype)
    for count in (2, 3):
        fit = typed(fit_lobes(target, count), dtype)
        below(np.abs(fit.coefficients).max(), 100 * np.linalg.norm(target))
        below(relative_error(target, fit), 2e-3)


def test_a_strong_ridge_keeps_lobes_that_meet_small(dtype):
    """What is to be predicted: a little more error, coefficients as small as the function."""
    rng = np.random.default_rng(0)
    axes = np.array([0.0, 0.0, 1.0]) + 0.2 * rng.normal(size=(20, 3, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    target = Lobes(axes, np.tile(SHAPE, (20, 3, 1))).harmonics().astype(dtype)
    usual, strong = (fit_lobes(target, 2, starts=0, ridge=ridge) for ridge in (RIDGE, 1e-2))
    most = [np.abs(fit.coefficients).max() / np.abs(target).max() for fit in (usual, strong)]
    below(most[1], 3.0)
    below(most[1], 0.5 * most[0])
    above(relative_error(target, strong), relative_error(target, usual))
    below(relative_error(target, strong), 0.1)
    same = typed(follow_lobes(target, strong, ridge=1e-2), dtype)
    close(same.coefficients, strong.coefficients, atol=0.02)
    below(relative_error(target, follow_lobes(target, strong)), 0.7 * relative_error(target, same))
    exact = Lobes(axes[:, :1], np.tile(SHAPE, (20, 1, 1))).harmonics().astype(dtype)
    plain, damped = (fit_lobes(exact, 1, ridge=ridge) for ridge in (RIDGE, 1e-2))
    below(relative_error(exact, plain), {"float32": 1e-6, "float64": 1e-7}[dtype])
    above(relative_error(exact, damped), 1e-3)
    below(relative_error(exact, damped), 0.02)
    # So near that the usual ridge would go on with a finer one.
    plain, damped = (fit_lobes(exact, 1, ridge=ridge) for ridge in (RIDGE, 1e-3))
    below(np.abs(plain.coefficients - SHAPE).max(), {"float32": 2e-6, "float64": 5e-10}[dtype])
    below(np.abs(damped.coefficients), 0.9995 * np.abs(SHAPE))


def test_more_lobes_than_anything_needs(dtype):
    target = np.random.default_rng(0).normal(size=4).astype(dtype)  # order 2: one lobe is enough
    fit = typed(fit_lobes(target, 6), dtype)
    below(relative_error(target, fit), NEAR[dtype])
    below(np.abs(fit.coefficients).max(), 4 * np.linalg.norm(target))


def test_a_constant_is_all_in_the_first_band(dtype):
    for order in (1, 4):
        target = np.zeros(order * order, dtype)
        target[0] = 2.0
        fit = typed(fit_lobes(target, 3), dtype)
        ridge = RIDGE if order == 1 else FINE_RIDGE
        exact = 2 * math.sqrt(4 * math.pi) * 3 / (3 + ridge)
        close(fit.coefficients[:, 0].sum(), exact, {"float32": 3e-7, "float64": 1e-14}[dtype])
        equal(fit.coefficients[:, 1:], 0)
        close(np.linalg.norm(fit.axes, axis=-1), 1, atol=ROUNDED[dtype])


@pytest.mark.parametrize("fit", [fit_lobes, exact_lobes, lambda f: fewest_lobes(f, 3, 0.01)])
def test_nothing_to_fit(fit, dtype):
    for target in (np.zeros(16, dtype), np.zeros((2, 16), dtype)):
        lobes = typed(fit(target), dtype)
        equal(lobes.coefficients, 0)
        close(np.linalg.norm(lobes.axes, axis=-1), 1, atol=ROUNDED[dtype])
        assert relative_error(target, lobes) == 0.0
    assert typed(fit(np.zeros((0, 16), dtype)), dtype).axes.shape[0] == 0
    assert typed(fit(np.zeros((2, 0, 16), dtype)), dtype).coefficients.shape[:2] == (2, 0)


def test_a_black_channel_beside_others(dtype):
    target = np.random.default_rng(1).normal(size=(3, 16)).astype(dtype)
    target[1] = 0
    fit = fit_lobes(target, 2)
    equal(fit.coefficients[1], 0)
    alone = fit_lobes(target[[0, 2]], 2)
    close(fit.axes[[0, 2]], alone.axes, atol=ROUNDED[dtype])
    close(fit.coefficients[[0, 2]], alone.coefficients, atol=ROUNDED[dtype])


@pytest.mark.parametrize("share", [-1.0, -0.1, 0.1, 1.0])
def test_dim_and_glaring_lights_are_fitted_alike(share, dtype):
    """So dim or so bright that their squares are no numbers any more."""
    target = np.random.default_rng(2).normal(size=16).astype(dtype)
    scale = np.dtype(dtype).type({"float32": 1e30, "float64": 1e300}[dtype] ** share)
    fit, scaled = (typed(fit_lobes(light, 2), dtype) for light in (target, target * scale))
    atol = {"float32": 2e-6, "float64": 5e-14}[dtype]
    close(scaled.axes, fit.axes, atol=atol)
    close(scaled.coefficients / scale, fit.coefficients, atol=atol)
    missed = relative_error(target * scale, scaled)
    close(missed, relative_error(target, fit), {"float32": 1e-6, "float64": 5e-15}[dtype])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("fit", [fit_lobes, exact_lobes, lambda f: fewest_lobes(f, 3, 0.01)])
def test_what_is_not_finite_is_refused(fit, bad):
    target = np.ones((2, 16))
    target[1, 5] = bad
    with refuses(ValueError, match="not finite"):
        fit(target)


def test_impossible_requests_are_refused():
    with refuses(ValueError, match="at least one lobe"):
        fit_lobes(np.ones(9), 0)
    with refuses(ValueError, match="at least one lobe"):
        fewest_lobes(np.ones(9), 0, 0.1)
    with refuses(ValueError, match="not a square"):
        fit_lobes(np.ones(8))


def test_bands_that_cannot_tell_an_axis_from_its_opposite(dtype):
    even = Lobes(np.array([[0.48, 0.6, 0.64]]), np.array([[0.3, 0.0, 1.0, 0.0, -0.4]]))
    fit = fit_lobes(even.harmonics().astype(dtype), 1)
    close(abs(fit.axes[0] @ even.axes[0]), 1, ROUNDED[dtype])
    close(fit.coefficients, even.coefficients, atol=NEAR[dtype])


def test_exact_lobes_turn_exactly(dtype):
    target = np.random.default_rng(3).normal(size=(3, 36)).astype(dtype)
    for turn in (*Rotation.random(3, rng=0).as_matrix(), np.diag([1.0, -1, -1])):
        turned = exact_lobes(target).rotated(turn).harmonics()
        expected = rotate(target.astype(np.float64), turn)
        close(turned, expected, atol={"float32": 2e-5, "float64": 2e-14}[dtype])


def planted(seed: int, count: int, order: int) -> np.ndarray:
    """A sum of lobes about axes that are 45° apart or more, opposites being the same."""
    rng = np.random.default_rng(seed)
    while True:
        axes = rng.normal(size=(count, 3))
        axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
        if np.abs(np.triu(axes @ axes.T, 1)).max() < math.sqrt(0.5):
            return Lobes(axes, rng.normal(size=(count, order))).harmonics()


@pytest.mark.parametrize("order", [4, 6])
@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_planted_lobes_come_back_as_a_function(count, order, dtype):
    target = np.stack([planted(seed, count, order) for seed in range(4)]).astype(dtype)
    starts = 256 if count == 4 else 64  # there are local minima
    fit = typed(fit_lobes(target, count, starts), dtype)
    for function, lobes in zip(target, fit.harmonics(), strict=True):
        below(np.linalg.norm(lobes - function), 1e-5 * np.linalg.norm(function))
    below(np.abs(fit.coefficients).max(), 100 * np.linalg.norm(target, axis=-1).max())


def test_two_lobes_that_merge_are_followed_into_one(dtype):
    shapes = np.stack([SHAPE, [0.2, 0.9, -0.8, 0.5]])
    lobes = None
    for angle in (*np.linspace(1.0, 0.0, 21), *np.linspace(0.0, 1.0, 21)[1:]):
        axes = np.array([[math.sin(angle), 0, math.cos(angle)], [0.0, 0.0, 1.0]])
        target = Lobes(axes, shapes).harmonics()[None].astype(dtype)
        lobes = fit_lobes(target, 2) if lobes is None else follow_lobes(target, lobes)
        below(relative_error(target, typed(lobes, dtype)), 1e-5)  # of the ridge
        below(np.abs(lobes.coefficients).max(), 20)
    below(relative_error(target, lobes), {"float32": 1e-6, "float64": 1e-7}[dtype])  # parted again


def test_following_nothing_leaves_axes_where_they_are(dtype):
    before = Lobes(np.tile(POLES, (3, 1, 1)).astype(dtype), np.ones((3, 2, 4), dtype))
    lobes = typed(follow_lobes(np.zeros((3, 16), dtype), before), dtype)
    equal(lobes.axes, before.axes)
    equal(lobes.coefficients, 0)
    none = typed(follow_lobes(np.zeros((0, 16), dtype), before[:0]), dtype)
    assert none.axes.shape == (0, 2, 3)
    dark = Lobes(before.axes, 0 * before.coefficients)
    equal(typed(aligned(dark, before), dtype).axes, before.axes)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_a_linear_function_is_one_lobe(count, dtype):
    target = np.zeros(25, dtype)
    target[1:4] = [0.3, -0.2, 0.9]
    fit = fit_lobes(target, count)
    below(relative_error(target, fit), NEAR[dtype])
    if count == 1:
        axis = np.array([-0.9, -0.3, -0.2])
        close(fit.axes[0], axis / np.linalg.norm(axis), atol=ROUNDED[dtype])


@pytest.mark.parametrize("count", [2, 3])
def test_even_bands_alone_are_fitted_as_functions(count, dtype):
    shapes = np.random.default_rng(count).normal(size=(count, 5)) * [1, 0, 1, 0, 1]
    axes = Rotation.random(rng=3).as_matrix()[:count]
    target = Lobes(axes, shapes).harmonics().astype(dtype)
    missed = relative_error(target, fit_lobes(target, count))
    below(missed, {"float32": 2e-6, "float64": 3e-7}[dtype])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-6, 1e-3])
def test_systems_that_are_nearly_singular_give_numbers(angle, dtype):
    axes = np.array([[0.0, 0, 1], [math.sin(angle), 0, math.cos(angle)], [0, 0, -1], [1, 0, 0]])
    axes, target = axes.astype(dtype), np.random.default_rng(0).normal(size=(1, 36)).astype(dtype)
    for ridge in (RIDGE, 1e-10):
        value, slope = Misfit(target, ridge)(np.arange(1), axes.T.reshape(-1, 1))
        above(value[0], 0)
        below(value[0], np.square(target).sum())
        finite(slope)
    lobes = typed(follow_lobes(target, Lobes(axes[None], np.zeros((1, 4, 6), dtype))), dtype)
    below(relative_error(target, lobes), 0.7)
    below(np.abs(lobes.coefficients).max(), 200 * np.linalg.norm(target))


def flat_texture(size: int, order: int, dtype: str) -> np.ndarray:
    """The transfer of a plane that nothing shades at every texel, (size, size, n²)."""
    cosine = sh.project_function(lambda s: np.maximum(s[:, 2], 0.0) / math.pi, order)
    return np.tile(cosine, (size, size, 1)).astype(dtype)


@pytest.mark.parametrize("count", [1, 3])
def test_a_flat_patch_is_the_same_everywhere(count, dtype):
    target = flat_texture(7, 6, dtype).reshape(-1, 36)
    weights = bilinear((7, 7), (4, 4))
    found = coherent_lobes(target, weights, count)
    assert found.low.dtype == dtype
    axes = typed(found.lobes, dtype).axes
    close(interpolated(found, weights).harmonics(), target, atol=1e-5)  # of the ridge
    close(axes, np.broadcast_to(axes[0], axes.shape), atol=ROUNDED[dtype])
    dark = coherent_lobes(0.0 * target, weights, count)
    equal(dark.harmonics(), 0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_one_pit_of_infinite_depth(count, dtype):
    texture = flat_texture(9, 6, dtype)
    texture[4, 4] = 0.0  # its bottom sees nothing
    target, weights = texture.reshape(-1, 36), bilinear((9, 9), (9, 9))
    found = interpolated(coherent_lobes(target, weights, count), weights)
    missed = np.linalg.norm(found.harmonics() - target, axis=-1)
    close(missed, 0, atol=1e-5 * np.linalg.norm(target[0]))
    # What lies between a texel and the pit is between the two.
    fine = bilinear((17, 17), (9, 9))
    wanted = (fine @ target).astype(dtype)
    between = interpolated(coherent_lobes(wanted, fine, count), fine).harmonics()
    close(between, wanted, atol=1e-5)


def test_a_texture_of_a_constant_or_a_single_texel(dtype):
    weights = bilinear((3, 3), (2, 2))
    for order in (1, 2, 4):
        target = np.zeros((9, order * order), dtype)
        target[:, 0] = 2.0
        found = interpolated(coherent_lobes(target, weights, 3), weights)
        close(found.harmonics(), target, atol=1e-5)
    one = np.random.default_rng(0).normal(size=(1, 16)).astype(dtype)
    found = coherent_lobes(one, bilinear((1, 1), (1, 1)), 4)
    typed(found.lobes, dtype)
    below(np.linalg.norm(found.harmonics() - one), 3e-5 * np.linalg.norm(one))
