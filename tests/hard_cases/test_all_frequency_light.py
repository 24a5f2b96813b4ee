"""Light and transfer of all frequencies where they usually go wrong."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.all_frequency import ground, transfer_segments
from data_gen.cube_visibility import cube_visibility
from prtnet.all_frequency_factors import row_factors
from prtnet.brdf import CookTorrance, Lambert
from prtnet.cube_map import (
    AXES,
    directions,
    faces_of,
    interpolated,
    segment_coefficients,
    segments_of,
    solid_angles,
)
from prtnet.environment import about_up
from prtnet.equirectangular import Picture
from prtnet.tangents import any_tangent
from prtnet.transfer import Surface
from prtnet.turning_light import SPREAD, TurningLight
from tests.data_gen.test_cube_visibility import surface_of
from tests.hard_cases.measured import above, at_most, below, close, equal, finite

MATTE = row_factors(Lambert(1.0))


def matte(surface: Surface, casters: list[Surface], fine: int = 32) -> np.ndarray:
    """Raw transfer (P, 24, h²) of a matte surface."""
    visibility = cube_visibility(surface, casters, fine)
    return np.stack([one[:, 0] for one in transfer_segments(surface, visibility, MATTE)], axis=1)


def made(positions: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> Surface:
    normals = np.asarray(normals, dtype=np.float32)
    tangents = any_tangent(normals).astype(np.float32)
    return Surface(
        np.asarray(positions, dtype=np.float32), normals, tangents, np.asarray(faces, np.int32)
    )


def test_a_vertex_that_sees_nothing_and_one_that_sees_everything() -> None:
    box = shapes.box([4, 4, 4])
    inside = surface_of(shapes.icosphere(0, radius=0.1))
    equal(matte(inside, [surface_of(box), inside]), 0)
    alone = matte(inside, [inside])
    close(alone.sum(axis=(1, 2)), math.pi, rtol=2e-3)
    # Below the horizon there is nothing, in whole segments too.
    towards = segments_of(directions(8)).reshape(24, -1, 3) @ inside.normals.astype(float).T
    dark = (towards < -0.3).all(axis=1).T
    above(dark.sum(), 12)
    equal(alone[dark], 0)
    assert alone[(towards > 0.3).all(axis=1).T].all()


def test_a_light_in_exactly_one_texel(dtype: str) -> None:
    """It has the whole of its segment's wavelets at that place, and arrives by its hat."""
    texels = np.zeros((6, 8, 8, 1), dtype)
    texels[4, 2, 5] = 3.0
    waves = segment_coefficients(texels)
    assert waves.dtype == dtype
    segment = 4 * 4 + 1
    equal(np.delete(waves, segment, axis=0), 0)
    assert np.count_nonzero(waves[segment]) == 1 + 3 * 2  # of four by four: two levels
    close(np.linalg.norm(waves), 3.0, {"float32": 3e-7, "float64": 3e-15}[dtype])
    surface = surface_of(shapes.icosphere(1))
    fine = directions(32)
    light = interpolated(texels[..., 0], fine.reshape(-1, 3)).reshape(6, 32, 32)
    cosine = np.maximum(fine @ surface.normals.astype(float).T, 0.0)
    expected = np.einsum("yx,fyx,fyxp->p", solid_angles(32), light, cosine)
    found = matte(surface, [surface]) * segments_of(texels[..., 0]).reshape(24, 16)
    equal(found[:, np.arange(24) != segment], 0)
    close(found.sum(axis=(1, 2)), expected, atol=5e-3 * expected.max())


def largest_step(row: int, middle: float) -> float:
    """Of what matte vertices send as a light of energy 1 turns past ``middle`` degrees from +z."""
    picture = np.zeros((128, 256, 3), dtype=np.float32)
    picture[row, 192] = 1000.0  # in the plane of +y and +z
    turning = TurningLight(Picture(picture), 8)
    surface = surface_of(shapes.icosphere(0))
    transfer = matte(surface, [surface]).reshape(12, -1)
    degrees = np.arange(middle - 5.0, middle + 5.0, 0.25)
    lights = np.stack([segments_of(turning.at(about_up(d))[..., 0]).ravel() for d in degrees])
    energy = np.einsum("yx,fyx->", solid_angles(8), turning.at()[..., 0])
    return float(np.abs(np.diff(lights @ transfer.T, axis=0)).max() / energy)


