from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.errors import PrtnetError
from prtnet.light import PRESETS, load_light, project_equirectangular
from prtnet.operators import cosine_matrix
from prtnet.sh_rotation import rotate
from tests.prtnet.test_hdr import encode, flat


def texel_directions(height: int, width: int, split: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Directions and solid angles of ``split``² points in every texel, as the module says."""
    theta = math.pi * (np.arange(height * split) + 0.5) / (height * split)
    phi = 2 * math.pi * (np.arange(width * split) + 0.5) / (width * split)
    theta, phi = np.meshgrid(theta, phi, indexing="ij")
    sine = np.sin(theta)
    directions = np.stack([-sine * np.cos(phi), np.cos(theta), -sine * np.sin(phi)], axis=-1)
    edges = np.cos(math.pi * np.arange(height * split + 1) / (height * split))
    angles = np.broadcast_to(-np.diff(edges)[:, None], theta.shape) * (2 * math.pi / theta.shape[1])
    return directions.reshape(-1, 3), angles.ravel()


def axis_of(light: np.ndarray) -> np.ndarray:
    """The direction of the linear band (conventions: (−f₁₁, −f₁₋₁, f₁₀)), for one channel."""
    axis = np.array([-light[3], -light[1], light[2]])
    return axis / np.linalg.norm(axis)


@pytest.mark.parametrize("shape", [(1, 2), (7, 14), (64, 128)])
def test_a_constant_sky_is_all_in_the_first_coefficient(shape):
    light = project_equirectangular(np.full((*shape, 3), [2.0, 3.0, 5.0]), 5)
    expected = np.zeros((25, 3))
    expected[0] = np.sqrt(4 * np.pi) * np.array([2.0, 3.0, 5.0])  # ∫ c y₀ = c·4π·√(1/4π)
    np.testing.assert_allclose(light, expected, atol=1e-13)


def test_every_texel_is_integrated_over_its_own_patch_of_the_sphere():
    rng = np.random.default_rng(5)
    picture = rng.uniform(0, 3, (6, 12, 2)) ** 4
    split = 40
    directions, angles = texel_directions(6, 12, split)
    fine = picture.repeat(split, axis=0).repeat(split, axis=1).reshape(-1, 2)
    expected = sh.project_samples(fine, directions, angles, 6)
    # The midpoints of 40² parts of a texel are off by (0.013 rad · l)²/24 or so.
    np.testing.assert_allclose(
        project_equirectangular(picture, 6), expected, atol=4e-4 * np.abs(expected).max()
    )


def test_energy_is_the_sum_of_radiance_times_solid_angle():
    picture = np.random.default_rng(1).uniform(size=(16, 32, 3))
    angles = texel_directions(16, 32)[1]
    assert angles.sum() == pytest.approx(4 * math.pi)
    flux = project_equirectangular(picture, 3)[0] * math.sqrt(4 * math.pi)
    np.testing.assert_allclose(flux, angles @ picture.reshape(-1, 3))


@pytest.mark.parametrize(
    ("row", "column", "axis"),
    [
        (128, 256, (1, 0, 0)),  # the middle of the picture
        (128, 128, (0, 0, -1)),
        (128, 384, (0, 0, 1)),
        (128, 0, (-1, 0, 0)),
        (0, 77, (0, 1, 0)),
        (255, 300, (0, -1, 0)),
    ],
)
def test_where_the_columns_and_rows_look(row, column, axis):
    picture = np.zeros((256, 512, 1))
    picture[row, column] = 1.0
    found = axis_of(project_equirectangular(picture, 2)[:, 0])
    np.testing.assert_allclose(found, axis, atol=0.01)  # within a texel, π/256


def test_a_band_limited_sky_comes_back():
    rng = np.random.default_rng(8)
    light = rng.normal(size=(16, 3))
    directions, _ = texel_directions(128, 256)
    picture = (sh.evaluate(directions, 4) @ light).reshape(128, 256, 3)
    np.testing.assert_allclose(project_equirectangular(picture, 4), light, atol=2e-3)


def test_turning_the_picture_turns_the_light():
    picture = np.random.default_rng(2).uniform(size=(8, 16, 1))
    turned = np.roll(picture, 4, axis=1)  # a quarter to the right: from −z to +x
    quarter = np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]])
    expected = rotate(project_equirectangular(picture, 5).T, quarter).T
    np.testing.assert_allclose(project_equirectangular(turned, 5), expected, atol=1e-12)


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


@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_lights(name):
    directions, weights = sh.quadrature(60)
    radiance = PRESETS[name].radiance(directions)
    assert (radiance >= 0).all()
    light = load_light(name, 4)
    assert light.shape == (16, 3)
    # Energy is kept, and no unoccluded surface is lit by less than nothing.
    np.testing.assert_allclose(light[0] * math.sqrt(4 * math.pi), weights @ radiance, rtol=1e-4)
    cosine = cosine_matrix(4)[:, 0] * math.sqrt(4 * math.pi)  # max(z, 0) itself
    band = np.arange(4)
    zonal = cosine[band * (band + 1)] * np.sqrt(4 * np.pi / (2 * band + 1))
    kernel = sh.evaluate(directions, 4) * zonal[sh.bands(4)]
    assert (kernel @ light > 0).all()


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
