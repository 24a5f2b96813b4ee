"""The material of 1D BRDFs as what rays ask it for."""

from __future__ import annotations

import numpy as np
import pytest

from prtnet import sh
from prtnet.brdf import mirrored
from prtnet.one_dimensional import OneDimensional

DIRECTIONS, WEIGHTS = sh.quadrature(600)


def reflected(material: OneDimensional, view: np.ndarray) -> np.ndarray:
    """∫ f cos over the hemisphere, (3,)."""
    cosine = np.maximum(DIRECTIONS[:, 2], 0.0)
    return (WEIGHTS * cosine) @ material(DIRECTIONS, view)


@pytest.mark.parametrize("alpha", [0.0, 1.0, 7.3, 40.0])
def test_seen_from_above_it_reflects_its_parts(alpha):
    """The lobe's integral is 1: its factor is what it reflects, and light behind has no say."""
    material = OneDimensional((0.1, 0.2, 0.3), (0.5, 0.4, 0.3), alpha, 0.9)
    seen = reflected(material, np.array([0.0, 0.0, 1.0]))
    assert seen == pytest.approx([0.6, 0.6, 0.6], rel=6e-3)


def test_the_part_of_the_lobe_below_the_horizon_reflects_nothing():
    """α = 1: over the part of the lens between two hemispheres, (1 + cos t)/2 of it."""
    material, view = OneDimensional(0.0, 1.0, 1.0), np.array([0.6, 0.0, 0.8])
    assert reflected(material, view) == pytest.approx(np.full(3, 0.9), rel=3e-3)


def test_what_is_divided_by_the_cosine_comes_back_with_it():
    material, view = OneDimensional(0.0, 0.7, 5.0), np.array([0.8, 0.0, 0.6])
    light = DIRECTIONS[(DIRECTIONS[:, 2] > 0) & (DIRECTIONS @ mirrored(view) > 0)]
    lobe = 0.7 * 6.0 / (2.0 * np.pi) * (light @ mirrored(view)) ** 5
    got = material(light, view) * light[:, 2:]
    assert got == pytest.approx(np.repeat(lobe[:, None], 3, axis=1))


def test_a_mirror_of_any_exponent_stays_finite():
    material = OneDimensional(0.2, 0.4, 1e30)
    assert np.isfinite(material(DIRECTIONS, np.array([0.6, 0.0, 0.8]))).all()
    assert material.lets_light_through is False
    assert OneDimensional(transmitted=(0.0, 0.1, 0.0)).lets_light_through
