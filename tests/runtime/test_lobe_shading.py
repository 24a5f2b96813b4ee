from __future__ import annotations

import numpy as np
import pytest

from prtnet.canvas import plane
from prtnet.environment import environment
from prtnet.hemisphere import cells
from prtnet.lobe_fit import lobe_field
from prtnet.sh import evaluate
from prtnet.sh_rotation import rotate
from prtnet.transfer import Patch, TransferField
from prtnet.zh import Lobes, LobesApart, apart
from runtime.lobe_picture import drawn_by_numpy, sampled
from runtime.lobe_shading import LobeLight, light_table, rows_radiance, view_factors

ORDER = 6
RANDOM = np.random.default_rng(5)


def unit(*shape: int) -> np.ndarray:
    vectors = RANDOM.normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def frames_of(count: int, mirror: bool) -> np.ndarray:
    """Random rotations, and mirror images of them."""
    turns = np.linalg.qr(RANDOM.normal(size=(count, 3, 3)))[0]
    wanted = np.where(np.arange(count) % 2 == 1, -1.0, 1.0) if mirror else np.ones(count)
    return turns * (np.linalg.det(turns) * wanted)[:, None, None]


def lobes_of(count: int, rows: int, lobes: int) -> LobesApart:
    whole = Lobes(unit(count, rows, lobes), RANDOM.normal(size=(count, rows, lobes, ORDER)))
    return apart(whole.harmonics(), whole)


def light_of(order: int = ORDER) -> LobeLight:
    return LobeLight(environment("area").turned(40.0).harmonics(order))


@pytest.mark.parametrize("lobes", [1, 2, 3, 4])
def test_turned_axes_are_turned_harmonics(lobes: int) -> None:
    """Equation 13 against a rotation of all coefficients, in frames of both hands."""
    points, frames, light = lobes_of(30, 2, lobes), frames_of(30, True), light_of()
    direct = rows_radiance(points, frames, light)
    full = rows_radiance(points.harmonics(), frames, light)
    np.testing.assert_allclose(direct, full, atol=1e-9 * np.abs(full).max())


def test_full_transfer_in_a_frame_is_light_seen_from_it() -> None:
    """Turning transfer to the world is turning light to the frame, mirrored or not."""
    frames, light = frames_of(8, True), light_of(4)
    transfer = RANDOM.normal(size=(8, 1, 16))
    got = rows_radiance(transfer, frames, light)[:, 0]
    directions, weights = sphere()
    for frame, vector, value in zip(frames, transfer[:, 0], got, strict=True):
        world = evaluate(directions @ frame.T, 4) @ light.harmonics
        expected = weights * (evaluate(directions, 4) @ vector) @ world
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9)
    proper = np.linalg.det(frames) > 0
    turned = rotate(transfer[proper, 0], frames[proper]) @ light.harmonics
    np.testing.assert_allclose(got[proper], turned, atol=1e-12)


def sphere() -> tuple[np.ndarray, float]:
    """A spherical design of degree 7 or more: product of Gauss and equal angles."""
    z, w = np.polynomial.legendre.leggauss(8)
    phi = 2.0 * np.pi * np.arange(16) / 16
    z, phi = np.repeat(z, 16), np.tile(phi, 8)
    across = np.sqrt(1.0 - z * z)
    weights = np.repeat(w, 16) * 2.0 * np.pi / 16
    return np.stack([across * np.cos(phi), across * np.sin(phi), z], axis=-1), weights


def test_the_table_is_what_is_summed() -> None:
    """Equation 24 at its own entries, and what bilinear look-ups of 64 by 32 leave of it."""
    light, points, frames = light_of(), lobes_of(400, 1, 3), frames_of(400, False)
    table = light_table(light.harmonics)
    assert table.shape == (32, 64, ORDER, 3)
    np.testing.assert_allclose(table.sum(axis=2)[0], evaluate([0.0, 0.0, 1.0], ORDER)
                               @ light.harmonics * np.ones((64, 1)), atol=1e-9)  # fmt: skip
    errors = {}
    for size in ((64, 32), (128, 63)):
        given = LobeLight(light.harmonics, light_table(light.harmonics, size))
        direct = rows_radiance(points, frames, light)
        missed = rows_radiance(points, frames, given) - direct
        errors[size] = np.linalg.norm(missed) / np.linalg.norm(direct)
    assert errors[64, 32] < 0.03
    assert errors[128, 63] == pytest.approx(errors[64, 32] / 4.0, rel=0.3)  # second order


