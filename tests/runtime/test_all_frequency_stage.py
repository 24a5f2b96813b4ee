"""All-frequency transfer by OpenGL against NumPy: the same picture, wherever sums are made."""

from __future__ import annotations

import dataclasses

import moderngl
import numpy as np
import pytest

from prtnet.all_frequency import AllFrequencyField
from prtnet.cube_map import segment_coefficients
from prtnet.errors import PrtnetError
from runtime import all_frequency_stage
from runtime.all_frequency import gathered, seen_from, transformed
from runtime.all_frequency_shader import draw_shaders, seen_shaders, sum_shaders
from runtime.all_frequency_stage import AllFrequencyStage
from runtime.camera import Camera
from runtime.gl import pixels_of
from runtime.picture import auto_exposure, srgb_encode
from runtime.rasteriser import rasterise
from tests.all_frequency import ball, random_field
from tests.runtime.test_all_frequency import random_light

pytestmark = pytest.mark.gl

SIZE = (120, 100)
CAMERA = Camera((1.5, 1.2, 4.4), (0.0, 0.0, 0.0))
WEB = "300 es\nprecision highp float;\nprecision highp int;"


def soft(field: AllFrequencyField) -> AllFrequencyField:
    """The same with view factors that a real material could have: smooth from cell to cell."""
    cells = round(field.view.shape[1] ** 0.5)
    y, x = np.mgrid[:cells, :cells] / cells
    phase = np.arange(field.rows)[:, None, None] + 1.0
    waves = 0.6 + 0.4 * np.cos(phase * (x + 2.0 * y))
    view = waves.reshape(field.rows, -1, 1) * [1.0, 0.8, 0.5]
    return dataclasses.replace(field, view=view.astype(np.float32))


def picture(
    context: moderngl.Context, stage: AllFrequencyStage, camera: Camera = CAMERA
) -> np.ndarray:
    frame = context.framebuffer(
        [context.texture(SIZE, 4, dtype="f4")], context.depth_renderbuffer(SIZE)
    )
    frame.use()
    frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
    stage.draw(frame, camera.matrix(SIZE[0] / SIZE[1]), np.asarray(camera.eye))
    pixels = pixels_of(frame, SIZE)
    frame.release()
    return pixels


def reference(
    field: AllFrequencyField, coefficients: np.ndarray, camera: Camera = CAMERA
) -> np.ndarray:
    rows = gathered(field, transformed(field, coefficients))
    colours = seen_from(field, rows, np.asarray(camera.eye))
    matrix = camera.matrix(SIZE[0] / SIZE[1])
    return rasterise(field.surface.positions, field.surface.faces, colours, matrix, SIZE)


def alike(got: np.ndarray, want: np.ndarray) -> float:
    """The share of pixels within 2/255 of each other in every channel."""
    assert (want[..., 3] > 0).mean() > 0.1
    gain = auto_exposure(want)
    one, other = (255.0 * srgb_encode(gain * part[..., :3]) for part in (got, want))
    return float((np.abs(one - other).max(axis=-1) <= 2.0).mean())


@pytest.mark.parametrize("summed", ["gpu", "cpu"])
@pytest.mark.parametrize(
    ("rows", "size", "terms", "finer"), [(10, 8, 16, 3), (3, 8, 3, 2), (1, 4, 1, 1)]
)
def test_a_picture_is_that_of_numpy(context, rows, size, terms, finer, summed):
    """The largest fills several rows of every texture."""
    field = soft(random_field(rows, ball(finer), rows=rows, size=size, terms=terms))
    coefficients = segment_coefficients(random_light(size))
    stage = AllFrequencyStage(context, field, summed)
    stage.light(coefficients)
    assert alike(picture(context, stage), reference(field, coefficients)) >= 0.999
    stage.release()


@pytest.mark.parametrize("summed", ["gpu", "cpu"])
def test_light_and_eye_change_by_themselves(context, summed, monkeypatch):
    field = soft(random_field(1, ball(2)))
    first, second = (segment_coefficients(random_light(field.size, seed)) for seed in (1, 2))
    stage = AllFrequencyStage(context, field, summed)
    stage.light(first)
    picture(context, stage)
    stage.light(second)
    assert alike(picture(context, stage), reference(field, second)) >= 0.999

    def never(*_: object) -> None:
        raise AssertionError("the light has not changed")

    monkeypatch.setattr(stage, "products", never)
    aside = CAMERA.around(2.0)
    seen = picture(context, stage, aside)
    assert alike(seen, reference(field, second, aside)) >= 0.999
    stage.release()


@pytest.mark.parametrize("rows", [1, 10])
def test_the_shaders_are_webgl_2s(context, rows):
    for vertex, fragment in (sum_shaders(rows, WEB), seen_shaders(rows, WEB), draw_shaders(WEB)):
        context.program(vertex_shader=vertex, fragment_shader=fragment).release()


def test_what_no_texture_holds_is_refused(context):
    field = random_field(rows=2)
    many = int(context.info["GL_MAX_ARRAY_TEXTURE_LAYERS"]) + 1
    segments = random_field(rows=many, clusters=1, terms=1, size=4).segments
    view = np.repeat(field.view[:1], many, axis=0)
    with pytest.raises(PrtnetError, match="use --renderer cpu"):
        AllFrequencyStage(context, AllFrequencyField(field.surface, segments, view, 4))


def test_opengl_on_the_cpu_leaves_sums_to_the_cpu(context, monkeypatch):
    monkeypatch.setattr(all_frequency_stage, "draws_in_software", lambda _: True)
    stage = AllFrequencyStage(context, random_field())
    stage.light(np.zeros((24, 16, 3)))
    assert set(stage.milliseconds) == {"products", "sums", "upload"}
    stage.release()
    monkeypatch.setattr(all_frequency_stage, "draws_in_software", lambda _: False)
    stage = AllFrequencyStage(context, random_field())
    stage.light(np.zeros((24, 16, 3)))
    assert set(stage.milliseconds) == {"products", "upload"}
    stage.release()
