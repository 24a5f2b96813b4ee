from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet.wrinkle import Wrinkle


def test_profile_is_a_groove_between_flats() -> None:
    wrinkle = Wrinkle(width=0.02, deepest=0.01)
    x = np.array([-1.0, 0.0, 0.25, 0.5, 1.0, 3.0])
    expected = [0, 0, -0.002, -0.004, 0, 0]
    np.testing.assert_allclose(wrinkle.heights(x, 0.004), expected, atol=1e-17)


def test_normals_are_of_the_profile() -> None:
    wrinkle = Wrinkle(width=0.02, deepest=0.01)
    x, step = np.linspace(0.01, 0.99, 50), 1e-6
    rise = wrinkle.heights(x + step, 0.007) - wrinkle.heights(x - step, 0.007)
    slope = rise / (2 * step * wrinkle.width)
    n = wrinkle.normals(x, 0.007)
    np.testing.assert_allclose(-n[:, 0] / n[:, 2], slope, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0)
    np.testing.assert_array_equal(wrinkle.normals(np.array([-0.5, 1.5]), 0.007)[:, 2], 1.0)


def test_coordinates_meet_the_middles_of_texels() -> None:
    wrinkle = Wrinkle(width=0.02, deepest=0.01, columns=5, rows=3)
    column, row = np.meshgrid(np.arange(5), np.arange(3))
    found = wrinkle.coordinates(column / 4 * 0.02, wrinkle.depths[row])
    np.testing.assert_allclose(found[..., 0] * 5 - 0.5, column, atol=1e-12)
    np.testing.assert_allclose(found[..., 1] * 3 - 0.5, row, atol=1e-12)
    beyond = wrinkle.coordinates(np.array([-1.0, 1.0]), np.array([0.0, 9.0]))
    np.testing.assert_allclose(beyond, [[0.1, 0.5 / 3], [0.9, 2.5 / 3]])


@pytest.mark.parametrize(
    "change",
    [{"width": 0}, {"deepest": math.inf}, {"width": math.nan}, {"columns": 1}, {"rows": 0}],
)
def test_families_that_are_none(change: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="wrinkle"):
        Wrinkle(**change)  # type: ignore[arg-type]
