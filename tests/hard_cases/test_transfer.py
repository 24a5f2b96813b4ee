"""Local transfer where it is known, and where simulations of it usually go wrong."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.bake import BakeConfig, bake_mesh, bake_patch
from data_gen.reliefs import relief
from data_gen.static_mesh import StaticMesh, clean_mesh, read_mesh
from data_gen.transport import unit_irradiance
from prtnet.dipole import MATERIALS
from tests.hard_cases.measured import above, at_least, at_most, below, close, equal, finite

WHITE = math.sqrt(4 * math.pi)
TILED = (True, True)
CONFIG = BakeConfig(order=4, rays=256)


def box(inwards: bool) -> tuple[np.ndarray, np.ndarray]:
    mesh = shapes.box().subdivide().subdivide()
    faces = np.array(mesh.faces)
    return np.array(mesh.vertices), faces[:, ::-1] if inwards else faces


@pytest.mark.parametrize("tiles", [TILED, (False, True), (False, False)])
@pytest.mark.parametrize("height", [0.0, -1e3, 1e5])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 3)])
def test_flat_patch(tiles: tuple[bool, bool], height: float, shape: tuple[int, int]) -> None:
    field = bake_patch(np.full(shape, height), (0.1, 0.1), tiles, CONFIG)
    expected = np.tile(0.8 * unit_irradiance(4), (shape[0] * shape[1], 1))
    close(field.vectors, expected, atol=1e-7)


@pytest.mark.parametrize("deep", [-math.inf, -1e30, -1e3])
def test_pit_without_a_floor(deep: float) -> None:
    """Its bottom is dark, places away from it do not know it, and nothing else is disturbed."""
    heights = np.zeros((16, 16))
    heights[8, 8] = deep
    field = bake_patch(heights, (1.0, 1.0), TILED, CONFIG)
    white = field.vectors[:, 0].reshape(16, 16) * WHITE
    at_least(white[8, 8], 0)
    below(white[8, 8], 1e-3)
    flat = np.ones((16, 16), dtype=bool)
    flat[7:10, 7:10] = False
    close(field.vectors[flat.ravel()], np.tile(0.8 * unit_irradiance(4), (247, 1)), atol=1e-6)
    rim = white[7:10, 7:10].ravel()
    at_least(rim, 0)
    at_most(rim, 0.8 + 1e-6)
    at_least(field.layout.heights.min(), -17.0)  # type: ignore[union-attr]


def test_one_texel_is_a_plane_whatever_it_says() -> None:
    field = bake_patch(np.array([[0.3]]), (1.0, 1.0), TILED, CONFIG)
    close(field.vectors[0], 0.8 * unit_irradiance(4), atol=1e-7)


def test_a_lone_spike() -> None:
    heights = np.zeros((12, 12))
    heights[6, 6] = 3.0
    field = bake_patch(heights, (1.0, 1.0), TILED, CONFIG)
    white = field.vectors[:, 0] * WHITE
    finite(white)
    at_least(white.min(), 0)
    at_most(white.max(), 0.8 + 1e-6)


@pytest.mark.parametrize("albedo", [0.5, 1.0])
def test_closed_box_is_dark_inside(albedo: float) -> None:
    """With albedo 1 nothing would ever absorb what came in; nothing comes in."""
    mesh = clean_mesh("box", *box(inwards=True))
    field = bake_mesh(mesh, dataclasses.replace(CONFIG, albedo=albedo))
    equal(field.transfer, 0.0)
    assert field.metadata["diverges"] is False


def test_box_with_a_hole_and_albedo_one_is_told_to_be_slow() -> None:
    """All the light that comes in goes out again, after many bounces: the furnace's limit."""
    positions, faces = box(inwards=True)
    up = np.array([(positions[face, 1] > 0.49).all() for face in faces])
    middle = np.linalg.norm(positions[faces].mean(axis=1)[:, [0, 2]], axis=1)
    mesh = clean_mesh("box", positions, faces[~(up & (middle < 0.3))])
    config = dataclasses.replace(CONFIG, albedo=1.0, order=1)
    early = bake_mesh(mesh, dataclasses.replace(config, bounces=4))
    assert early.metadata["left"] is None or early.metadata["left"] > 0.1
    late = bake_mesh(mesh, dataclasses.replace(config, bounces=3000, tolerance=1e-4))
    at_most(late.metadata["left"], 1e-4)
    close(late.vectors.max() * WHITE, 1.0, 0.0, 0.02)
    # Rays that leave over the hole's edges see the room's outside, which is dark.
    above(late.vectors.min() * WHITE, 0.9)


