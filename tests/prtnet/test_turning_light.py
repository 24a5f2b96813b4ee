from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet.cube_map import cube_map, solid_angles
from prtnet.environment import Environment, about_up, environment
from prtnet.equirectangular import Picture
from prtnet.octahedral import grid_of
from prtnet.turning_light import TurningLight, gathered, warmed

SIZE = 8
TURNS = Rotation.random(6, rng=0).as_matrix()


def total(texels: np.ndarray) -> np.ndarray:
    """∫ light over the sphere, (C,)."""
    return np.einsum("yx,fyxc->c", solid_angles(texels.shape[1]), texels)


def one_texel(row: int, column: int, height: int = 128) -> tuple[Picture, float]:
    """A picture of one bright texel, and its energy."""
    texels = np.zeros((height, 2 * height, 3), dtype=np.float32)
    texels[row, column] = 1.0
    edges = np.cos(math.pi * np.array([row, row + 1]) / height)
    return Picture(texels), float((edges[0] - edges[1]) * math.pi / height)


def test_smooth_lights_are_those_of_sampling_anew():
    light = environment("studio")
    turning = TurningLight(light, SIZE)
    np.testing.assert_allclose(turning.at(), cube_map(light, SIZE, 8), rtol=3e-2)
    for turn in TURNS:
        found, expected = turning.at(turn), cube_map(light.rotated(turn), SIZE, 8)
        np.testing.assert_allclose(found, expected, rtol=3e-2)
    already = TurningLight(light.rotated(TURNS[0]), SIZE)
    np.testing.assert_allclose(already.at(TURNS[1]), turning.at(TURNS[1] @ TURNS[0]), rtol=1e-2)


def test_a_constant_light_stays():
    found = TurningLight(Picture(np.full((4, 8, 3), 2.5)), SIZE).at(TURNS[0])
    assert found.shape == (6, SIZE, SIZE, 3)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, 2.5, rtol=1e-5)


@pytest.mark.parametrize("place", [(42, 81), (1, 5), (64, 32), (64, 128)])
def test_a_tiny_light_keeps_its_energy_as_it_turns(place):
    picture, energy = one_texel(*place)
    turning = TurningLight(picture, SIZE)
    found = np.array(
        [total(turning.at(turn))[0] for turn in Rotation.random(40, rng=1).as_matrix()]
    )
    np.testing.assert_allclose(found, energy, rtol=0.03)
    assert found.mean() == pytest.approx(energy, rel=0.01)


def test_gathering_loses_nothing():
    rng = np.random.default_rng(2)
    picture = Picture(rng.uniform(size=(37, 74, 3)).astype(np.float32))
    light = Environment(picture, TURNS[2])
    falls = gathered(light, grid_of(32), 32)
    np.testing.assert_allclose(falls[:, 3].sum(), 4.0 * math.pi, rtol=1e-6)
    np.testing.assert_allclose(
        falls[:, :3].sum(axis=0), picture.harmonics(1)[0] * math.sqrt(4 * math.pi), rtol=1e-4
    )
    upwards = falls[:, :3].T @ grid_of(32).places / 3  # roughly, by the vertices
    axis = np.stack([-light.harmonics(2)[3], -light.harmonics(2)[1], light.harmonics(2)[2]])
    np.testing.assert_allclose(upwards.T, axis * math.sqrt(4 * math.pi / 3) / 3, atol=0.02)


def test_heat_makes_a_gaussian_of_every_place():
    """On a sphere heat multiplies band l by exp(−l (l + 1) t)."""
    cells, spread = 64, 0.25
    grid = grid_of(cells)
    even = gathered(Picture(np.ones((2, 4, 3))), grid, cells)
    band = np.arange(40)
    kept = (2 * band + 1) / (4 * math.pi) * np.exp(-band * (band + 1) * spread**2 / 2)
    for vertex in (0, 1500, int((grid.places @ [0.577, 0.577, 0.577]).argmax())):
        falls = even * [0.0, 0.0, 0.0, 1.0]
        falls[vertex, :3] = 1.0
        exact = np.polynomial.legendre.legval(grid.places @ grid.places[vertex], kept)
        found = warmed(falls, cells, spread)
        np.testing.assert_allclose(found[:, 0], exact, atol=0.03 * exact.max())


def test_edges_are_crossed_without_a_jump():
    """From texel to texel, segment to segment and face to face: what a small step changes.

    A texel changes by at most what the light's own motion brings over its border, wherever it is.
    """
    picture, energy = one_texel(64, 192)  # +z
    turning = TurningLight(picture, SIZE)
    step = 0.25
    area = solid_angles(SIZE)
    moments = np.array([area * turning.at(about_up(d))[..., 0] for d in np.arange(-50, 55, step)])
    changes = np.abs(np.diff(moments, axis=0)).max(axis=(1, 2, 3)) / energy
    narrowest = (math.atan(1.0) - math.atan(1.0 - 2.0 / SIZE)) / 2  # half the last texel, radians
    sharpest = 1.0 / (math.sqrt(2 * math.pi) * 0.7 * 2.0 / (4 * SIZE))  # of the Gaussian
    assert changes.max() < 1.2 * math.radians(step) * sharpest
    assert math.radians(step) * sharpest < math.radians(step) / narrowest
    np.testing.assert_allclose(moments.sum(axis=(1, 2, 3)), energy, rtol=0.03)
    lit = moments.sum(axis=(2, 3)).argmax(axis=1)
    assert set(lit) == {0, 1, 4}  # it went over both edges of the face +z


def test_only_rotations_turn_a_light():
    turning = TurningLight(Picture(np.ones((2, 4, 3))), 2, 1)
    with pytest.raises(ValueError, match="reflection"):
        turning.at(np.diag([1.0, 1.0, -1.0]))
