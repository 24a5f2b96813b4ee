from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import quad

from prtnet.dipole import MATERIALS, Medium, medium_named
from prtnet.errors import PrtnetError


@pytest.mark.parametrize("name", MATERIALS)
def test_integral_over_the_plane_is_the_closed_reflectance(name: str) -> None:
    medium = MATERIALS[name]

    def ring(log_r: float) -> float:
        r = math.exp(log_r)
        return float(2 * math.pi * r * r * medium.profile(np.asarray(r)))

    ends = math.log(1e-4 * medium.depths[0]), math.log(1e5 * medium.depths[0])
    total = quad(ring, *ends, limit=400, epsabs=0, epsrel=1e-9)[0]
    assert total == pytest.approx(medium.reflectance(), rel=1e-6)
    assert 0 < medium.reflectance() < 1


def test_discs_add_up() -> None:
    medium = MATERIALS["skin"]
    radius = np.array([0.0, 1e-4, 1e-3, 1e-2])
    both = medium.within(radius) + medium.beyond(radius)
    np.testing.assert_allclose(both, medium.reflectance(), rtol=1e-12)
    fine = np.linspace(0, 1e-3, 20001)
    rings = 2 * math.pi * fine * medium.profile(fine)
    assert medium.within(np.asarray(1e-3)) == pytest.approx(np.trapezoid(rings, fine), rel=1e-6)


@pytest.mark.parametrize("share", [0.5, 1e-3])
def test_reach_leaves_its_share(share: float) -> None:
    for medium in (*MATERIALS.values(), Medium(1000.0, 0.0)):
        left = float(medium.beyond(np.asarray(medium.reach(share))))
        assert left == pytest.approx(share * medium.reflectance(), rel=1e-6)


def test_boundary_of_no_step_in_index_reflects_nothing_inside() -> None:
    assert Medium(1.0, 0.1, 1.0).boundary == 1.0
    assert Medium(1.0, 0.1, 1.3).boundary == pytest.approx(2.602, abs=1e-3)  # F_dr = 0.4448
    # Without absorption and that step all light comes back.
    assert Medium(1.0, 0.0, 1.0).reflectance() == pytest.approx(1.0)


def test_names_and_numbers() -> None:
    assert medium_named("marble") is MATERIALS["marble"]
    assert medium_named("2.62/0.0041/1.5") == MATERIALS["marble"]
    assert medium_named("1/0").index == 1.3
    for text in ("marbel", "1", "1/2/3/4", "a/b", "0/1", "1/-1", "nan/1", "1/1/9", "inf/0"):
        with pytest.raises(PrtnetError) as caught:
            medium_named(text)
        assert caught.value.subject == "--subsurface"
        assert "\n" not in str(caught.value)
    with pytest.raises(PrtnetError, match="marble"):
        medium_named("marbel")
