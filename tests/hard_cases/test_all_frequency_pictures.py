"""What all-frequency shading must survive: nobody reached, one lit texel, no light, one row."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from prtnet.all_frequency import AllFrequencyField, Segment
from prtnet.cube_map import directions, segment_coefficients, segments_of, solid_angles
from prtnet.haar import haar
from prtnet.sparse_columns import encode
from runtime.all_frequency import gathered, seen_from, shaded, transformed
from runtime.all_frequency_products import Products, Sums
from runtime.all_frequency_shot import framing, opened
from tests.all_frequency import ball, no_segment, random_field
from tests.hard_cases.measured import above, at_least, below, close, equal
from tests.runtime.test_all_frequency import EYE, random_light
from tests.runtime.test_all_frequency_stage import alike, soft

SIZE = (80, 60)


def fast(field: AllFrequencyField, coefficients: np.ndarray) -> np.ndarray:
    """T_p by the fast way."""
    return Sums(field)(Products(field)(coefficients))


def without(field: AllFrequencyField, vertex: int) -> AllFrequencyField:
    """The same but that no segment reaches a vertex."""
    segments = []
    for one in field.segments:
        stays = one.vertices != vertex
        counts = [stays[a:b].sum() for a, b in zip(one.starts[:-1], one.starts[1:], strict=True)]
        assert all(counts)
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        segments.append(
            dataclasses.replace(
                one, vertices=one.vertices[stays], weights=one.weights[stays], starts=starts
            )
        )
    return dataclasses.replace(field, segments=tuple(segments))


def lit(field: AllFrequencyField, coefficients: np.ndarray, renderer: str) -> np.ndarray:
    camera = framing([field], SIZE[0] / SIZE[1], 0.5, 0.3)
    with opened([field], renderer, SIZE) as drawer:
        drawer.light(coefficients)
        return drawer.draw(camera.matrix(SIZE[0] / SIZE[1]), np.asarray(camera.eye))


@pytest.mark.gl
def test_a_vertex_that_no_segment_reaches_is_black():
    """The last one, whose run is empty at the very end, and one amid the others."""
    for vertex in (161, 17):
        field = without(soft(random_field(3, ball(2), clusters=1)), vertex)
        coefficients = segment_coefficients(random_light(field.size))
        rows = gathered(field, transformed(field, coefficients))
        equal(rows[vertex], 0)
        assert np.abs(rows).max(axis=(1, 2)).astype(bool).sum() == 161
        equal(fast(field, coefficients)[vertex], 0)
        got, want = (lit(field, coefficients, renderer) for renderer in ("gl", "cpu"))
        at_least(alike(got, want), 0.999)


def test_light_in_one_texel_is_a_column_of_the_matrix():
    """Every wavelet of its segment is lit, of no other any; products are picked by columns."""
    field = random_field(6, rows=2)
    dark = np.zeros((6, 8, 8, 3), dtype=np.float32)
    for face, row, column in ((0, 0, 0), (3, 7, 4), (5, 3, 3)):
        texels = dark.copy()
        texels[face, row, column] = [70_000.0, 60_000.0, 50_000.0]
        coefficients = segment_coefficients(texels)
        number = face * 4 + 2 * (row // 4) + column // 4
        assert set(np.flatnonzero(coefficients.any(axis=(1, 2)))) == {number}
        want = gathered(field, transformed(field, coefficients))
        alone = field.segments[number]
        others = (no_segment(2 * 16, 4),) * 24
        only = (*others[:number], alone, *others[number + 1 :])
        one = dataclasses.replace(field, segments=only)
        equal(want, gathered(one, transformed(one, coefficients)))
        close(fast(field, coefficients), want, 1e-4, 1e-5 * np.abs(want).max())


@pytest.mark.gl
def test_no_light_is_black():
    field = soft(random_field(2, ball(2)))
    coefficients = np.zeros((24, 16, 3), dtype=np.float32)
    equal(shaded(field, np.zeros((6, 8, 8, 3)), EYE), 0)
    equal(fast(field, coefficients), 0)
    for renderer in ("gl", "cpu"):
        picture = lit(field, coefficients, renderer)
        assert picture[..., 3].any()
        equal(picture[..., :3], 0)


def matte_ball(albedo: float) -> AllFrequencyField:
    """A matte ball, unshadowed, of one cluster a segment with as many terms as it needs.

    A vertex's transfer of a texel is its solid angle times the cosine, and the cosine is linear in
    the normal where all of a segment is above the horizon; elsewhere a vertex is left out.
    """
    surface, size = ball(1), 4
    where, area = directions(size), solid_angles(size)[None, :, :, None]
    towards = segments_of(where * area)  # [24, h, h, 3]
    waves = haar(np.moveaxis(towards, -1, 1)).reshape(24, 3, -1)
    corners = segments_of(where).reshape(24, -1, 3)
    segments: list[Segment] = []
    for wave, looks in zip(waves, corners, strict=True):
        seen = (surface.normals @ looks.T >= 0.0).all(axis=1)
        vertices = np.flatnonzero(seen).astype(np.int32)
        step = float(np.abs(wave).max()) / 32767
        weights = np.rint(surface.normals[vertices] * 32767).astype(np.int16)
        segments.append(
            Segment(
                vertices, np.array([0, len(vertices)], np.int32), weights,
                np.full((1, 3), 1 / 32767, np.float32),
                encode(np.rint(wave / step).astype(np.int16)), step,
            )
        )  # fmt: skip
    view = np.full((1, 1, 3), albedo / math.pi, dtype=np.float32)
    return AllFrequencyField(surface, tuple(segments), view, size)


def test_one_row_is_matte_whatever_the_eye():
    """Light 1 from the segments above a vertex: albedo / π · Σ cosine · solid angle."""
    field = matte_ball(0.5)
    texels = np.ones((6, 4, 4, 3), dtype=np.float32)
    found = shaded(field, texels, EYE)
    close(shaded(field, texels, -EYE), found)
    rows = fast(field, segment_coefficients(texels))
    close(seen_from(field, rows, EYE), found, rtol=1e-4)
    cosine = np.einsum("pi,fyxi->pfyx", field.surface.normals, directions(4))
    whole = np.moveaxis(segments_of(np.moveaxis(cosine, 0, -1)), -1, 0)  # [P, 24, h, h]
    area = segments_of(np.broadcast_to(solid_angles(4), (6, 4, 4)))
    risen = (whole >= 0.0).all(axis=(2, 3))
    want = 0.5 / math.pi * np.einsum("ps,psyx,syx->p", risen, whole, area)
    close(found, np.repeat(want[:, None], 3, axis=1), rtol=1e-3)
    above(want, 0.2)  # a middle of so few texels stands for too much now and then
    below(want, 0.55)
