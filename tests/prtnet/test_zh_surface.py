from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh, zh_surface
from prtnet.zh import LobesApart, apart, zonal_energy
from prtnet.zh_fit import fit_lobes
from prtnet.zh_surface import (
    Surface,
    beginnings,
    bilinear,
    coherent_lobes,
    cone,
    interpolants,
    interpolated,
    with_midpoints,
)


def wrinkle(size: int, order: int = 5) -> np.ndarray:
    """Diffuse transfer (size, size, n²) of grooves z = −d cos² πx: by depth d, then by x.

    The paper's wrinkle. A groove is the same along y, so a direction is free where its slope in
    the x, z plane is above that of the groove's highest rim.
    """
    s = sh.fibonacci_sphere(400)
    basis = sh.evaluate(s, order)
    grid = np.linspace(-1.5, 1.5, 301)

    def height(x, depth):
        return np.where(np.abs(x) < 0.5, -depth * np.cos(math.pi * x) ** 2, 0.0)

    result = np.empty((size, size, order * order))
    for row, depth in enumerate(np.linspace(0.0, 1.0, size)):
        for column, x in enumerate(np.linspace(-0.7, 0.7, size)):
            tangent = depth * math.pi * math.sin(2 * math.pi * x) if abs(x) < 0.5 else 0.0
            to_right, to_left = grid[grid > x + 0.005], grid[grid < x - 0.005]
            slopes = [
                (height(there, depth) - height(x, depth)) / (there - x)
                for there in (to_right, to_left)
            ]
            right, left = slopes[0].max(initial=tangent), slopes[1].min(initial=tangent)
            free = np.where(s[:, 0] > 0, s[:, 2] > right * s[:, 0], s[:, 2] > left * s[:, 0])
            normal = np.array([-tangent, 0.0, 1.0]) / math.hypot(tangent, 1.0)
            result[row, column] = (np.maximum(s @ normal, 0.0) * free) @ basis / 100.0
    return result


@pytest.fixture(scope="module")
def groove():
    return wrinkle(17)


def error(found: LobesApart, target: np.ndarray) -> float:
    return float(np.linalg.norm(found.harmonics() - target) / np.linalg.norm(target))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_what_lies_between_the_knots_of_a_wrinkle_is_right_too(groove, count):
    flat, weights = groove.reshape(-1, 25), bilinear((17, 17), (9, 9))
    together = error(
        interpolated(coherent_lobes(flat, weights, count, iterations=120), weights), flat
    )
    knots = groove[::2, ::2].reshape(-1, 25)
    single = interpolated(apart(knots, fit_lobes(knots, count, starts=4)), weights)
    by_themselves = error(single, flat)
    assert together < {1: 0.17, 2: 0.11, 3: 0.085}[count]
    assert together < by_themselves
    if count > 1:  # lobes that do not correspond
        assert by_themselves > 3 * together
        assert error(apart(flat, fit_lobes(flat, count, starts=4)), flat) < together


def test_lobes_change_little_from_knot_to_knot(groove):
    weights = bilinear((17, 17), (9, 9))
    found = coherent_lobes(groove.reshape(-1, 25), weights, 3, iterations=120)
    knots = groove[::2, ::2].reshape(-1, 25)

    def share_near(axes: np.ndarray) -> float:
        """Of the axes of neighbours, those less than 60° apart."""
        grid = axes.reshape(9, 9, 3, 3)
        down = (grid[1:] * grid[:-1]).sum(axis=-1).ravel()
        across = (grid[:, 1:] * grid[:, :-1]).sum(axis=-1).ravel()
        return float(np.mean(np.concatenate([down, across]) > 0.5))

    assert share_near(found.lobes.axes) > 0.9
    assert share_near(fit_lobes(knots, 3, starts=4).axes) < 0.75
    assert (found.lobes.coefficients[..., :2] == 0).all()
    np.testing.assert_allclose(
        found.low, interpolants(groove.reshape(-1, 25), weights)[:, :4], atol=1e-9
    )


def test_the_same_every_time_in_the_dtype_given(groove):
    weights = bilinear((17, 17), (5, 5))
    flat = groove.reshape(-1, 25).astype(np.float32)
    one, other = (coherent_lobes(flat, weights, 2, iterations=60) for _ in range(2))
    np.testing.assert_array_equal(one.lobes.axes, other.lobes.axes)
    assert one.low.dtype == one.lobes.axes.dtype == one.lobes.coefficients.dtype == np.float32
    assert one.lobes.axes.shape == (25, 2, 3)


def test_further_iterations_go_on_from_a_start(groove):
    weights, flat = bilinear((17, 17), (9, 9)), groove.reshape(-1, 25)
    few = coherent_lobes(flat, weights, 3, iterations=20)
    more = coherent_lobes(flat, weights, 3, start=few.lobes, iterations=60)
    assert error(interpolated(more, weights), flat) < error(interpolated(few, weights), flat)


def test_the_better_of_two_beginnings_goes_on(groove):
    weights, flat = bilinear((17, 17), (9, 9)), groove.reshape(-1, 25)
    starts = beginnings(flat, interpolants(flat, weights), 3)
    few = zh_surface.FIRST_ITERATIONS
    each = [coherent_lobes(flat, weights, 3, start, few) for start in starts]
    errors = [error(interpolated(found, weights), flat) for found in each]
    assert abs(errors[0] - errors[1]) > 1e-3
    chosen = error(interpolated(coherent_lobes(flat, weights, 3, iterations=few), weights), flat)
    assert chosen == pytest.approx(min(errors), rel=1e-3)
    on = coherent_lobes(flat, weights, 3, iterations=2 * few)
    assert error(interpolated(on, weights), flat) < chosen - 1e-4


