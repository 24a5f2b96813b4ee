"""The fast objective against the slow: the basis at every axis, systems solved by LAPACK."""

from __future__ import annotations

import numpy as np
import pytest

from prtnet import sh
from prtnet.zh import best_coefficients, synthesis, zonal_energy
from prtnet.zh_misfit import Misfit


def columns(axes: np.ndarray) -> np.ndarray:
    """Axes (B, N, 3) as the objective takes them, (3N, B)."""
    return np.ascontiguousarray(axes.transpose(2, 1, 0)).reshape(-1, len(axes))


def reference(target: np.ndarray, axes: np.ndarray, ridge: float) -> np.ndarray:
    """‖f̃ − f‖² + ε‖g*‖² by equations 7 and 17, without the first band."""
    order = sh.order_of(target)
    basis = sh.evaluate(axes / np.linalg.norm(axes, axis=-1, keepdims=True), order)
    g = best_coefficients(basis, target, ridge)
    missed = (synthesis(basis, g) - target)[:, 1:]
    energy = zonal_energy(np.arange(1, order))
    return (missed**2).sum(axis=-1) + ridge * (g[..., 1:] ** 2 @ energy).sum(axis=-1)


def slow_slope(target: np.ndarray, axes: np.ndarray, ridge: float) -> np.ndarray:
    """2 Σ_lm ∇(y_lm ∘ h) g*_l (f̃ − f)_lm, equations 20 and 21, (B, N, 3)."""
    order = sh.order_of(target)
    basis = sh.evaluate(axes / np.linalg.norm(axes, axis=-1, keepdims=True), order)
    g = best_coefficients(basis, target, ridge)
    missed = synthesis(basis, g) - target
    weight = 2.0 * g[..., sh.bands(order)] * missed[:, None]
    return (weight[..., None, :] @ sh.gradient(axes, order))[..., 0, :]


@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 8])
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_value_and_slope_are_those_of_the_slow_objective(order, count):
    rng = np.random.default_rng(order)
    target, axes = rng.normal(size=(7, order * order)), rng.normal(size=(7, count, 3))
    axes[0] = [0.0, 0.0, -2.0]  # at a pole, all the same: only the ridge keeps systems regular
    for ridge in (1e-3, 1e-6):
        value, slope = Misfit(target, ridge)(np.arange(7), columns(axes))
        np.testing.assert_allclose(value, reference(target, axes, ridge), atol=1e-9)
        if order > 1:
            expected = columns(slow_slope(target, axes, ridge))
            np.testing.assert_allclose(slope, expected, atol=2e-9 / ridge**0.5)


def test_the_slope_is_the_derivative_of_the_value():
    rng = np.random.default_rng(3)
    objective, points = Misfit(rng.normal(size=(2, 36)), 1e-6), rng.normal(size=(12, 2))
    slope, step = objective(np.arange(2), points)[1], 1e-6
    for row in range(12):
        moved = np.zeros_like(points)
        moved[row] = step
        ahead, behind = (objective(np.arange(2), points + sign * moved)[0] for sign in (1, -1))
        np.testing.assert_allclose(slope[row], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-7)


def test_functions_are_asked_for_by_their_number():
    rng = np.random.default_rng(4)
    target, axes = rng.normal(size=(5, 16)), rng.normal(size=(3, 2, 3))
    which = np.array([4, 0, 4])
    value, slope = Misfit(target, 1e-6)(which, columns(axes))
    other = Misfit(target[which], 1e-6)(np.arange(3), columns(axes))
    np.testing.assert_allclose(value, other[0], rtol=1e-12)
    np.testing.assert_allclose(slope, other[1], rtol=1e-9, atol=1e-12)


def test_the_slope_moves_no_axis_along_itself():
    rng = np.random.default_rng(5)
    axes = rng.normal(size=(6, 3, 3))
    _, slope = Misfit(rng.normal(size=(6, 25)), 1e-6)(np.arange(6), columns(axes))
    along = (slope.reshape(3, 3, 6) * columns(axes).reshape(3, 3, 6)).sum(axis=0)
    np.testing.assert_allclose(along, 0, atol=1e-12)
