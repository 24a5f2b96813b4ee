from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.errors import PrtnetError
from prtnet.light import load_light
from prtnet.presets import PRESETS
from tests.prtnet.test_exr import write
from tests.prtnet.test_hdr import encode, flat

PICTURE = np.random.default_rng(4).uniform(0.1, 9, (16, 32, 3)).astype(np.float32)


def test_presets_and_both_kinds_of_files(tmp_path):
    for name, preset in PRESETS.items():
        assert environment(name).source is preset
    hdr, exr = tmp_path / "sky.hdr", tmp_path / "sky.EXR"
    hdr.write_bytes(flat(encode(PICTURE)))
    write(exr, {"RGB": PICTURE})
    directions = sh.fibonacci_sphere(100)
    expected = Picture(PICTURE).radiance(directions)
    np.testing.assert_array_equal(environment(exr).radiance(directions), expected)
    np.testing.assert_allclose(environment(hdr).radiance(directions), expected, atol=9 / 128)


def test_radiance_and_coefficients_turn_alike():
    light = np.random.default_rng(0).normal(size=(16, 3))

    class BandLimited:
        def radiance(self, directions: np.ndarray) -> np.ndarray:
            return sh.evaluate(directions, 4) @ light

        def harmonics(self, order: int) -> np.ndarray:
            return light[: order * order]

    first, second = Rotation.random(2, rng=1).as_matrix()
    turned = Environment(BandLimited()).rotated(first).rotated(second)
    directions = sh.fibonacci_sphere(200)
    expected = sh.evaluate(directions @ second @ first, 4) @ light  # f(R⁻¹ s), R = second·first
    np.testing.assert_allclose(turned.radiance(directions), expected, atol=1e-12)
    found = sh.evaluate(directions, 4) @ turned.harmonics(4)
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize(("degrees", "axis"), [(0, (0, 0, 1)), (90, (1, 0, 0)), (-90, (-1, 0, 0))])
def test_turning_goes_from_the_front_to_the_left_of_the_character(degrees, axis):
    texels = np.zeros((64, 128, 3))
    texels[32, 96] = 1.0  # +z
    light = Environment(Picture(texels)).turned(degrees).harmonics(2)[:, 0]
    found = np.array([-light[3], -light[1], light[2]])
    np.testing.assert_allclose(found / np.linalg.norm(found), axis, atol=0.06)


def test_turning_twice_adds_up():
    sky = environment("sky")
    np.testing.assert_allclose(
        sky.turned(30).turned(15).harmonics(4), sky.turned(45).harmonics(4), atol=1e-12
    )


def test_only_rotations_turn_a_light():
    with pytest.raises(ValueError, match="reflection"):
        environment("sky").rotated(np.diag([1.0, 1.0, -1.0]))


def test_dering_is_the_window_of_the_paper():
    sky = environment("sky")
    expected = sky.harmonics(4) * sh.window(4, 0.05)[:, None]
    np.testing.assert_allclose(sky.harmonics(4, dering=0.05), expected)
    np.testing.assert_allclose(load_light("sky", 4, 0.05), expected, rtol=1e-6)


def test_unknown_lights_are_refused(tmp_path):
    with pytest.raises(PrtnetError, match="did you mean 'studio'"):
        environment("studo")
    with pytest.raises(PrtnetError, match="cannot be read"):
        environment(tmp_path / "none.exr")
    write(tmp_path / "square.exr", {"RGB": PICTURE[:, :16]})
    with pytest.raises(PrtnetError, match="twice as wide"):
        environment(tmp_path / "square.exr")


def test_a_real_probe_looks_and_sums_alike(shared_data):
    probe = environment(shared_data / "probes" / "dresden_square_1k.hdr")
    directions, weights = sh.quadrature(600)
    energy = weights @ probe.radiance(directions) / math.sqrt(4 * math.pi)
    np.testing.assert_allclose(probe.harmonics(1)[0], energy, rtol=0.01)
