"""Whole fields of lobes, baked, fitted, saved, read and drawn, where one of these usually fails."""

from __future__ import annotations

import dataclasses
import functools
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.bake import BakeConfig, bake_mesh, bake_patch, bake_wrinkle
from data_gen.reliefs import relief
from data_gen.static_mesh import clean_mesh
from data_gen.transport import unit_irradiance
from prtnet.brdf import GGX
from prtnet.canvas import Canvas, plane, vase
from prtnet.environment import environment
from prtnet.glossy import brdf_rows
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.membrane import membrane_field
from prtnet.sh_rotation import rotate
from prtnet.transfer import Patch, TransferField
from prtnet.wrinkle import Wrinkle
from runtime.camera import Camera
from runtime.draw import RendererName
from runtime.field_shot import FieldShot
from runtime.gl import available
from runtime.picture import auto_exposure, comparison, develop
from tests.hard_cases.measured import above, at_least, below, close, equal, finite, refuses

ORDER = 4
CONFIG = BakeConfig(order=ORDER, rays=128)
LIGHT = environment("studio").turned(20.0).harmonics(ORDER)
TILED = (True, True)
HALF = 2e-3  # of half precision: 2^-11 in each of several numbers
RENDERERS: list[RendererName] = ["cpu", "gl"] if available() else ["cpu"]
AHEAD, BEHIND = (0.0, 0.0), (math.pi, 0.0)


def kept(field: LobeField, tmp_path: Path) -> LobeField:
    """What a file holds of it."""
    field.save(tmp_path / "field.safetensors")
    return LobeField.load(tmp_path / "field.safetensors")


def picture(
    field: LobeField | TransferField,
    canvas: Canvas,
    renderer: RendererName = "cpu",
    by_table: bool = False,
    angles: tuple[float, float] = (0.5, 0.2),
    light: np.ndarray = LIGHT,
) -> np.ndarray:
    """(H, W, 4); everything that is drawn is finite, and something is."""
    camera = Camera.framing(canvas.positions, 1.0, *angles)
    light = light[: field.order**2]
    seen = FieldShot(canvas, light, camera, (40, 40)).draw(field, renderer, by_table, samples=1)
    finite(seen)
    above((seen[..., 3] > 0).mean(), 0.1)
    return seen


def colours(seen: np.ndarray) -> np.ndarray:
    """Of what is drawn, (P, 3)."""
    return seen[seen[..., 3] > 0, :3]


@functools.cache
def bumps(order: int = ORDER) -> TransferField:
    """A small relief."""
    config = dataclasses.replace(CONFIG, order=order)
    return bake_patch(0.02 * relief("bumps", (8, 8)), (0.1, 0.1), TILED, config)


@pytest.fixture(scope="module")
def bumpy() -> TransferField:
    return bumps()


def alike(one: np.ndarray, other: np.ndarray) -> bool:
    """But for single pixels where two texels meet, of which either may be the nearer."""
    missed = np.abs(one - other).max(axis=-1) > 0.01 * other.max()
    return float(missed.mean()) < 0.005


@functools.cache
def ball(scale: float, offset: float, shiny: bool = False) -> tuple[LobeField, Canvas]:
    """An ellipsoid whose vertices are multiples of 1/128 of its size, wherever it is: float32 holds
    the same shape there."""
    sphere = shapes.icosphere(2)
    places = np.round(128.0 * np.array(sphere.vertices) * [1.0, 1.5, 0.7]) / 128.0
    mesh = clean_mesh("ball", (places + offset) * scale, np.array(sphere.faces))
    glossy = brdf_rows(GGX(roughness=0.4), 2, ORDER) if shiny else None
    raw = bake_mesh(mesh, dataclasses.replace(CONFIG, glossy=glossy))
    canvas = Canvas(mesh.positions, mesh.tangents, mesh.normals, mesh.faces)
    return lobe_field(raw, 2), canvas


@pytest.mark.parametrize("count", [1, 2, 8])
@pytest.mark.parametrize(
    ("shape", "height", "repeat"), [((1, 1), 0.0, 1), ((1, 5), 1e3, 7), ((4, 3), -1e4, 1000)]
)
def test_a_flat_patch_is_one_colour(shape, height, repeat, count, tmp_path):
    """Irradiance in closed form, whatever its height, its texels, and how often it is repeated."""
    flat = bake_patch(np.full(shape, height), (0.1, 0.1), TILED, CONFIG)
    field = kept(lobe_field(flat, count), tmp_path)
    exact = 0.8 * unit_irradiance(ORDER) @ LIGHT
    for renderer in RENDERERS:
        for by_table, loose in ((False, HALF), (True, 0.02)):  # of 64 × 32 entries
            seen = colours(picture(field, plane(repeat), renderer, by_table, AHEAD))
            close(seen, np.broadcast_to(exact, seen.shape), rtol=loose)


