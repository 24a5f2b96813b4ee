"""Pictures under torture: both renderers on hostile geometry, and their agreement."""

from __future__ import annotations

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from runtime.camera import Camera
from runtime.draw import opened, render
from runtime.picture import auto_exposure, develop, srgb_encode
from runtime.rasteriser import rasterise
from runtime.shading import Surface
from tests.hard_cases.measured import above, at_least, at_most, below, equal
from tests.runtime.scenes import knot, sky, three_quarters

# What the project promises: equal within one step of eight bits on 99.9 % of pixels.
STEP = 1 / 255
SHARE = 0.999


def agreement(surface: Surface, camera: Camera, size: tuple[int, int], samples: int) -> float:
    """Share of the pixels, encoded, that both renderers agree on within a step."""
    encoded = []
    for name in ("cpu", "gl"):
        with opened(name) as renderer:
            drawn = render(renderer, surface, sky(), camera, size, samples=samples)
        above(drawn[..., 3].mean(), 0.05)
        linear = drawn[..., :3] + (1 - drawn[..., 3:]) * 0.1
        encoded.append(srgb_encode(linear))
    return float(np.mean(np.abs(encoded[0] - encoded[1]).max(axis=-1) <= STEP))


@pytest.mark.gl
@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("two_sided", [False, True])
def test_both_renderers_draw_the_same_picture(samples, two_sided):
    surface, size = knot(two_sided=two_sided, detail=4), (321, 243)
    at_least(agreement(surface, three_quarters(surface, size), size, samples), SHARE)


@pytest.mark.gl
@pytest.mark.parametrize("samples", [1, 4])
def test_both_renderers_agree_on_a_scanned_mesh(shared_data, samples):
    import trimesh

    mesh = trimesh.load(shared_data / "bunny.ply")
    rng = np.random.default_rng(0)
    transfer = 1 + 0.3 * np.sin(4 * mesh.vertices @ rng.normal(size=(3, 16)))
    surface = Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces), transfer)
    size = (400, 300)
    at_least(agreement(surface, three_quarters(surface, size), size, samples), SHARE)


@pytest.mark.gl
def test_both_renderers_agree_from_inside_the_mesh():
    # Triangles cross the near plane and all sides of the view; backs are seen.
    surface, size = knot(two_sided=True, detail=4), (200, 150)
    for eye in ((1.0, 0.0, 0.0), (0.0, 0.5, 0.0), (0.9, 0.1, 0.25)):
        camera = Camera(eye=eye, target=(0.2, -0.1, 0.1), fov=math.radians(100), near=0.05, far=9)
        at_least(agreement(surface, camera, size, 1), SHARE)


@pytest.mark.gl
@settings(max_examples=25, suppress_health_check=[HealthCheck.too_slow])
@given(st.integers(0, 2**31))
def test_both_renderers_agree_on_loose_triangles(seed):
    # Sizes from a fraction of a pixel to many screens, through each other, the near and far plane.
    rng = np.random.default_rng(seed)
    centre = np.concatenate([rng.uniform(-1, 1, (12, 2)), rng.uniform(-1.2, 1.2, (12, 1))], 1)
    spread = 10 ** rng.uniform(-2, 1.3, (12, 1, 1)) * rng.normal(size=(12, 3, 3)) * [1, 1, 0.05]
    positions = (centre[:, None] + spread).reshape(-1, 3).astype(np.float32)
    matrix = np.eye(4)
    matrix[3] = [0, 0, -0.6, 1.0]  # perspective along z
    transfer = rng.uniform(0, 2, (36, 4)).astype(np.float32)
    surface = Surface(positions, np.arange(36).reshape(-1, 3), transfer)
    pictures = []
    for name in ("cpu", "gl"):
        with opened(name) as renderer:
            pictures.append(renderer.draw(surface, np.full((4, 3), 0.2), matrix, (96, 96)))
    near = np.abs(pictures[0] - pictures[1]).max(axis=-1) <= STEP
    # Few, large edges: one row of samples beside an edge may fall either way.
    above(near.mean(), 0.99)


def grid(rng: np.random.Generator, count: int, jitter: float) -> tuple[np.ndarray, np.ndarray]:
    """A jittered triangulated square over the whole picture and beyond."""
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, count), np.linspace(-1.2, 1.2, count))
    positions = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    positions[:, :2] += rng.uniform(-jitter, jitter, (count * count, 2))
    corner = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + count], 1)
    upper = np.stack([corner + 1, corner + count, corner + count + 1], 1)  # wound the other way
    return positions, np.concatenate([lower, upper])


@pytest.mark.parametrize("jitter", [0.0, 0.01])
def test_triangles_that_share_edges_cover_every_pixel_once(jitter):
    # With no jitter the edges run exactly through centres of pixels.
    positions, faces = grid(np.random.default_rng(1), 25, jitter)
    positions[:, :2] += 1 / 60  # half a pixel
    size = (60, 60)
    times = np.zeros((60, 60))
    for face in faces:
        drawn = rasterise(positions, face[None], np.ones_like(positions), np.eye(4), size)
        times += drawn[..., 3]
    equal(times, 1)


