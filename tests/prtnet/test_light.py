from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.equirectangular import project_equirectangular
from prtnet.errors import PrtnetError
from prtnet.light import load_light
from tests.prtnet.test_equirectangular import axis_of
from tests.prtnet.test_hdr import encode, flat


def test_a_file_is_the_projection_of_its_picture(tmp_path):
    picture = np.random.default_rng(4).uniform(0.1, 9, (8, 16, 3))
    path = tmp_path / "sky.hdr"
    path.write_bytes(flat(encode(picture)))
    light = load_light(str(path), order=3)
    assert light.shape == (9, 3)
    assert light.dtype == np.float32
    # RGBE cuts off less than 1/128 of the brightest channel.
    bound = 4 * math.pi / math.sqrt(4 * math.pi) * 9 / 128
    assert np.abs(light - project_equirectangular(picture, 3)).max() < 2 * bound


def test_a_real_probe_is_brighter_above_and_without_a_tilt_of_the_horizon(shared_data):
    light = load_light(shared_data / "probes" / "dresden_square_1k.hdr")
    assert light.shape == (16, 3)
    assert np.isfinite(light).all()
    assert (axis_of(light[:, 1]) @ [0, 1, 0]) > 0.7


def test_lower_orders_are_the_first_bands_of_higher_ones():
    np.testing.assert_allclose(load_light("studio", 3), load_light("studio", 6)[:9], atol=1e-5)


def test_dering_keeps_the_energy_and_calms_the_ripples():
    directions = sh.fibonacci_sphere(3000)
    plain, calm = load_light("studio"), load_light("studio", dering=0.05)
    np.testing.assert_array_equal(plain[0], calm[0])
    basis = sh.evaluate(directions, 4)
    assert (basis @ calm).min() > 0.5 * (basis @ plain).min()
    assert (basis @ plain).min() < 0


def test_unknown_names_get_a_suggestion():
    with pytest.raises(PrtnetError, match=r"did you mean 'studio'.*sunset"):
        load_light("studo")


def test_files_that_are_no_panorama_are_refused(tmp_path):
    path = tmp_path / "square.hdr"
    path.write_bytes(flat(encode(np.ones((4, 4, 3)))))
    with pytest.raises(PrtnetError, match="twice as wide"):
        load_light(path)
    with pytest.raises(PrtnetError, match="cannot be read"):
        load_light(tmp_path / "none.hdr")


def test_a_light_beyond_floats_is_refused(tmp_path):
    path = tmp_path / "nova.hdr"
    path.write_bytes(flat(np.full((4, 8, 4), 255, dtype=np.uint8)))
    with pytest.raises(PrtnetError, match="too bright"):
        load_light(path)
