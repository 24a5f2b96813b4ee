from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.operators import cosine_matrix
from prtnet.presets import PRESETS, Disc, Lamp, Preset

BLACK = (0.0, 0.0, 0.0)
WHITE = (1.0, 1.0, 1.0)


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_lights(name):
    directions, weights = sh.quadrature(400)  # the sun is small
    radiance = PRESETS[name].radiance(directions)
    assert (radiance >= 0).all()
    light = PRESETS[name].harmonics(4)
    assert light.shape == (16, 3)
    # Energy is kept, and no unoccluded surface is lit by less than nothing.
    np.testing.assert_allclose(light[0] * math.sqrt(4 * math.pi), weights @ radiance, rtol=1e-4)
    cosine = cosine_matrix(4)[:, 0] * math.sqrt(4 * math.pi)  # max(z, 0) itself
    band = np.arange(4)
    zonal = cosine[band * (band + 1)] * np.sqrt(4 * np.pi / (2 * band + 1))
    kernel = sh.evaluate(directions, 4) * zonal[sh.bands(4)]
    assert (kernel @ light > 0).all()


@pytest.mark.parametrize("name", PRESETS)
def test_the_coefficients_are_those_of_the_radiance(name):
    preset = PRESETS[name]
    expected = sh.project_function(preset.radiance, 6, degree=400)
    # The horizon is a kink, which quadrature gets to a few parts in a million.
    np.testing.assert_allclose(preset.harmonics(6), expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.parametrize("sharpness", [1e-3, 7.0, 2000.0, 1e6])
def test_a_lamp_of_any_sharpness_has_its_energy(sharpness):
    # 2π∫exp(κ(z − 1)) dz = 2π(1 − e^(−2κ))/κ
    energy = 2 * math.pi * -math.expm1(-2 * sharpness) / sharpness
    zonal = Lamp(0.0, 90.0, sharpness, WHITE).zonal(6)
    assert zonal[0] == pytest.approx(energy)
    assert (np.diff(zonal) < 0).all()
    if sharpness > 1e5:  # as good as a point
        np.testing.assert_allclose(zonal, energy, rtol=1e-4)


def test_a_disc_is_even_inside_and_dark_outside():
    disc = Disc(30.0, 20.0, 10.0, 15.0, (3.0, 2.0, 1.0))
    axis = np.array([math.sin(math.radians(30)), 0, math.cos(math.radians(30))])
    axis = axis * math.cos(math.radians(20)) + [0, math.sin(math.radians(20)), 0]
    across = np.cross(axis, [0, 1.0, 0])
    across /= np.linalg.norm(across)
    for angle, share in ((0.0, 1), (9.9, 1), (15.1, 0), (180.0, 0)):
        s = math.cos(math.radians(angle)) * axis + math.sin(math.radians(angle)) * across
        np.testing.assert_allclose(disc.radiance(s[None])[0], share * np.array([3.0, 2.0, 1.0]))
    middle = (math.cos(math.radians(10)) + math.cos(math.radians(15))) / 2
    assert disc.profile(np.array([middle])).item() == pytest.approx(0.5)


def test_a_disc_has_half_the_energy_of_its_rim():
    # The rim is antisymmetric in the cosine about its middle: it counts as a step there.
    disc = Disc(0.0, 0.0, 25.0, 40.0, WHITE)
    middle = (math.cos(math.radians(25)) + math.cos(math.radians(40))) / 2
    assert disc.zonal(1)[0] == pytest.approx(2 * math.pi * (1 - middle))


def test_lamps_shine_from_where_they_say():
    for azimuth, elevation, axis in ((0, 0, (0, 0, 1)), (90, 0, (1, 0, 0)), (0, 90, (0, 1, 0))):
        for lamp in (
            Lamp(azimuth, elevation, 20.0, WHITE),
            Disc(azimuth, elevation, 5.0, 9.0, WHITE),
        ):
            light = Preset((lamp,), BLACK, BLACK, BLACK).harmonics(2)[:, 0]
            found = np.array([-light[3], -light[1], light[2]])  # conventions: the linear axis
            np.testing.assert_allclose(found / np.linalg.norm(found), axis, atol=1e-12)


def test_an_even_dome_is_constant():
    grey = (0.5, 0.5, 0.5)
    expected = np.zeros((16, 3))
    expected[0] = 0.5 * math.sqrt(4 * math.pi)
    np.testing.assert_allclose(Preset((), grey, grey, grey).harmonics(4), expected, atol=1e-14)
