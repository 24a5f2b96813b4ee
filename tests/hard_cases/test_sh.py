"""Spherical harmonics where naive formulas break: poles, blocks, empties, degenerate angles."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.sh_rotation import rotate, rotate_zxzxz, rotation_matrix
from tests.hard_cases.measured import close, equal, finite, numbers

POLES = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.0, -0.0, 1.0]])


@pytest.mark.parametrize("evaluate", [sh.evaluate, sh.evaluate_reference])
def test_poles_hold_only_the_zonal_harmonics(evaluate, dtype, put):
    for order in (1, 6, 7, 12):
        value = evaluate(put(POLES), order)
        band = np.arange(order)
        expected = np.zeros((3, order * order))
        expected[:, band * band + band] = np.sqrt((2 * band + 1) / (4.0 * math.pi))
        expected[1] *= (-1.0) ** sh.bands(order)
        close(value, expected, rtol=2e-6 if dtype == "float32" else 1e-13)


@pytest.mark.parametrize("tilt", [1e-30, 1e-12, 1e-6])
def test_next_to_the_pole_the_azimuth_still_counts(tilt, dtype, put):
    # y_l,±1 vanish like the tilt: the leading term keeps full relative precision.
    azimuth = 0.7
    s = np.array([tilt * math.cos(azimuth), tilt * math.sin(azimuth), 1.0])
    value, rtol = sh.evaluate(put(s), 5), {"float32": 2e-6, "float64": 1e-13}[dtype]
    for band in range(1, 5):
        slope = -math.sqrt((2 * band + 1) * band * (band + 1) / (8.0 * math.pi))
        centre = band * band + band
        close(value[centre + 1], slope * s[0], rtol)
        close(value[centre - 1], slope * s[1], rtol)


def test_gradient_at_the_poles_is_that_of_the_neighbourhood(dtype, put):
    for pole in POLES:
        value, atol = sh.gradient(put(pole), 6), {"float32": 1e-5, "float64": 1e-8}[dtype]
        step = 1e-6
        for axis in range(3):
            ends = np.stack([pole + step * np.eye(3)[axis], pole - step * np.eye(3)[axis]])
            ends /= np.linalg.norm(ends, axis=1, keepdims=True)
            ahead, behind = sh.evaluate(ends, 6)
            close(value[:, axis], (ahead - behind) / (2 * step), atol=atol)


def test_high_orders_stay_bounded(dtype, put):
    # Powers of z would have lost everything long before; |y_lm|² ≤ (2l + 1)/4π.
    points = np.concatenate([sh.fibonacci_sphere(500), POLES])
    value = numbers(sh.evaluate(put(points), 40)).astype(np.float64)
    total = np.stack([np.bincount(sh.bands(40), row * row) for row in value])
    expected = (2 * np.arange(40) + 1) / (4.0 * math.pi)
    close(total / expected, 1.0, atol={"float32": 1e-3, "float64": 1e-11}[dtype])


@pytest.mark.parametrize("order", [4, 8])
def test_blocks_leave_no_seam(order, dtype, put):
    points = sh.fibonacci_sphere(2 * sh.BLOCK + 3)
    value = sh.evaluate(put(points), order)
    atol = {"float32": 2e-6, "float64": 1e-13}[dtype]
    close(value, sh.evaluate_reference(points, order), atol=atol)


def test_memory_layout_does_not_matter(dtype):
    points = sh.fibonacci_sphere(60).astype(dtype)
    expected = sh.evaluate(points, 4)
    assert expected.dtype == dtype
    equal(sh.evaluate(np.asfortranarray(points), 4), expected)
    equal(sh.evaluate(points[::-2], 4), expected[::-2])
    turned = sh.evaluate(points.reshape(5, 12, 3).swapaxes(0, 1), 4)
    equal(turned, expected.reshape(5, 12, 16).swapaxes(0, 1))


def test_nothing_in_nothing_out():
    assert sh.evaluate(np.zeros((0, 3)), 4).shape == (0, 16)
    assert sh.evaluate(np.zeros((2, 0, 3), np.float32), 8).shape == (2, 0, 64)
    assert sh.evaluate(torch.zeros((0, 3)), 4).shape == (0, 16)
    assert sh.gradient(np.zeros((0, 3)), 4).shape == (0, 16, 3)
    assert sh.project_samples(np.zeros((0, 2)), np.zeros((0, 3)), 1.0, 3).shape == (9, 2)
    assert rotation_matrix(np.zeros((0, 3, 3)), 4).shape == (0, 16, 16)
    assert rotate(np.zeros((0, 16)), np.zeros((0, 3, 3))).shape == (0, 16)


def test_one_bad_direction_spoils_only_itself(put):
    points = sh.fibonacci_sphere(10)
    points[3] = math.nan
    value = numbers(sh.evaluate(put(points), 4))
    finite(np.delete(value, 3, axis=0))
    assert np.isnan(value[3, 1:]).all()


@pytest.mark.parametrize("angle", [0.0, 1e-30, 1e-9, 1e-7, 1e-4, math.pi - 1e-7, math.pi])
def test_zxzxz_where_its_euler_angles_degenerate(angle, dtype, put):
    # Near the poles only α ± γ is determined; each alone is noise.
    order = 6
    tilt = Rotation.from_rotvec(angle * np.array([math.cos(0.4), math.sin(0.4), 0.0]))
    turn = (tilt * Rotation.from_rotvec([0.0, 0.0, 1.3])).as_matrix()
    vector = put(np.random.default_rng(0).normal(size=order * order))
    atol = {"float32": 2e-5, "float64": 1e-12}[dtype]
    close(rotate_zxzxz(vector, put(turn)), rotate(vector, put(turn)), atol=atol)


def test_half_turns_about_the_axes_are_signs(dtype, put):
    for axis in np.eye(3):
        matrix = numbers(rotation_matrix(put(2.0 * np.outer(axis, axis) - np.eye(3)), 6))
        close(np.abs(matrix), np.eye(36), atol={"float32": 5e-6, "float64": 1e-13}[dtype])


def test_a_thousand_turns_keep_the_norm(dtype, put):
    turns = Rotation.random(1000, random_state=5)
    vector = np.random.default_rng(0).normal(size=36)
    turned = put(vector)
    whole = Rotation.identity()
    for turn in turns:
        turned, whole = rotate(turned, put(turn.as_matrix())), turn * whole
    atol = {"float32": 5e-4, "float64": 1e-10}[dtype]
    close(turned, rotate(vector, whole.as_matrix()), atol=atol)


def test_triple_products_of_high_order_are_exact(dtype, put):
    # The quadrature's degree must grow with all three factors.
    order = 10
    first, second = sh.evaluate(sh.fibonacci_sphere(5), order)[:2]
    product = numbers(sh.product_matrix(put(first)) @ put(second))
    assert product.dtype == dtype
    unit, weights = sh.quadrature(3 * order)
    basis = sh.evaluate_reference(unit, order)
    expected = basis.T @ (weights * (basis @ first) * (basis @ second))
    close(product, expected, atol={"float32": 2e-6, "float64": 1e-14}[dtype])