@pytest.mark.parametrize(
    ("deep", "coherent"), [(-math.inf, False), (-math.inf, True), (-1e30, False), (-1e3, False)]
)
def test_a_pit_without_a_floor_is_a_dark_texel(deep, coherent, tmp_path):
    heights = np.zeros((9, 9))
    heights[4, 4] = deep
    field = kept(lobe_field(bake_patch(heights, (1.0, 1.0), TILED, CONFIG), 3, coherent), tmp_path)
    assert isinstance(field.layout, Patch)
    at_least(field.layout.heights.min(), -17.0)
    exact = 0.8 * unit_irradiance(ORDER) @ LIGHT
    for renderer in RENDERERS:
        seen = picture(field, plane(1), renderer, angles=AHEAD)[..., 1] / exact[1]
        below(seen[19:21, 19:21].max(), 0.4)  # between the pit's middle and its rim
        border = np.concatenate([seen[8, 8:32], seen[31, 8:32], seen[8:32, 8], seen[8:32, 31]])
        close(border, 1.0, rtol=0.03)
        above(seen.min(), -0.1)


def test_what_sends_nothing_is_black(tmp_path):
    """Inside a closed box, and of albedo 0: no division by what is not there."""
    box = shapes.box().subdivide()
    inside = clean_mesh("box", np.array(box.vertices), np.array(box.faces)[:, ::-1])
    canvas = Canvas(inside.positions, inside.tangents, inside.normals, inside.faces)
    black = dataclasses.replace(CONFIG, albedo=0.0)
    patch = bake_patch(0.02 * relief("bumps", (4, 4)), (0.1, 0.1), TILED, black)
    for raw, on in ((bake_mesh(inside, CONFIG), canvas), (patch, vase(3))):
        for coherent in (False, True):
            field = kept(lobe_field(raw, 3, coherent), tmp_path)
            assert field.metadata["fit"]["error"] == 0.0
            assert field.metadata["fit"]["p99"] == 0.0
            for renderer in RENDERERS:
                seen = picture(field, on, renderer)
                equal(colours(seen), 0.0)
        assert auto_exposure(seen) == 1.0
        below(develop(seen, 1.0).max(), 255)
        _, error = comparison(seen, picture(raw, on), ("lobes", "transfer"), 1.0)
        assert error["rms"] == 0.0


@pytest.mark.parametrize("scale", [1e-3, 1e5])
def test_a_mesh_of_any_size_looks_the_same(scale, tmp_path):
    for renderer in RENDERERS:
        one, other = (
            picture(kept(field, tmp_path), canvas.twisted(0.5), renderer)
            for field, canvas in (ball(1.0, 0.0), ball(scale, 0.0))
        )
        close(other, one, atol=HALF * one.max())


@pytest.mark.parametrize("shiny", [False, True])
@pytest.mark.parametrize("offset", [1e3, -1e4, 1e5])
def test_a_mesh_far_from_the_origin_looks_the_same(offset, shiny, tmp_path):
    for renderer in RENDERERS:
        pictures = []
        for field, canvas in (ball(1.0, 0.0, shiny), ball(1.0, offset, shiny)):
            moved = canvas.moved(canvas.positions, canvas.normals)
            close(moved.frames, canvas.frames, atol=1e-5)
            pictures.append(picture(kept(field, tmp_path), moved, renderer))
        close(pictures[1], pictures[0], atol=HALF * pictures[0].max())


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_dim_and_bright_transfer_is_fitted_and_drawn_alike(scale, bumpy, tmp_path):
    scaled = dataclasses.replace(bumpy, transfer=(bumpy.transfer * np.float32(scale)))
    field, same = kept(lobe_field(scaled, 2), tmp_path), lobe_field(bumpy, 2)
    close(field.metadata["fit"]["error"], same.metadata["fit"]["error"], 0.02)
    seen, want = picture(field, vase(3)), picture(same, vase(3))
    close(colours(seen) / scale, colours(want), atol=0.01 * colours(want).max())


