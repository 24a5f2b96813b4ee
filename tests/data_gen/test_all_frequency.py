"""Transfer of all frequencies against sums over all directions of a vertex, one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.all_frequency import ground, transfer_segments
from data_gen.cube_visibility import CubeVisibility, cube_visibility
from prtnet.all_frequency_factors import RowFactors, row_factors
from prtnet.brdf import GGX, Lambert
from prtnet.cube_map import directions, faces_of, interpolated, solid_angles
from prtnet.factors import tabulate
from prtnet.frames import orthonormal_frames
from prtnet.hemisphere import cells
from prtnet.transfer import Surface
from tests.data_gen.test_cube_visibility import pair, surface_of

MATTE = row_factors(Lambert(0.8))


def smooth_rows() -> RowFactors:
    """Three rows of light factors, made up but smooth."""
    out = cells(32, 4, "concentric")[0].mean(axis=1)
    x, y, z = out.T
    light = np.stack([z, z * z * (1.0 + 0.5 * x), z * np.exp(4.0 * (0.6 * y + 0.8 * z - 1.0))])
    return RowFactors(light.astype(np.float32), np.ones((3, 1024, 3), dtype=np.float32))


def whole(surface: Surface, visibility: CubeVisibility, light: RowFactors) -> np.ndarray:
    """Raw transfer (P, m, 6, n, n)."""
    segments = np.stack(list(transfer_segments(surface, visibility, light)))  # [24, P, m, h²]
    half = round(segments.shape[-1] ** 0.5)
    quarters = segments.transpose(0, 3, 1, 2).reshape(24, half, half, *segments.shape[1:3])
    return np.moveaxis(faces_of(quarters), (3, 4), (0, 1))


def summed(
    surface: Surface, visibility: CubeVisibility, light: RowFactors, vertex: int
) -> np.ndarray:
    """Equation 10 for one vertex, direction by direction: (m, 6, n, n)."""
    fine = visibility.size
    size = fine // 4
    frame = orthonormal_frames(surface.tangents[vertex], surface.normals[vertex])
    out = directions(fine)
    value = light.at(out.reshape(-1, 3) @ frame).reshape(6, fine, fine, -1).astype(float)
    seen = np.stack([visibility.seen(np.array([vertex]), face)[0] for face in range(6)])
    value *= (seen * solid_angles(fine))[..., None]
    found = np.zeros((light.rows, 6, size, size))
    for row in range(size):
        for column in range(size):
            hat = np.zeros((6, size, size))
            hat[:, row, column] = 1.0
            for face in range(6):  # a hat is the light of one texel
                near = out[face].reshape(-1, 3)
                weight = interpolated(hat, near).reshape(fine, fine)
                found[:, face, row, column] = np.einsum("yx,yxm->m", weight, value[face])
    return found


@pytest.mark.parametrize("fine", [16, 32])
def test_transfer_is_the_sum_over_directions(fine):
    surface, light = pair(), smooth_rows()
    visibility = cube_visibility(surface, [surface], fine)
    found = whole(surface, visibility, light)
    assert found.shape == (len(surface), 3, 6, fine // 4, fine // 4)
    for vertex in (0, 57, 130, 170):
        expected = summed(surface, visibility, light, vertex)
        missed, own = (
            np.sqrt((one**2).sum(axis=(1, 2, 3))) for one in (found[vertex] - expected, expected)
        )
        # F once for two by two directions: of the second order of their distance.
        bound = {16: 0.08, 32: 0.02}[fine]
        assert (missed < bound * own).all(), missed / own


def test_where_f_is_one_the_sum_is_exact():
    """Hats, bits and solid angles alone: nothing is rounded to cells."""
    surface = pair()
    visibility = cube_visibility(surface, [surface], 32)
    light = RowFactors(np.ones((1, 1024), np.float32), np.ones((1, 1024, 3), np.float32))
    found = whole(surface, visibility, light)
    for vertex in (3, 99):
        expected = summed(surface, visibility, light, vertex)
        np.testing.assert_allclose(found[vertex], expected, atol=2e-6)


def test_an_open_diffuse_vertex_sends_its_albedo_of_constant_light():
    """∫ cos = π; and light cos⁺ about the normal: ∫ cos² = 2π/3."""
    surface = surface_of(shapes.icosphere(1))
    visibility = cube_visibility(surface, [surface], 128)
    found = whole(surface, visibility, MATTE)
    radiance = found.sum(axis=(2, 3, 4)) @ MATTE.view[:, 0]
    np.testing.assert_allclose(radiance, 0.8, rtol=1e-3)
    for vertex in (0, 20):
        texels = np.maximum(directions(32) @ surface.normals[vertex].astype(float), 0.0)
        sent = (found[vertex, 0] * texels).sum()
        assert sent == pytest.approx(2.0 * math.pi / 3.0, rel=3e-3)


def test_light_is_that_of_the_hats():
    """Transfer times texels is the integral over what the texels' hats add up to."""
    surface = surface_of(shapes.icosphere(1))
    visibility = cube_visibility(surface, [surface], 64)
    texels = np.random.default_rng(0).uniform(size=(6, 16, 16))
    fine = directions(64)
    light = interpolated(texels, fine.reshape(-1, 3)).reshape(6, 64, 64)
    cosine = np.maximum(fine @ surface.normals.astype(float).T, 0.0)
    expected = np.einsum("yx,fyx,fyxp->p", solid_angles(64), light, cosine)
    found = np.einsum("pfyx,fyx->p", whole(surface, visibility, MATTE)[:, 0], texels)
    np.testing.assert_allclose(found, expected, rtol=3e-3)