def test_a_box_within_a_box_hides_only_what_is_between() -> None:
    """Vertices of a closed room inside a body are dark; the body's own do not know of them."""
    outer, room = box(inwards=False), box(inwards=True)
    places = np.concatenate([outer[0], 0.5 * room[0]])
    faces = np.concatenate([outer[1], room[1] + len(outer[0])])
    field = bake_mesh(clean_mesh("both", places, faces), CONFIG)
    alone = bake_mesh(clean_mesh("outer", *outer), CONFIG)
    count = len(outer[0])
    equal(field.transfer[count:], 0.0)
    close(
        np.linalg.norm(field.vectors[:count], axis=1), np.linalg.norm(alone.vectors, axis=1),
        atol=1e-5,
    )  # fmt: skip


def test_useless_triangles_and_vertices_change_nothing() -> None:
    both = shapes.icosphere(1) + shapes.icosphere(1).apply_translation([1.6, 0.3, 0.2])
    places, faces = np.array(both.vertices), np.array(both.faces)
    plain = bake_mesh(clean_mesh("a", places, faces), CONFIG)
    stray = np.array([[0, 50, 0], [np.nan, 0, 0], [0.9, 0, 0]])
    first = len(places)
    useless = [[0, 0, 1], [3, 3, 3], [0, first + 2, 0]]
    mixed = clean_mesh("a", np.concatenate([places, stray]), np.concatenate([useless, faces]))
    assert mixed.dropped == (3, 3)
    dirty = bake_mesh(mixed, CONFIG)
    close(np.linalg.norm(dirty.vectors, axis=1), np.linalg.norm(plain.vectors, axis=1), atol=2e-3)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("offset", [(0, 0, 0), (5.0, -3.0, 2.0)])
def test_meshes_of_any_size_and_place(scale: float, offset: tuple[float, float, float]) -> None:
    ball = shapes.icosphere(2)
    places = (np.array(ball.vertices) + offset) * scale
    field = bake_mesh(clean_mesh("ball", places, np.array(ball.faces)), CONFIG)
    close(field.vectors, np.tile(0.8 * unit_irradiance(4), (len(places), 1)), atol=1e-5)


def test_relief_that_does_not_tile() -> None:
    """A ramp that is repeated has a cliff at its seam; one that ends goes on level."""
    ramp = np.tile(np.linspace(0, 1, 24), (24, 1))
    tiled = bake_patch(ramp, (1.0, 1.0), TILED, CONFIG).vectors[:, 0].reshape(24, 24) * WHITE
    ended = bake_patch(ramp, (1.0, 1.0), (False, True), CONFIG)
    low = ended.vectors[:, 0].reshape(24, 24) * WHITE
    below(tiled[12, 1], 0.75 * low[12, 1])  # at the foot of the cliff
    finite(ended.transfer)


def test_ground_beyond_a_relief_that_ends_is_as_bright_as_its_border() -> None:
    """White, so nothing absorbs: whatever falls beyond the border must find the border's light."""
    hill = 0.5 * relief("bumps", (20, 20), seed=2)
    config = dataclasses.replace(CONFIG, albedo=1.0, bounces=300, tolerance=1e-6)
    for tiles in (TILED, (False, True), (False, False)):
        white = bake_patch(hill, (1.0, 1.0), tiles, config).vectors[:, 0] * WHITE
        close(white, 1.0, atol=1e-4)


def test_scatter_without_absorption_keeps_its_light() -> None:
    white = dataclasses.replace(MATERIALS["marble"], absorption=0.0)
    config = dataclasses.replace(CONFIG, medium=white, order=1, bounces=200)
    field = bake_patch(0.002 * relief("waffle", (18, 18)), (0.02, 0.02), TILED, config, 0.001)
    sent = field.vectors * WHITE
    at_most(sent.max(), 1 + 1e-6)
    above(sent.min(), 0.5)


def test_the_bunny(shared_data: Path) -> None:
    """No vertex sends more than it can get; those that are open send nearly the whole albedo."""
    bunny = read_mesh(shared_data / "bunny.ply")
    field = bake_mesh(coarse(bunny), dataclasses.replace(CONFIG, rays=64))
    white = field.vectors[:, 0] * WHITE
    at_least(white.min(), -1e-6)
    at_most(white.max(), 0.8 + 1e-6)
    above(np.quantile(white, 0.9), 0.7)
    at_most(field.metadata["left"], 1e-3)


def coarse(mesh: StaticMesh) -> StaticMesh:
    """A tenth of the triangles of a mesh: enough to be a bunny, with holes and loose parts."""
    return clean_mesh("bunny", mesh.positions, mesh.faces[::10], mesh.normals)
