"""Equation 22 by quadrature against the coefficients of equation 23."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.membrane import membrane_field, membrane_lobes
from prtnet.transfer import Patch


def response(s: np.ndarray, alpha: float) -> np.ndarray:
    """Equation 22 over π, for the normal +z."""
    return np.where(s[:, 2] >= 0, s[:, 2], -alpha * s[:, 2]) / math.pi


@pytest.mark.parametrize("alpha", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("order", [1, 2, 6, 9])
def test_coefficients_are_those_of_the_response(alpha: float, order: int) -> None:
    # Each hemisphere by itself: on it the response is a polynomial.
    z, weight = np.polynomial.legendre.leggauss(order + 2)
    expected = np.zeros(order**2)
    for side in (0.5, -0.5):
        height = side * (z + 1.0)
        s = np.stack([np.sqrt(1 - height**2), 0 * height, height], axis=1)
        mean = math.pi * (weight * response(s, alpha)) @ sh.evaluate(s, order)
        zonal = np.arange(order) * (np.arange(order) + 1)
        expected[zonal] += mean[zonal]
    found = membrane_lobes(alpha, order)
    np.testing.assert_allclose(found.harmonics(), expected, atol=1e-14)


def test_opaque_membrane_is_matte_and_clear_one_has_two_alike_sides() -> None:
    up, down = np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]])
    clear = membrane_lobes(1.0, 6).harmonics()
    assert sh.evaluate(up, 6)[0] @ clear == pytest.approx(sh.evaluate(down, 6)[0] @ clear)
    white = np.array([math.sqrt(4 * math.pi), 0, 0, 0])
    assert membrane_lobes(0.0, 2).harmonics() @ white == pytest.approx(1.0)
    assert membrane_lobes(0.5, 2, albedo=0.4).harmonics() @ white == pytest.approx(0.6)


def test_map_has_a_lobe_of_its_own_everywhere() -> None:
    alpha = np.linspace(0, 1, 6).reshape(2, 3)
    field = membrane_field(alpha, (0.3, 0.2), order=4, albedo=0.5)
    assert isinstance(field.layout, Patch)
    assert field.layout.heights.shape == (2, 3)
    for point, share in enumerate(alpha.ravel()):
        expected = membrane_lobes(share, 4, 0.5).harmonics()
        np.testing.assert_allclose(field.vectors[point], expected, atol=1e-7)


@pytest.mark.parametrize("alpha", [-0.1, 1.1, math.nan])
def test_shares_beyond_all_are_refused(alpha: float) -> None:
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        membrane_lobes(alpha, 4)
    with pytest.raises(ValueError, match=r"\[0, 1\]"):
        membrane_lobes(0.5, 4, albedo=alpha)