def test_glossy_rows_send_what_the_brdf_does():
    brdf = GGX(diffuse=0.2, specular=0.6, roughness=0.6)
    rows = row_factors(brdf, 10)
    surface = surface_of(shapes.icosphere(0))
    visibility = cube_visibility(surface, [surface], 64)
    found = whole(surface, visibility, rows)
    white = found.sum(axis=(2, 3, 4)) @ rows.view.transpose(1, 0, 2).reshape(1024, 10, 3)[528]
    expected = tabulate(brdf, 32, 2)[528].sum(axis=0) * (2.0 * math.pi / 1024)
    np.testing.assert_allclose(white, np.tile(expected, (12, 1)), rtol=0.03)


def test_threads_change_nothing_and_progress_is_told():
    surface, light = pair(), smooth_rows()
    visibility = cube_visibility(surface, [surface], 16)
    told = []
    given = list(
        transfer_segments(surface, visibility, light, 3, lambda *facts: told.append(facts))
    )
    for one, other in zip(given, transfer_segments(surface, visibility, light), strict=True):
        np.testing.assert_array_equal(one, other)
        assert one.dtype == np.float32
    assert [facts[1] for facts in told] == list(range(1, 25))


def test_what_does_not_fit_is_refused():
    surface = pair()
    visibility = cube_visibility(surface, [surface], 8)
    fewer = Surface(*(getattr(surface, k)[:5] for k in ("positions", "normals", "tangents")),
                    surface.faces[:0])  # fmt: skip
    with pytest.raises(ValueError, match="5"):
        next(transfer_segments(fewer, visibility, MATTE))
    odd = CubeVisibility(np.zeros((len(surface), 6, 40, 5), np.uint8)[:, :, :12], 12)
    with pytest.raises(ValueError, match="quarters"):
        next(transfer_segments(surface, odd, MATTE))


def test_the_ground_lies_under_the_object_and_knows_its_shadow():
    ball = surface_of(shapes.icosphere(3, radius=0.5), shift=3.0)
    below = ground(ball, vertices=21, wide=4.0)
    assert len(below) == 441
    np.testing.assert_allclose(below.positions[:, 1], ball.positions[:, 1].min())
    np.testing.assert_allclose(np.ptp(below.positions, axis=0), [4, 0, 4], atol=1e-2)
    a, b, c = below.positions[below.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 1] > 0).all()
    visibility = cube_visibility(below, [ball], 64)
    found = whole(below, visibility, MATTE).sum(axis=(2, 3, 4))[:, 0] / math.pi
    middle = below.positions[:, [0, 2]].mean(axis=0)
    away = np.linalg.norm(below.positions[:, [0, 2]] - middle, axis=1)
    # A ball of radius r at height r hides r² h / d³ of the cosine-weighted sky from the side.
    open_ = 1.0 - 0.25 * 0.5 / (away**2 + 0.25) ** 1.5
    np.testing.assert_allclose(found[away > 0.9], open_[away > 0.9], atol=6e-3)
    assert found[away.argmin()] < 0.02
    for bad in ({"vertices": 1}, {}):
        given = Surface(ball.positions, ball.normals, ball.tangents, ball.faces[:0])
        with pytest.raises(ValueError, match="ground"):
            ground(given, **bad)
