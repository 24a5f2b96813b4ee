"""Pictures of an object on its ground, by both renderers, whatever changes between them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.all_frequency import AllFrequencyField
from prtnet.cube_map import segment_coefficients
from prtnet.transfer import Surface
from runtime.all_frequency_shot import framing, opened
from tests.all_frequency import ball, random_field
from tests.runtime.test_all_frequency import random_light
from tests.runtime.test_all_frequency_stage import alike, soft

SIZE = (90, 70)


def on_ground() -> list[AllFrequencyField]:
    """A glossy ball, and a square below it, ten times as wide, of one row."""
    x, z = (10.0 * line.ravel() for line in np.mgrid[-1:1:6j, -1:1:6j])
    places = np.stack([x, np.full(36, -1.0), z], axis=1).astype(np.float32)
    up, along = (np.tile(np.eye(3, dtype=np.float32)[k], (36, 1)) for k in (1, 0))
    first = (6 * np.arange(5)[:, None] + np.arange(5)).ravel()
    faces = np.concatenate(
        [np.stack([first, first + 1, first + 7], 1), np.stack([first, first + 7, first + 6], 1)]
    )
    ground = Surface(places, up, along, faces.astype(np.int32))
    flat = random_field(7, ground, rows=1, cells=1)
    return [soft(random_field(3, ball(2))), flat]


@pytest.mark.gl
def test_both_renderers_draw_the_same():
    fields = on_ground()
    first, second = (segment_coefficients(random_light(8, seed)) for seed in (1, 2))
    camera = framing(fields, SIZE[0] / SIZE[1], 0.5, 0.4)
    steps = [(first, camera), (first, camera.around(1.0)), (second, camera.around(1.0))]
    drawn = []
    for renderer in ("gl", "cpu"):
        with opened(fields, renderer, SIZE) as drawer:
            found, last = [], None
            for light, seen in steps:
                if light is not last:
                    drawer.light(light)
                last = light
                matrix = seen.matrix(SIZE[0] / SIZE[1])
                found.append(drawer.draw(matrix, np.asarray(seen.eye)))
        drawn.append(found)
    for got, want in zip(*drawn, strict=True):
        assert alike(got, want) >= 0.999
    assert alike(drawn[0][0], drawn[1][1]) < 0.99


def test_what_stands_beside_the_object_hides_it():
    fields = on_ground()
    light = segment_coefficients(random_light(8))
    camera = framing(fields, SIZE[0] / SIZE[1], 0.5, 0.4)
    below = dataclasses.replace(camera, eye=(2.0, -6.0, 3.0), target=(0.0, 0.0, 0.0))
    matrix, eye = below.matrix(SIZE[0] / SIZE[1]), np.asarray(below.eye)
    pictures = []
    for shown in (fields, fields[1:]):
        with opened(shown, "cpu", SIZE) as drawer:
            drawer.light(light)
            pictures.append(drawer.draw(matrix, eye))
    np.testing.assert_array_equal(*pictures)


def test_framing_keeps_the_object_and_all_of_the_ground():
    fields = on_ground()
    alone, both = framing(fields[:1], 1.3, 0.5, 0.4), framing(fields, 1.3, 0.5, 0.4)
    assert alone.eye == both.eye
    for field in fields:
        points = field.surface.positions
        clip = np.column_stack([points, np.ones(len(points))]) @ both.matrix(1.3).T
        assert (clip[:, 2] <= clip[:, 3]).all()
    seen = fields[0].surface.positions
    clip = np.column_stack([seen, np.ones(len(seen))]) @ both.matrix(1.3).T
    assert (np.abs(clip[:, :3]) <= clip[:, 3:]).all()
