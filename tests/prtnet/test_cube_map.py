from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from prtnet import cube_map as cubes
from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.haar import unhaar

# OpenGL 4.6 core, table 8.19: of a direction r along a face, s_c, t_c and the face.
OPENGL = {
    0: lambda x, y, z: (-z, -y, x),
    1: lambda x, y, z: (z, -y, -x),
    2: lambda x, y, z: (x, z, y),
    3: lambda x, y, z: (x, -z, -y),
    4: lambda x, y, z: (x, -y, z),
    5: lambda x, y, z: (-x, -y, -z),
}


@pytest.mark.parametrize("face", range(6))
def test_faces_are_those_of_opengl(face):
    out = cubes.directions(8)[face]
    s, t, major = OPENGL[face](*np.moveaxis(out, -1, 0))
    line = (2.0 * np.arange(8) + 1.0) / 8 - 1.0
    assert (major >= np.abs(out).max(axis=-1) - 1e-12).all()
    np.testing.assert_allclose(s / major, np.broadcast_to(line, (8, 8)), atol=1e-12)
    np.testing.assert_allclose(t / major, np.broadcast_to(line[:, None], (8, 8)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 1.0)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_there_and_back(kind):
    out = cubes.directions(6).astype(kind)
    face, s, t = cubes.places(3.0 * out)
    line = (2.0 * np.arange(6) + 1.0) / 6 - 1.0
    np.testing.assert_array_equal(face, np.broadcast_to(np.arange(6)[:, None, None], face.shape))
    np.testing.assert_allclose(s, np.broadcast_to(line, s.shape), atol=1e-6)
    np.testing.assert_allclose(t, np.broadcast_to(line[:, None], t.shape), atol=1e-6)
    assert s.dtype == kind


@pytest.mark.parametrize("size", [1, 2, 7, 32, 128])
def test_solid_angles_are_the_whole_sphere(size):
    area = cubes.solid_angles(size)
    assert 6 * area.sum() == pytest.approx(4 * math.pi, rel=1e-13)
    assert (area > 0).all()
    for turned in (area.T, area[::-1], area[:, ::-1]):
        np.testing.assert_allclose(turned, area, atol=1e-14)


def test_a_solid_angle_is_an_integral():
    """∫∫ (1 + s² + t²)^(−3/2) ds dt over texels, by Gauss points."""
    nodes, weights = np.polynomial.legendre.leggauss(12)
    size = 4
    expected = np.zeros((size, size))
    for row in range(size):
        for column in range(size):
            s = (2 * column + 1 + nodes) / size - 1
            t = (2 * row + 1 + nodes[:, None]) / size - 1
            density = (1 + s * s + t * t) ** -1.5
            expected[row, column] = weights @ density @ weights / size**2
    np.testing.assert_allclose(cubes.solid_angles(size), expected, rtol=1e-10)


def test_linear_light_sums_up():
    """∫ω dω = 0 and ∫ω ωᵀ dω = 4π/3, over fine texels."""
    out, area = cubes.directions(64), cubes.solid_angles(64)
    np.testing.assert_allclose(np.einsum("yx,fyxi->i", area, out), 0.0, atol=1e-12)
    second = np.einsum("yx,fyxi,fyxj->ij", area, out, out)
    np.testing.assert_allclose(second, 4 * math.pi / 3 * np.eye(3), atol=1e-3)


class Constant:
    def radiance(self, directions: np.ndarray) -> np.ndarray:
        return np.broadcast_to([0.25, 1.0, 4.0], directions.shape)

    def harmonics(self, order: int) -> np.ndarray:
        raise NotImplementedError


@pytest.mark.parametrize(("size", "samples"), [(1, 1), (4, 4), (32, 2)])
def test_a_constant_light_stays(size, samples):
    found = cubes.cube_map(Constant(), size, samples)
    assert found.shape == (6, size, size, 3)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, np.broadcast_to([0.25, 1.0, 4.0], found.shape), rtol=1e-6)
    where = np.random.default_rng(0).normal(size=(50, 3))
    values = cubes.interpolated(found, where)
    np.testing.assert_allclose(values, np.broadcast_to([0.25, 1.0, 4.0], (50, 3)), rtol=1e-6)


def test_texels_are_means_of_what_is_there():
    sky = environment("sky").turned(40.0)
    found = cubes.cube_map(sky, 4, 16)
    rng = np.random.default_rng(1)
    for face, row, column in ((0, 0, 0), (2, 1, 3), (5, 3, 2)):
        s, t = ((2 * (one + rng.random(200000)) / 4 - 1)[:, None] for one in (column, row))
        right, down, out = cubes.AXES[face]
        where = out + s * right + t * down
        length = np.linalg.norm(where, axis=1, keepdims=True)
        weight = length**-3
        mean = (weight * sky.radiance(where / length)).sum(axis=0) / weight.sum()
        np.testing.assert_allclose(found[face, row, column], mean, rtol=5e-3)


