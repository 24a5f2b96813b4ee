from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.equirectangular import Picture, project_equirectangular
from prtnet.sh_rotation import rotate


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


def test_radiance_in_the_middle_of_a_texel_is_its_own():
    texels = np.random.default_rng(0).uniform(size=(5, 10, 3))
    found = Picture(texels).radiance(texel_directions(5, 10)[0])
    np.testing.assert_allclose(found.reshape(5, 10, 3), texels, atol=1e-12)


def test_radiance_is_bilinear_and_columns_go_round():
    texels = np.random.default_rng(1).uniform(size=(4, 8, 3))
    row, column = np.random.default_rng(2).uniform((0, -0.5), (3, 7.5), (200, 2)).T
    theta, phi = math.pi * (row + 0.5) / 4, 2 * math.pi * (column + 0.5) / 8
    s = np.stack([-np.sin(theta) * np.cos(phi), np.cos(theta), -np.sin(theta) * np.sin(phi)], -1)
    # The tent of every texel, to both sides around the sphere.
    rows = np.maximum(1 - np.abs(row[:, None] - np.arange(4)), 0)
    away = np.abs(column[:, None] - np.arange(8))
    columns = np.maximum(1 - np.minimum(away, 8 - away), 0)
    expected = np.einsum("nr,nc,rci->ni", rows, columns, texels)
    np.testing.assert_allclose(Picture(texels).radiance(s), expected, atol=1e-12)


def test_towards_the_poles_the_last_row_goes_on():
    texels = np.random.default_rng(3).uniform(size=(4, 8, 3))
    picture = Picture(texels)
    for row, height in ((0, 1.0), (3, -1.0)):
        tilt = 1e-9  # to the middle of column 2
        phi = 2 * math.pi * 2.5 / 8
        near = np.array([[-tilt * math.cos(phi), height, -tilt * math.sin(phi)]])
        np.testing.assert_allclose(picture.radiance(near)[0], texels[row, 2], atol=1e-12)
    poles = picture.radiance(np.array([[0.0, 1, 0], [0, -1, 0], [-0.0, 1, -0.0]]))
    assert np.isfinite(poles).all()


def test_the_seam_is_as_smooth_as_anywhere():
    texels = np.random.default_rng(4).uniform(size=(8, 16, 3))
    sides = np.array([[-1.0, 0.1, 1e-12], [-1.0, 0.1, -1e-12], [-1.0, 0.1, 0.0], [-1.0, 0.1, -0.0]])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    values = Picture(texels).radiance(sides)
    np.testing.assert_allclose(values, np.broadcast_to(values[0], (4, 3)), atol=1e-9)


def test_radiance_and_coefficients_agree_on_a_smooth_sky():
    light = np.random.default_rng(8).normal(size=(16, 3))
    texels = (sh.evaluate(texel_directions(128, 256)[0], 4) @ light).reshape(128, 256, 3)
    picture = Picture(texels)
    np.testing.assert_allclose(sh.project_function(picture.radiance, 4), light, atol=2e-3)
    np.testing.assert_allclose(picture.harmonics(4), light, atol=2e-3)