def test_transfer_that_half_precision_cannot_hold_is_one_line(bumpy):
    glaring = dataclasses.replace(bumpy, transfer=bumpy.transfer * np.float32(1e6))
    with refuses(match="too bright for lobes in half precision"):
        lobe_field(glaring, 3)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_both_sides_of_a_sheet(renderer, bumpy):
    """The back bulges as the front does: what stands behind the sheet is the front's image."""
    field = lobe_field(bumpy, 1)
    band = np.repeat(np.arange(ORDER), 2 * np.arange(ORDER) + 1)
    m = np.arange(ORDER**2) - band * (band + 1)
    mirrored = LIGHT * np.where((band + m) % 2, -1.0, 1.0)[:, None]
    front = picture(field, plane(2), renderer, angles=AHEAD)
    back = picture(field, plane(2), renderer, angles=BEHIND, light=mirrored)
    close(back[:, ::-1], front, atol=2e-3 * front.max())
    dark = picture(field, plane(2), renderer, angles=BEHIND)
    above(np.abs(dark[:, ::-1] - front).max(), 0.05 * front.max())


@pytest.mark.parametrize(("order", "count"), [(1, 1), (1, 8), (2, 3), (2, 8), (3, 1), (6, 5)])
def test_few_bands_and_many_lobes(order, count, tmp_path):
    light = environment("studio").harmonics(order)
    field = kept(lobe_field(bumps(order), count), tmp_path)
    shots = [picture(field, vase(2), renderer, light=light) for renderer in RENDERERS]
    assert all(alike(one, shots[0]) for one in shots)
    if (count == 8 and order < 3) or order == 1:
        close(shots[0], picture(bumps(order), vase(2), light=light), atol=HALF * shots[0].max())


def test_a_membrane_that_hides_everything_beside_one_that_hides_nothing(tmp_path):
    """Light from behind alone: one texel does not know of it, the other is as bright as if it came
    from in front."""
    raw = membrane_field(np.array([[0.0, 1.0]]), (0.2, 0.1), ORDER, 1.0)
    field = kept(lobe_field(raw, 2), tmp_path)
    cosine = unit_irradiance(ORDER)
    behind = np.outer(rotate(cosine, np.diag([1.0, -1.0, -1.0])), np.ones(3))
    open_, hidden = cosine @ cosine, cosine @ behind[:, 0]
    for renderer in RENDERERS:
        seen = picture(field, plane(1, 0.5), renderer, angles=AHEAD, light=behind)
        # At the middles of the texels, a quarter and three quarters of the way.
        close(seen[20, 11, :3], hidden, atol=0.1 * open_)
        close(seen[20, 28, :3], open_ + hidden, atol=0.1 * open_)


def test_grooves_of_no_depth_are_flat(tmp_path):
    groove = bake_wrinkle(Wrinkle(0.1, 1e-6, 6, 4), CONFIG)
    field = kept(lobe_field(groove, 3, coherent=True), tmp_path)
    seen = colours(picture(field, plane(1), angles=AHEAD))
    exact = 0.8 * unit_irradiance(ORDER) @ LIGHT
    close(seen, np.broadcast_to(exact, seen.shape), rtol=0.02)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_surfaces_that_have_collapsed_are_still_drawn(renderer, bumpy):
    """Points without an area have any frame; those beside them keep theirs."""
    field, canvas = lobe_field(bumpy, 3), vase(3)
    low = canvas.positions[:, 1] < -0.2
    crushed = np.where(low[:, None], [0.0, -0.2, 0.0], canvas.positions)
    normals = np.where(low[:, None], 0.0, canvas.normals)
    moved = canvas.moved(crushed, normals)
    finite(moved.frames)
    seen, whole = picture(field, moved, renderer), picture(field, canvas, renderer)
    close(colours(seen).mean(), colours(whole).mean(), 0.3)
    flat = canvas.moved(canvas.positions * [1.0, 0.0, 1.0], canvas.normals)
    finite(flat.twisted(1.0).frames)


def test_turns_without_end_are_turns(bumpy, dtype):
    canvas = plane(2)
    parts = (canvas.positions, canvas.tangents, canvas.normals)
    canvas = Canvas(*(part.astype(dtype) for part in parts), canvas.faces, canvas.places)
    for angle in (0.0, 1e-12, 50.0, -1e4):
        frames = canvas.twisted(angle).frames
        products = np.einsum("vji,vjk->vik", frames, frames)
        close(products, np.broadcast_to(np.eye(3), frames.shape), atol=1e-14)
    picture(lobe_field(bumpy, 2), canvas.twisted(50.0))