def test_edges_that_run_far_out_of_the_picture_stay_shared():
    # A fan from a point in the picture to points at 10¹³ times its size.
    angle = np.linspace(0, 2 * np.pi, 41)[:-1] + 0.01
    rim = 3e13 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    positions = np.concatenate([[[0.123, -0.077, 0.0]], rim])
    times = np.zeros((64, 64))
    for k in range(40):
        face = np.array([[0, 1 + k, 1 + (k + 1) % 40]])
        drawn = rasterise(positions, face, np.ones_like(positions), np.eye(4), (64, 64))
        times += drawn[..., 3]
    equal(times, 1)


def test_a_closed_mesh_has_no_pinholes():
    # From outside a closed mesh only fronts are seen; a lost pixel would show a back.
    surface = knot(detail=4)
    green, red = (np.tile(c, (len(surface.positions), 1)) for c in ([0, 1.0, 0], [1.0, 0, 0]))
    for azimuth in np.linspace(0, 3, 5):
        camera = Camera.framing(surface.positions, 1.0, azimuth, elevation=0.4)
        drawn = rasterise(
            surface.positions, surface.faces, green, camera.matrix(1.0), (300, 300), red
        )
        # Where facets fold over at the outline a sliver of their back is truly in view.
        at_most(drawn[..., 0].sum(), 3)
        above(drawn[..., 1].sum(), 10_000)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
@pytest.mark.parametrize("shift", [0.0, 50.0])
def test_scale_and_place_do_not_change_the_picture(scale, shift):
    surface, size = knot(detail=3), (80, 60)
    colours = np.abs(surface.positions)
    pictures = []
    for factor, offset in ((1.0, 0.0), (scale, shift)):
        positions = (surface.positions.astype(np.float64) + offset) * factor
        camera = Camera.framing(positions, 4 / 3)
        pictures.append(rasterise(positions, surface.faces, colours, camera.matrix(4 / 3), size))
    below(np.mean(np.abs(pictures[0] - pictures[1]).max(axis=-1) > STEP), 1e-3)


@pytest.mark.parametrize("name", ["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def test_broken_vertices_take_only_their_own_triangles_away(name):
    surface, size = knot(), (60, 60)
    camera = three_quarters(surface, size)
    positions = surface.positions.copy()
    broken = np.zeros(len(positions), dtype=bool)
    broken[::97] = True
    values = np.resize([np.nan, np.inf, -np.inf], broken.sum())
    positions[broken] = values[:, None]
    whole = ~broken[surface.faces].any(axis=1)
    with opened(name) as renderer:
        drawn = render(
            renderer, Surface(positions, surface.faces, surface.transfer), sky(), camera, size
        )
        kept = Surface(surface.positions, surface.faces[whole], surface.transfer)
        expected = render(renderer, kept, sky(), camera, size)
    equal(drawn, expected)


def test_degenerate_and_gigantic_triangles():
    size = (32, 32)
    line, point = [[-1, -1, 0], [0, 0, 0], [1, 1, 0]], [[0.1, 0.1, 0]] * 3
    giant = [[-1e9, -1e9, 0.5], [1e9, -1e9, 0.5], [0, 1e9, 0.5]]
    thin = [[-1, 0.25, 0], [1, 0.25, 0], [1, 0.25 + 1e-7, 0]]
    beyond = [[-1, -1, 0], [1e308, 0, 0], [0, 1, 0]]  # overflows when it is projected
    positions = np.array(line + point + giant + thin + beyond, dtype=float)
    colours = np.repeat([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [1, 1, 1], [1, 1, 0]], 3, axis=0)
    matrix = np.diag([10.0, 10.0, 1.0, 10.0])
    drawn = rasterise(positions, np.arange(15).reshape(-1, 3), colours, matrix, size)
    equal(drawn, np.broadcast_to([0.0, 0.0, 1.0, 1.0], drawn.shape))


@pytest.mark.parametrize("size", [(1, 1), (1, 300), (300, 1), (3, 2)])
def test_tiny_pictures(size):
    surface = knot(detail=1)
    with opened("cpu") as renderer:
        drawn = render(renderer, surface, sky(), three_quarters(surface, size), size)
    assert drawn.shape == (size[1], size[0], 4)
    assert drawn[..., 3].any()
    assert develop(drawn, auto_exposure(drawn)).dtype == np.uint8


def test_visibility_that_is_not_a_number_is_drawn_black_and_nothing_else_changes():
    surface, size = knot(), (60, 60)
    transfer = surface.transfer.copy()
    transfer[:5] = np.nan
    camera = three_quarters(surface, size)
    with opened("cpu") as renderer:
        drawn = render(renderer, Surface(surface.positions, surface.faces, transfer), sky(), camera,
                       size)  # fmt: skip
        sound = render(renderer, surface, sky(), camera, size)
    equal(drawn[..., 3], sound[..., 3])
    touched = np.isnan(drawn[..., 0])
    equal(drawn[~touched], sound[~touched])
    assert np.isfinite(auto_exposure(drawn))
    equal(develop(drawn, 1.0)[touched], 0)