def test_a_light_in_exactly_one_texel():
    texels = np.zeros((6, 8, 8))
    texels[3, 2, 5] = 2.0
    fine = cubes.directions(32)
    values = cubes.interpolated(texels, fine.reshape(-1, 3)).reshape(6, 32, 32)
    hat = cubes.hats(8, 4)
    np.testing.assert_allclose(values[3], 2.0 * np.outer(hat[:, 2], hat[:, 5]), atol=1e-12)
    assert not values[[0, 1, 2, 4, 5]].any()
    assert cubes.interpolated(texels, cubes.directions(8)[3, 2, 5][None])[0] == pytest.approx(2.0)
    light = cubes.decimated(np.kron(texels, np.ones((1, 4, 4))), 4)
    np.testing.assert_allclose(light, texels, rtol=1e-6)


def test_energy_stays_when_decimated():
    fine = np.random.default_rng(2).uniform(size=(6, 24, 24, 3))
    coarse = cubes.decimated(fine, 3)
    whole = np.einsum("yx,fyxc->c", cubes.solid_angles(24), fine)
    found = np.einsum("yx,fyxc->c", cubes.solid_angles(8), coarse)
    np.testing.assert_allclose(found, whole, rtol=1e-6)
    with pytest.raises(ValueError, match="multiple"):
        cubes.decimated(fine, 5)


@given(st.integers(1, 12), st.integers(1, 5))
def test_hats_are_one_together(size, samples):
    found = cubes.hats(size, samples)
    assert found.shape == (size * samples, size)
    assert (found >= 0).all()
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-12)
    assert (np.count_nonzero(found, axis=1) <= 2).all()


def test_interpolation_against_the_definition():
    rng = np.random.default_rng(3)
    texels = rng.normal(size=(6, 5, 5, 2))
    where = rng.normal(size=(200, 3))
    face, s, t = cubes.places(where)
    expected = np.zeros((200, 2))
    for k in range(200):
        row, column = (np.clip((one + 1) * 2.5 - 0.5, 0, 4) for one in (t[k], s[k]))
        for y in range(5):
            for x in range(5):
                hat = max(0.0, 1 - abs(row - y)) * max(0.0, 1 - abs(column - x))
                expected[k] += hat * texels[face[k], y, x]
    np.testing.assert_allclose(cubes.interpolated(texels, where), expected, atol=1e-12)
    for bad in ([[0.0, 0.0, 0.0]], [[np.nan, 0.0, 1.0]], [[np.inf, 0.0, 1.0]]):
        with pytest.raises(ValueError, match="no direction"):
            cubes.interpolated(texels, np.array(bad))


def test_segments_are_quarters_of_faces():
    texels = np.arange(6 * 8 * 8 * 3).reshape(6, 8, 8, 3)
    found = cubes.segments_of(texels)
    assert found.shape == (24, 4, 4, 3)
    for face in range(6):
        for row in range(2):
            for column in range(2):
                own = texels[face, 4 * row : 4 * row + 4, 4 * column : 4 * column + 4]
                np.testing.assert_array_equal(found[face * 4 + 2 * row + column], own)
    np.testing.assert_array_equal(cubes.faces_of(found), texels)
    with pytest.raises(ValueError, match="quarters"):
        cubes.segments_of(np.zeros((6, 3, 3)))


def test_products_in_wavelets_are_those_of_texels():
    rng = np.random.default_rng(4)
    light, transfer = rng.normal(size=(6, 8, 8, 3)), rng.normal(size=(6, 8, 8, 1))
    told, rows = (cubes.segment_coefficients(one) for one in (light, transfer))
    assert told.shape == (24, 16, 3)
    np.testing.assert_allclose(
        np.einsum("gk,gkc->c", rows[..., 0], told),
        np.einsum("fyx,fyxc->c", transfer[..., 0], light),
    )
    back = unhaar(told.swapaxes(1, 2).reshape(24, 3, 4, 4)).transpose(0, 2, 3, 1)
    np.testing.assert_allclose(cubes.faces_of(back), light, atol=1e-12)


def test_a_picture_and_its_turn():
    """A cube map turned by quarters is its own texels, moved."""
    texels = np.random.default_rng(5).uniform(size=(64, 128, 3)).astype(np.float32)
    quarter = Rotation.from_euler("y", 90, degrees=True).as_matrix()  # +z goes to +x
    still = cubes.cube_map(Picture(texels), 8)
    turned = cubes.cube_map(Environment(Picture(texels), quarter), 8)
    np.testing.assert_allclose(turned[0], still[4], rtol=1e-4)
    np.testing.assert_allclose(turned[5], still[0], rtol=1e-4)
    np.testing.assert_allclose(turned[2], np.rot90(still[2]), rtol=1e-4, atol=1e-5)