@pytest.mark.parametrize("order", [1, 2, 3])
def test_few_bands(order: int) -> None:
    whole = Lobes(unit(5, 1, 3), RANDOM.normal(size=(5, 1, 3, order)))
    target, frames = whole.harmonics(), frames_of(5, False)
    light = light_of(order)
    full = rows_radiance(target, frames, light)
    np.testing.assert_allclose(rows_radiance(apart(target, whole), frames, light), full, atol=1e-9)


def test_view_factors_are_the_tables_between_cells() -> None:
    view = RANDOM.normal(size=(2, 64, 3))
    middles, _ = cells(8, 1, "concentric")
    np.testing.assert_allclose(
        view_factors(view, middles[:, 0]), np.moveaxis(view, 0, 1), atol=1e-9
    )
    flat = np.ones((1, 64, 3))
    np.testing.assert_allclose(view_factors(flat, unit(50)), 1.0)  # also from below
    assert view_factors(np.ones((1, 1, 3)), unit(3)).shape == (3, 1, 3)


def patch(tiles: tuple[bool, bool] = (True, True)) -> TransferField:
    axes = unit(20) * 0.3 + [0.0, 0.0, 1.0]
    vectors = evaluate(axes / np.linalg.norm(axes, axis=-1, keepdims=True), 4)
    layout = Patch(np.zeros((4, 5), np.float32), unit(4, 5).astype(np.float32), (0.1, 0.1), tiles)
    return TransferField(vectors[:, None].astype(np.float32), layout)


@pytest.mark.parametrize("tiles", [(True, True), (False, True), (False, False)])
@pytest.mark.parametrize("coherent", [False, True])
def test_texels_are_met_at_their_middles_and_borders_go_on(tiles, coherent) -> None:
    field = lobe_field(patch(tiles), 3, coherent)
    u, v = np.meshgrid((np.arange(5) + 0.5) / 5, (np.arange(4) + 0.5) / 4)
    middle = np.stack([u.ravel(), v.ravel()], axis=-1)
    got = sampled(field, middle)
    assert isinstance(got, LobesApart)
    np.testing.assert_allclose(got.lobes.axes, field.axes, atol=1e-6)
    np.testing.assert_allclose(got.low, field.low, atol=1e-6)
    beyond = sampled(field, np.add(middle, [1.0, 0.0]))
    assert isinstance(beyond, LobesApart)
    same = np.allclose(beyond.low, got.low, atol=1e-5)
    assert same == tiles[0]
    if not tiles[0]:
        edge = np.repeat(field.low.reshape(4, 5, 1, 4)[:, -1:], 5, axis=1).reshape(20, 1, 4)
        np.testing.assert_allclose(beyond.low, edge, atol=1e-6)


def test_the_back_bulges_as_the_front_does() -> None:
    """Seen from behind under mirrored light, a plane is its own mirror image."""
    field, canvas = lobe_field(patch(), 3), plane(2.0)
    light = LobeLight(RANDOM.normal(size=(16, 3)))
    band = np.repeat(np.arange(4), 2 * np.arange(4) + 1)
    m = np.arange(16) - band * (band + 1)
    mirrored = LobeLight(light.harmonics * np.where((band + m) % 2, -1.0, 1.0)[:, None])
    size, matrix = (40, 40), np.diag([1.5, 1.5, -1.0, 1.0])
    eye = np.array([0.0, 0.0, 5.0])
    front = drawn_by_numpy(field, canvas, light, eye, matrix, size)
    flipped = matrix @ np.diag([-1.0, 1.0, 1.0, 1.0])  # left and right, as from behind
    back = drawn_by_numpy(field, canvas, mirrored, -eye, flipped, size)
    assert front[..., 3].mean() > 0.5
    np.testing.assert_allclose(back[:, ::-1], front, atol=1e-4)
