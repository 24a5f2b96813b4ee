from __future__ import annotations

import math

import numpy as np
import pytest

from data_gen.casters import PatchCaster
from data_gen.reliefs import relief
from data_gen.scattering import TAIL, DiscKernel, exit_matrix, scattering, shifts_of
from prtnet.dipole import MATERIALS, Medium

MARBLE, SKIN = MATERIALS["marble"], MATERIALS["skin"]


def ones(count: int) -> np.ndarray:
    return np.ones((count, 1))


@pytest.mark.parametrize("medium", [MARBLE, SKIN, MATERIALS["ketchup"]])
@pytest.mark.parametrize("size", [0.004, 0.02, 0.1, 1.0])
def test_plane_sends_its_reflectance_whatever_the_spacing(medium: Medium, size: float) -> None:
    """Texels from a tenth of a mean free path to a hundred: the closed form within 2 %."""
    caster = PatchCaster(np.zeros((24, 24)), (size, size))
    operator = scattering(caster.positions, caster.areas, medium, (size, size))
    np.testing.assert_allclose(operator(ones(576)), medium.reflectance(), rtol=0.025)


def test_cells_are_nearly_the_dense_sum() -> None:
    size = 0.02
    heights = 0.002 * relief("bumps", (20, 20), seed=1)
    caster = PatchCaster(heights, (size, size))
    operator = scattering(caster.positions, caster.areas, MARBLE, (size, size))
    assert operator.near.nnz + operator.far.nnz < 0.7 * 400**2 * 9
    shifts = shifts_of((size, size), MARBLE.reach(TAIL))
    dense = exit_matrix(caster.positions, caster.areas, MARBLE, shifts)
    light = np.random.default_rng(0).normal(size=(400, 9)) + 2
    expected = dense @ light
    error = np.linalg.norm(operator(light) - expected) / np.linalg.norm(expected)
    assert error < 0.012


def test_light_goes_both_ways_alike() -> None:
    """Reciprocity: A_i S_ij = A_j S_ji."""
    heights = 0.01 * relief("swirl", (12, 12))
    caster = PatchCaster(heights, (0.03, 0.03))
    operator = scattering(caster.positions, caster.areas, SKIN, (0.03, 0.03))
    matrix = caster.areas[:, None] * operator(np.eye(144))
    np.testing.assert_allclose(matrix, matrix.T, atol=0.02 * matrix.max())


def test_no_light_comes_out_of_nothing_where_a_body_is_thin() -> None:
    plate = PatchCaster(np.zeros((16, 16)), (0.02, 0.02))
    both = np.concatenate([plate.positions, plate.positions - [0, 0, 1e-4]])
    areas = np.concatenate([plate.areas, plate.areas])
    assert exit_matrix(both, areas, MARBLE, shifts_of((0.02, 0.02), 0.02)).sum(axis=1).max() > 1.2
    operator = scattering(both, areas, MARBLE, (0.02, 0.02))
    sent = operator(ones(512))
    assert sent.max() <= 1 + 1e-9
    assert sent.min() > 0.99


def test_disc_means_are_means() -> None:
    radii = np.array([1e-4, 3e-3])
    kernel = DiscKernel(SKIN, radii)
    random = np.random.default_rng(1)
    for radius in (1e-4, 5e-4, 3e-3):
        r, phi = radius * np.sqrt(random.random(200_000)), 2 * math.pi * random.random(200_000)
        for distance in (0.0, 0.7 * radius, 2.3 * radius, 20 * radius):
            d = np.hypot(distance - r * np.cos(phi), r * np.sin(phi))
            expected = SKIN.profile(d).mean()
            found = kernel(np.array([distance]), np.array([radius]))[0]
            assert found == pytest.approx(expected, rel=0.03)


def test_far_ends_of_a_long_strip() -> None:
    """Along a strip wider than the medium's reach light does not come back from its end."""
    caster = PatchCaster(np.zeros((4, 120)), (1.2, 0.04), (False, True))
    lit = np.zeros((480, 1))
    lit[caster.positions[:, 0] < 0.1] = 1.0
    sent = scattering(caster.positions, caster.areas, MARBLE, (None, 0.04))(lit)[:, 0]
    assert sent[caster.positions[:, 0] > 0.3].max() < 1e-3
    assert sent[np.abs(caster.positions[:, 0] - 0.05) < 0.01].min() > 0.7
