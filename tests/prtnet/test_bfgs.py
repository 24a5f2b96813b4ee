from __future__ import annotations

import numpy as np
import pytest

from prtnet import bfgs
from prtnet.bfgs import Batch, minimise


def rosenbrock(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = points
    value = (1 - x) ** 2 + 100 * (y - x * x) ** 2
    slope = np.stack([-2 * (1 - x) - 400 * x * (y - x * x), 200 * (y - x * x)])
    return value, slope


def valley(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rosenbrock(points)


STARTS = np.array([[-1.2, 1.0], [3.0, -2.0], [1.0, 1.0], [0.0, 0.0]]).T


def test_a_curved_valley_is_followed_to_its_end_by_all_at_once():
    points, values = minimise(valley, STARTS, 100, 1.0, 1e-6)
    np.testing.assert_allclose(points, np.ones((2, 4)), atol=1e-6)
    np.testing.assert_allclose(values, 0, atol=1e-12)


def test_problems_do_not_see_each_other():
    together = minimise(valley, STARTS, 20, 0.5, 0.0)[0]
    for start, end in zip(STARTS.T, together.T, strict=True):
        alone = minimise(valley, start[:, None], 20, 0.5, 0.0)[0][:, 0]
        np.testing.assert_allclose(alone, end, rtol=1e-12)


@pytest.mark.parametrize("width", [1, 3, 8])
def test_problems_that_wait_take_the_room_of_those_that_are_done(monkeypatch, width):
    start = np.random.default_rng(1).normal(size=(2, 30)) * 2
    whole = minimise(valley, start, 30, 0.5, 1e-3)
    monkeypatch.setattr(bfgs, "WIDTH", width)
    asked = []

    def watched(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(which)
        return rosenbrock(points)

    parts = minimise(watched, start, 30, 0.5, 1e-3)
    for part, all_at_once in zip(parts, whole, strict=True):
        np.testing.assert_allclose(part, all_at_once, rtol=1e-12)
    assert max(map(len, asked)) <= width
    np.testing.assert_array_equal(np.unique(np.concatenate(asked)), np.arange(30))


def test_each_problem_is_asked_about_under_its_own_number():
    centres = np.random.default_rng(0).normal(size=(3, 7))

    def bowl(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away = points - centres[:, which]
        return 1 + (away**2).sum(axis=0), 2 * away

    start = np.zeros((3, 7))
    start[:, 2] = centres[:, 2]  # finished before it began
    np.testing.assert_allclose(minimise(bowl, start, 50, 1.0, 0.0)[0], centres, atol=1e-6)


def test_no_point_gets_worse_however_few_the_iterations():
    start = np.random.default_rng(3).normal(size=(2, 50)) * 3
    before = rosenbrock(start)[0]
    for iterations in (0, 1, 3):
        points, values = minimise(valley, start, iterations, 0.5, 0.0)
        assert (values <= before).all()
        np.testing.assert_array_equal(values, rosenbrock(points)[0])
        assert np.abs(points - start).max() <= 0.5 * iterations * (1 + 1e-12)


def test_what_is_good_enough_is_left_where_it_is():
    start = np.random.default_rng(3).normal(size=(2, 50)) * 3
    before = rosenbrock(start)[0]
    bound = np.median(before)
    points, values = minimise(valley, start, 1000, 0.5, 0.0, enough=float(bound))
    assert (values <= bound).all()
    np.testing.assert_array_equal(points[:, before <= bound], start[:, before <= bound])


def test_the_inverse_hessian_satisfies_the_secant_equation_and_stays_positive():
    rng = np.random.default_rng(5)
    change, bend, slope = rng.normal(size=(3, 4, 20))
    uphill = (change * bend).sum(axis=0) > 0
    assert 0 < uphill.sum() < 20
    for taken in (0, 1):
        batch = Batch(lambda _, p: (p[0], p), np.arange(20), np.ones((4, 20)), 1.0)
        batch.inverse *= 2.0
        batch.taken[:] = taken
        newton = batch.updated(change, bend, slope)
        matrices = np.moveaxis(batch.inverse, -1, 0)
        turned = (matrices @ bend.T[..., None])[..., 0]
        np.testing.assert_allclose(turned[uphill], change.T[uphill])
        np.testing.assert_array_equal(
            matrices[~uphill], np.broadcast_to(2.0 * np.eye(4), (sum(~uphill), 4, 4))
        )
        assert (np.linalg.eigvalsh(matrices) > 0).all()
        np.testing.assert_allclose(newton.T, -(matrices @ slope.T[..., None])[..., 0])


def test_nothing_to_minimise():
    def flat(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(points.shape[1]), np.zeros_like(points)

    for count in (0, 3):
        start = np.ones((2, count))
        points, values = minimise(flat, start, 10, 1.0, 1e-3)
        np.testing.assert_array_equal(points, start)
        assert values.shape == (count,)


def test_where_no_step_helps_the_start_comes_back():
    def kink(which: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.abs(points).sum(axis=0), -np.ones_like(points)  # a slope that is not the value's

    points, values = minimise(kink, np.full((1, 1), 0.0), 10, 1.0, 1e-3)
    assert points.item() == 0.0
    assert values.item() == pytest.approx(0.0)