@pytest.mark.parametrize(
    ("row", "middle", "sides"),
    [(64, 26.57, (20.56, 32.01)), (64, 0.0, (-7.13, 7.13)), (64, 45.0, (41.19, 48.81)),
     (39, 45.0, (41.19, 48.81))],
    ids=["texel", "segment", "edge", "corner"],
)  # fmt: skip
def test_a_light_crosses_without_a_jump(
    row: int, middle: float, sides: tuple[float, float]
) -> None:
    """No step is larger than the texel's own change, wherever segments and faces end.

    A tiny light goes over from the middle of a texel to that of the next, which are at ``sides``,
    as fast as the Gaussian that it was spread to passes their border.
    """
    gap = math.radians(sides[1] - sides[0])
    fastest = 1.0 / (math.sqrt(2.0 * math.pi) * SPREAD * 2.0 / 32)
    step = largest_step(row, middle)
    above(step, 0.0)
    below(step, 1.5 * gap * fastest * math.radians(0.25))


def test_a_corner_of_the_cube_has_three_faces(dtype: str) -> None:
    """Light beside a corner lies in texels of all three, each once."""
    corner = (AXES[0, 2] + AXES[2, 2] + AXES[4, 2]) / math.sqrt(3.0)
    beside = corner + 1e-3 * np.eye(3)
    texels = np.arange(6 * 4 * 4, dtype=dtype).reshape(6, 4, 4)
    found = interpolated(texels, beside.astype(dtype))
    assert len(set(found)) == 3
    equal(faces_of(segments_of(texels)), texels)


def test_roughness_of_a_twentieth_is_told_by_its_error() -> None:
    smooth, rough = (row_factors(CookTorrance(roughness=r, fresnel=0.5), 10) for r in (0.05, 0.4))
    above(smooth.error, 0.5)
    below(smooth.error, 1.0)
    above(smooth.clamped, 0.8)
    below(rough.error, 0.13)
    below(rough.clamped, 0.07)
    finite(smooth.light)
    finite(smooth.view)


def test_edges_of_many_triangles_flat_triangles_and_stray_vertices() -> None:
    """Three sheets on one edge, triangles without an area, a vertex of none without a normal."""
    positions = [[0, 0, 0], [0, 0, 1], [1, 0, 0.5], [-1, 0, 0.5], [0, 1, 0.5], [5, 5, 5], [0, 0, 2]]
    normals = [[0, 1, 0]] * 4 + [[1, 0, 0], [0, 0, 0], [0, 1, 0]]
    faces = [[0, 1, 2], [1, 0, 3], [0, 1, 4], [0, 1, 6], [4, 4, 4]]
    surface = made(np.array(positions), np.array(normals), np.array(faces))
    found = matte(surface, [surface]).sum(axis=(1, 2)) / math.pi
    finite(found)
    above(found, 0.8)  # the sheet that stands on an edge hides nothing from its ends
    at_most(found, 1.0 + 2e-3)
    close(found[5], 1.0, 0.0, 2e-3)  # the stray one: open
    assert len(ground(surface, 4)) == 16
    equal(ground(surface, 4).positions[:, 1], 0.0)


@pytest.mark.parametrize("scale", [1e-3, 1e5])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_scale_and_place_do_not_matter(scale: float, shift: float) -> None:
    both = shapes.icosphere(1) + shapes.box([4.0, 0.2, 4.0]).apply_translation([0.0, -1.2, 0.0])
    here = surface_of(both)
    there = surface_of(both, scale, shift * scale)
    found, expected = matte(there, [there]), matte(here, [here])
    missed = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    below(missed, 1e-3 if shift == 0.0 else 0.03)
    below(found.max(), 1.1 * expected.max())
