from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from runtime.shading import Surface, diffuse_radiance, reflected_light, world_transfer

ROOT = math.sqrt(4 * math.pi)


def random_frames(count: int, seed: int = 0) -> np.ndarray:
    frames, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(count, 3, 3)))
    frames[np.linalg.det(frames) < 0, :, 0] *= -1
    return frames


def unoccluded(count: int, order: int) -> np.ndarray:
    visibility = np.zeros((count, order * order), dtype=np.float32)
    visibility[:, 0] = ROOT
    return visibility


def constant(order: int, radiance: tuple[float, float, float]) -> np.ndarray:
    light = np.zeros((order * order, 3))
    light[0] = ROOT * np.array(radiance)
    return light


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_white_furnace(order):
    # Under constant radiance L an open diffuse surface sends back albedo · L, whatever its normal.
    albedo = np.array([0.9, 0.5, 0.1])
    result = diffuse_radiance(
        unoccluded(7, order), random_frames(7), constant(order, (1.0, 2.0, 4.0)), albedo
    )
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, np.tile(albedo * [1, 2, 4], (7, 1)), rtol=1e-6)


def test_a_light_from_one_side_is_seen_by_that_side():
    # Radiance 1 + s·x: E(n) = ∫ (1 + s·x) max(n·s, 0) ds = π + (2π/3) n·x.
    light = constant(2, (1.0, 1.0, 1.0))
    light[3] = -math.sqrt(4 * math.pi / 3)  # y₁₁ = −√(3/4π)·x
    frames = random_frames(20)
    normal = frames[:, :, 2]
    result = diffuse_radiance(unoccluded(20, 2), frames, light)
    np.testing.assert_allclose(result[:, 0], 1 + 2 / 3 * normal[:, 0], rtol=1e-5)


def test_a_blocked_half_of_the_hemisphere_leaves_half_the_irradiance():
    # V = 1 where the tangent component is positive: by symmetry half of π under constant light.
    directions, weights = sh.quadrature(300)
    half = sh.project_samples((directions[:, 0] > 0) * 1.0, directions, weights, 6)
    result = diffuse_radiance(half[None], random_frames(1), constant(6, (1.0, 1.0, 1.0)))
    np.testing.assert_allclose(result, 0.5, atol=2e-3)


@pytest.mark.parametrize("order", [2, 3, 4, 5])
def test_equals_the_integral_it_stands_for(order):
    rng = np.random.default_rng(order)
    visibility = rng.normal(size=(5, order * order))
    light = rng.normal(size=(order * order, 3))
    frames = random_frames(5, order)
    # max(z, 0) is not a polynomial: integrate over the upper hemisphere of each local frame.
    nodes, weights = np.polynomial.legendre.leggauss(2 * order)
    z, azimuth = (nodes + 1) / 2, np.arange(4 * order) * 2 * math.pi / (4 * order)
    sine = np.sqrt(1 - z * z)[:, None]
    local = np.stack(
        np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), z[:, None]), -1
    ).reshape(-1, 3)
    weight = np.repeat(weights / 2 * z, len(azimuth)) * 2 * math.pi / len(azimuth)
    seen = sh.evaluate(local, order) @ visibility.T  # [S, V]
    world = np.einsum("vij,sj->svi", frames, local)
    arriving = sh.evaluate(world, order) @ light  # [S, V, 3]
    expected = 0.7 / math.pi * np.einsum("s,sv,svc->vc", weight, seen, arriving)
    result = diffuse_radiance(visibility, frames, light, 0.7)
    np.testing.assert_allclose(result, expected, atol=2e-6 * np.abs(expected).max())


def test_more_vertices_than_a_block(monkeypatch):
    rng = np.random.default_rng(0)
    visibility, frames = rng.normal(size=(100, 9)).astype(np.float32), random_frames(100)
    whole = world_transfer(visibility, frames)
    monkeypatch.setattr("runtime.shading.BLOCK", 33)
    np.testing.assert_array_equal(world_transfer(visibility, frames), whole)


def test_reflected_light_takes_a_colour():
    light = np.ones((4, 3))
    np.testing.assert_allclose(
        reflected_light(light, np.array([0.0, 0.5, 1.0]))[2], np.array([0, 0.5, 1]) / math.pi
    )
    assert Surface(light, light, light).back_transfer is None
