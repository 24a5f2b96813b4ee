"""Operators on visibility vectors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.operators import cosine_matrix


def hemisphere_rule(degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact for polynomials over z ≥ 0: Gauss–Legendre on [0, 1] times uniform azimuth."""
    nodes, node_weights = np.polynomial.legendre.leggauss(degree // 2 + 1)
    z, count = (nodes + 1.0) / 2.0, degree + 1
    azimuth = 2.0 * math.pi / count * np.arange(count)
    sine = np.sqrt(1.0 - z * z)[:, None]
    points = np.stack(
        np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), z[:, None]), axis=-1
    )
    return points.reshape(-1, 3), np.repeat(node_weights / 2.0 * 2.0 * math.pi / count, count)


@pytest.mark.parametrize("order", [1, 2, 4, 7])
def test_cosine_matrix_is_the_integral_over_the_hemisphere(order):
    points, weights = hemisphere_rule(2 * order)
    basis = sh.evaluate(points, order)
    expected = basis.T @ ((weights * points[:, 2])[:, None] * basis)
    np.testing.assert_allclose(cosine_matrix(order), expected, atol=1e-13)


def test_white_furnace():
    # Unoccluded under unit light: ∫ max(z, 0) = π, whatever the order.
    for order in (1, 4, 6):
        white = np.zeros(order * order)
        white[0] = math.sqrt(4.0 * math.pi)
        assert white @ cosine_matrix(order) @ white == pytest.approx(math.pi, rel=1e-13)


def test_cosine_matrix_is_shared_and_read_only():
    assert cosine_matrix(4) is cosine_matrix(4)
    with pytest.raises(ValueError, match="read-only"):
        cosine_matrix(4)[0, 0] = 0.0
