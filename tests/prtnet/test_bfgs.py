from __future__ import annotations

import numpy as np
import pytest

from prtnet.bfgs import minimise, updated


def rosenbrock(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = points.T
    value = (1 - x) ** 2 + 100 * (y - x * x) ** 2
    slope = np.stack([-2 * (1 - x) - 400 * x * (y - x * x), 200 * (y - x * x)], axis=-1)
    return value, slope


def valley(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rosenbrock(points)


STARTS = np.array([[-1.2, 1.0], [3.0, -2.0], [1.0, 1.0], [0.0, 0.0]])


def test_a_curved_valley_is_followed_to_its_end_by_all_at_once():
    points, values = minimise(valley, STARTS, 100, 1.0, 1e-6)
    np.testing.assert_allclose(points, np.ones((4, 2)), atol=1e-6)
    np.testing.assert_allclose(values, 0, atol=1e-12)


def test_problems_do_not_see_each_other():
    together = minimise(valley, STARTS, 20, 0.5, 0.0)[0]
    for start, end in zip(STARTS, together, strict=True):
        alone = minimise(valley, start[None], 20, 0.5, 0.0)[0][0]
        np.testing.assert_allclose(alone, end, rtol=1e-12)


def test_each_problem_is_asked_about_under_its_own_number():
    centres = np.random.default_rng(0).normal(size=(7, 3))

    def bowl(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = points - centres[which]
        return 1 + (away**2).sum(axis=-1), 2 * away

    start = np.zeros((7, 3))
    start[2] = centres[2]  # finished before it began
    np.testing.assert_allclose(minimise(bowl, start, 50, 1.0, 0.0)[0], centres, atol=1e-6)


def test_no_point_gets_worse_however_few_the_iterations():
    start = np.random.default_rng(3).normal(size=(50, 2)) * 3
    before = rosenbrock(start)[0]
    for iterations in (0, 1, 3):
        points, values = minimise(valley, start, iterations, 0.5, 0.0)
        assert (values <= before).all()
        np.testing.assert_array_equal(values, rosenbrock(points)[0])
        assert np.abs(points - start).max() <= 0.5 * iterations * (1 + 1e-12)


def test_the_inverse_hessian_satisfies_the_secant_equation_and_stays_positive():
    rng = np.random.default_rng(5)
    change, bend = rng.normal(size=(2, 20, 4))
    uphill = (change * bend).sum(axis=-1) > 0
    assert 0 < uphill.sum() < 20
    matrices = np.tile(2 * np.eye(4), (20, 1, 1))
    for first in (False, True):
        result = updated(matrices, change, bend, first)
        np.testing.assert_allclose((result @ bend[..., None])[uphill, :, 0], change[uphill])
        np.testing.assert_array_equal(result[~uphill], matrices[~uphill])
        assert (np.linalg.eigvalsh(result) > 0).all()


def test_nothing_to_minimise():
    def flat(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(len(points)), np.zeros_like(points)

    for count in (0, 3):
        start = np.ones((count, 2))
        points, values = minimise(flat, start, 10, 1.0, 1e-3)
        np.testing.assert_array_equal(points, start)
        assert values.shape == (count,)


def test_where_no_step_helps_the_start_comes_back():
    def kink(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.abs(points).sum(axis=-1), -np.ones_like(points)  # a slope that is not the value's

    points, values = minimise(kink, np.full((1, 1), 0.0), 10, 1.0, 1e-3)
    assert points.item() == 0.0
    assert values.item() == pytest.approx(0.0)