@pytest.mark.parametrize("count", [1, 3])
def test_the_slope_is_that_of_the_error(monkeypatch, count):
    monkeypatch.setattr(zh_surface, "BLOCK", 4)
    monkeypatch.setattr(zh_surface, "RIDGE", 0.1)
    rng = np.random.default_rng(0)
    weights = bilinear((3, 3), (2, 2))
    target = rng.normal(size=(9, 16))
    with zh_surface.ThreadPoolExecutor(1) as pool:
        surface = Surface(target, weights, count, pool)
        unknowns = rng.normal(
            size=surface.packed(coherent_lobes(target, weights, count).lobes).size
        )
        slope, step = surface.objective(unknowns)[1], 1e-6
        for place in range(len(unknowns)):
            moved = np.zeros_like(unknowns)
            moved[place] = step
            ahead, behind = (surface.objective(unknowns + s * moved)[0] for s in (1, -1))
            assert slope[place] == pytest.approx((ahead - behind) / (2 * step), rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_the_objective_is_the_error_of_what_is_interpolated(monkeypatch, count):
    monkeypatch.setattr(zh_surface, "RIDGE", 0.1)
    rng = np.random.default_rng(1)
    weights, target = bilinear((5, 4), (3, 2)), rng.normal(size=(20, 25))
    low = 4 if count >= 3 else 1
    with zh_surface.ThreadPoolExecutor(1) as pool:
        surface = Surface(target, weights, count, pool)
        size = 6 * count * (3 + 5 - (2 if count >= 3 else 1))
        lobes = surface.unpacked(rng.normal(size=size))
        value = surface.objective(surface.packed(lobes))[0]
    found = interpolated(LobesApart(np.zeros((6, 4)), lobes), weights).harmonics()
    missed = np.square(found - target)[:, low:].sum() / 20
    size = (lobes.coefficients**2 @ zonal_energy(np.arange(5))).sum() / 6  # of knots
    assert value == pytest.approx(missed + 0.1 * size)


def test_bilinear_weights_interpolate():
    weights = bilinear((5, 7), (3, 4)).toarray()
    np.testing.assert_allclose(weights.sum(axis=1), 1)
    y, x = np.meshgrid(np.linspace(0, 1, 3), np.linspace(0, 1, 4), indexing="ij")
    fine = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 7), indexing="ij")
    for function in (lambda a, b: 1 + 2 * a - b, lambda a, b: a * 3 + b):
        np.testing.assert_allclose(weights @ function(y, x).ravel(), function(*fine).ravel())
    np.testing.assert_array_equal(bilinear((4, 1), (4, 1)).toarray(), np.eye(4))


def test_tiled_weights_go_round():
    weights = bilinear((8, 1), (4, 1), tiled=True).toarray()
    np.testing.assert_allclose(weights[::2], np.eye(4))
    np.testing.assert_allclose(weights[7], [0.5, 0, 0, 0.5])


def test_a_mesh_has_samples_between_its_vertices():
    edges = np.array([[0, 1], [2, 1]])
    expected = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5]]
    np.testing.assert_array_equal(with_midpoints(3, edges).toarray(), expected)


def test_a_mesh_is_fitted_by_its_edges(groove):
    vertices = groove[::4, ::4].reshape(-1, 25)
    places = np.arange(25).reshape(5, 5)
    edges = np.concatenate([
        np.stack([places[1:].ravel(), places[:-1].ravel()], axis=1),
        np.stack([places[:, 1:].ravel(), places[:, :-1].ravel()], axis=1),
    ])  # fmt: skip
    weights = with_midpoints(25, edges)
    target = weights @ vertices
    found = coherent_lobes(target, weights, 3)
    assert error(interpolated(found, weights), target) < 0.06


def test_lobes_around_the_linear_axis():
    target = np.zeros((3, 9))
    target[:, 1:4] = [[0, 1, 0], [-1, 0, 0], [0.3, -0.5, 0.2]]
    middle = np.array([[0, 0, 1], [0, 1, 0], [-0.2, -0.3, -0.5]])
    middle /= np.linalg.norm(middle, axis=-1, keepdims=True)
    for count in (1, 2, 3, 5):
        axes = cone(target, count, 0.4, 0.7)
        assert axes.shape == (3, count, 3)
        np.testing.assert_allclose(np.linalg.norm(axes, axis=-1), 1)
        cosine = (axes * middle[:, None]).sum(axis=-1)
        alone = int(count != 2)
        np.testing.assert_allclose(cosine[:, :alone], 1)
        np.testing.assert_allclose(cosine[:, alone:], math.cos(0.4))
    pair = cone(target, 2, 0.4, 0.7)
    np.testing.assert_allclose((pair[:, 0] * pair[:, 1]).sum(axis=-1), math.cos(0.8))


def test_what_does_not_go_together_is_refused():
    with pytest.raises(ValueError, match="weights of 4 samples for 3 functions"):
        coherent_lobes(np.zeros((3, 9)), bilinear((2, 2), (2, 2)), 1)
    with pytest.raises(ValueError, match="do not hold 5 knots"):
        bilinear((4, 4), (5, 2))
