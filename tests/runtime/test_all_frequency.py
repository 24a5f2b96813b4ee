"""Shading of all-frequency transfer against whole matrices, decoded number by number."""

from __future__ import annotations

import numpy as np
import pytest

from prtnet.all_frequency import AllFrequencyField
from prtnet.arrays import FloatArray
from prtnet.cube_map import faces_of, segment_coefficients
from prtnet.frames import orthonormal_frames
from prtnet.haar import unhaar
from prtnet.hemisphere import directions
from runtime import all_frequency
from runtime.all_frequency import gathered, seen_from, shaded, transformed
from tests.all_frequency import dense_segment, random_field

EYE = np.array([1.5, 0.7, 2.5])


def whole_matrices(field: AllFrequencyField) -> FloatArray:
    """M_p of every vertex over texels of the cube map, (P, m, 6, n, n), slowly."""
    half = field.size // 2
    blocks = [
        unhaar(dense_segment(one, len(field)).reshape(len(field), field.rows, half, half))
        for one in field.segments
    ]
    return np.stack(
        [[faces_of(np.stack([one[p, r] for one in blocks])) for r in range(field.rows)]
         for p in range(len(field))]
    )  # fmt: skip


def random_light(size: int, seed: int = 1) -> FloatArray:
    texels = np.random.default_rng(seed).gamma(0.3, 2.0, (6, size, size, 3))
    return texels.astype(np.float32)


@pytest.mark.parametrize(("rows", "size", "terms"), [(3, 8, 4), (1, 4, 1), (2, 8, 3)])
def test_shading_is_that_of_whole_matrices(rows, size, terms, monkeypatch):
    monkeypatch.setattr(all_frequency, "BLOCK", 7)
    field = random_field(rows, rows=rows, size=size, terms=terms)
    light = random_light(size)
    want = np.einsum("prfyx,fyxc->prc", whole_matrices(field), light)
    rows_found = gathered(field, transformed(field, segment_coefficients(light)))
    np.testing.assert_allclose(rows_found, want, rtol=1e-4, atol=1e-5 * np.abs(want).max())
    seen = seen_from(field, rows_found, EYE)
    np.testing.assert_allclose(shaded(field, light, EYE), seen)


def test_radiance_is_linear_in_light():
    field = random_field(4)
    one, other = random_light(field.size, 1), random_light(field.size, 2)
    both = shaded(field, (2.0 * one + other).astype(np.float64), EYE)
    apart = 2.0 * shaded(field, one, EYE) + shaded(field, other, EYE)
    np.testing.assert_allclose(both, apart, rtol=1e-6, atol=1e-6 * np.abs(both).max())


def test_view_factors_are_those_of_the_eye_in_a_vertex_frame():
    """At the middle of a cell of the concentric map, its factor, turned with the vertex."""
    field = random_field(2, cells=8)
    frames = orthonormal_frames(field.surface.tangents, field.surface.normals)
    vertex, row, column = 5, 2, 6
    place = (2.0 * np.array([column, row]) + 1.0) / 8.0 - 1.0
    towards = frames[vertex] @ directions(place, "concentric")[0]
    rows = np.random.default_rng(0).normal(size=(len(field), field.rows, 3))
    eye = field.surface.positions[vertex] + 3.0 * towards
    want = (rows[vertex] * field.view[:, row * 8 + column]).sum(axis=0)
    np.testing.assert_allclose(seen_from(field, rows, eye)[vertex], want, rtol=1e-5)


def test_light_of_another_size_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        shaded(random_field(size=8), random_light(4), EYE)
