"""Fields of lobes by OpenGL against NumPy: the same picture, patch or mesh, matte or glossy."""

from __future__ import annotations

import dataclasses

import moderngl
import numpy as np
import pytest

from prtnet.brdf import GGX
from prtnet.canvas import Canvas, plane, vase
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.glossy import brdf_rows
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.sh import evaluate
from prtnet.transfer import Patch, Surface, TransferField
from runtime.camera import Camera
from runtime.gl import pixels_of
from runtime.lobe_picture import drawn_by_numpy
from runtime.lobe_shader import mesh_shaders, patch_shaders
from runtime.lobe_shading import LobeLight, light_table
from runtime.lobe_stage import LobeStage
from runtime.picture import auto_exposure, srgb_encode

pytestmark = pytest.mark.gl

SIZE = (120, 100)
CAMERA = Camera((0.5, 0.4, 2.4), (0.0, 0.0, 0.0))
WEB = "300 es\nprecision highp float;\nprecision highp int;"


def bumpy(rows: int, order: int, tiles: tuple[bool, bool] = (True, True)) -> TransferField:
    """A patch of cosines about normals that lean to all sides, partly hidden."""
    x = 2.0 * np.pi * (np.arange(12) + 0.5) / 12
    y = 2.0 * np.pi * (np.arange(10)[:, None] + 0.5) / 10
    lean = np.stack(np.broadcast_arrays(0.6 * np.cos(x), 0.5 * np.sin(y), 1.0), axis=-1)
    normals = lean / np.linalg.norm(lean, axis=-1, keepdims=True)
    g = np.array([0.9, 0.6, 0.25, 0.05, -0.04, -0.03])[:order]
    shade = 0.7 + 0.3 * np.sin(x + y)
    vectors = evaluate(normals, order) * np.repeat(g, 2 * np.arange(order) + 1) * shade[..., None]
    vectors = vectors.reshape(120, 1, -1)
    view = None
    if rows > 1:
        made = brdf_rows(GGX(), rows, order)
        view = made.view.astype(np.float32)
        vectors = vectors * made.harmonics(order)[:, :1] + 0.2 * made.harmonics(order)
    layout = Patch(np.zeros((10, 12), np.float32), normals.astype(np.float32), (0.1, 0.08), tiles)
    return TransferField(vectors.astype(np.float32), layout, view)


def own_mesh(rows: int, order: int, count: int) -> tuple[LobeField, Canvas]:
    """A vase whose vertices have lobes, fitted to those of a patch."""
    canvas = vase(3).twisted(0.8)
    few = lobe_field(bumpy(rows, order), count)
    of = np.arange(len(canvas.positions)) % len(few)
    parts = [part.astype(np.float32) for part in (canvas.positions, canvas.normals)]
    layout = Surface(*parts, canvas.frames[..., 0].astype(np.float32), canvas.faces)
    field = LobeField(few.low[of], few.axes[of], few.coefficients[of], layout, view=few.view)
    return field, dataclasses.replace(canvas, places=None)


def light_of(order: int) -> LobeLight:
    harmonics = environment("studio").turned(70.0).harmonics(order)
    return LobeLight(harmonics, light_table(harmonics))


def drawn(
    context: moderngl.Context, field: LobeField, canvas: Canvas, light: LobeLight, by_table: bool
) -> np.ndarray:
    stage = LobeStage(context, field, by_table)
    frame = context.framebuffer(
        [context.texture(SIZE, 4, dtype="f4")], context.depth_renderbuffer(SIZE)
    )
    frame.use()
    frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
    stage.light(light)
    stage.show(canvas)
    stage.draw(frame, CAMERA.matrix(SIZE[0] / SIZE[1]), np.asarray(CAMERA.eye))
    pixels = pixels_of(frame, SIZE)
    stage.release()
    return pixels


def compared(got: np.ndarray, want: np.ndarray) -> float:
    """The share of pixels within 2/255 of each other in every channel."""
    assert (want[..., 3] > 0).mean() > 0.1
    gain = auto_exposure(want)
    one, other = (255.0 * srgb_encode(gain * part[..., :3]) for part in (got, want))
    return float((np.abs(one - other).max(axis=-1) <= 2.0).mean())


@pytest.mark.parametrize("by_table", [False, True], ids=["direct", "table"])
@pytest.mark.parametrize(
    ("count", "rows", "order", "coherent"),
    [(1, 1, 6, False), (3, 1, 6, True), (4, 1, 6, False), (3, 3, 4, False), (2, 2, 4, True),
     (1, 1, 1, False), (3, 1, 2, False)],
)  # fmt: skip
def test_a_patch_is_drawn_as_numpy_draws_it(context, count, rows, order, coherent, by_table):
    field = lobe_field(bumpy(rows, order), count, coherent)
    canvas, light = vase(5, 0.8).twisted(0.8), light_of(order)
    given = light if by_table else LobeLight(light.harmonics)
    want = drawn_by_numpy(
        field, canvas, given, np.asarray(CAMERA.eye), CAMERA.matrix(SIZE[0] / SIZE[1]), SIZE
    )
    assert compared(drawn(context, field, canvas, light, by_table), want) >= 0.999


@pytest.mark.parametrize("by_table", [False, True], ids=["direct", "table"])
@pytest.mark.parametrize(("count", "rows", "order"), [(1, 1, 6), (4, 1, 6), (3, 3, 4)])
def test_a_mesh_is_drawn_as_numpy_draws_it(context, count, rows, order, by_table):
    """Vertices fill several rows of their texture."""
    field, canvas = own_mesh(rows, order, count)
    light = light_of(order)
    given = light if by_table else LobeLight(light.harmonics)
    want = drawn_by_numpy(
        field, canvas, given, np.asarray(CAMERA.eye), CAMERA.matrix(SIZE[0] / SIZE[1]), SIZE
    )
    assert compared(drawn(context, field, canvas, light, by_table), want) >= 0.999


def test_a_border_goes_on_where_a_patch_does_not_tile(context):
    """On a plane that is twisted until its back is seen."""
    field = lobe_field(bumpy(1, 4, (False, True)), 3)
    light, canvas = light_of(4), plane(2.5).twisted(4.0)
    want = drawn_by_numpy(
        field, canvas, light, np.asarray(CAMERA.eye), CAMERA.matrix(SIZE[0] / SIZE[1]), SIZE
    )
    assert compared(drawn(context, field, canvas, light, True), want) >= 0.999


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("by_table", [False, True])
def test_the_shaders_are_webgl_2s(context, rows, by_table):
    patch = lobe_field(bumpy(rows, 4), 3)
    mesh = own_mesh(rows, 4, 3)[0]
    for vertex, fragment in (
        patch_shaders(patch, by_table, WEB),
        mesh_shaders(mesh, by_table, WEB),
    ):
        context.program(vertex_shader=vertex, fragment_shader=fragment).release()


def test_lobes_that_no_texture_holds_are_refused(context):
    field, _ = own_mesh(rows=2, order=2, count=1)
    many = LobeField(
        np.repeat(field.low, 600, axis=1), np.repeat(field.axes, 600, axis=1),
        np.repeat(field.coefficients, 600, axis=1), field.layout,
        view=np.repeat(field.view, 600, axis=0),
    )  # fmt: skip
    with pytest.raises(PrtnetError, match="use --renderer cpu"):
        LobeStage(context, many)


def test_what_does_not_belong_together_is_refused(context):
    patch, (own, canvas) = lobe_field(bumpy(1, 4), 3), own_mesh(1, 4, 3)
    stage = LobeStage(context, patch)
    with pytest.raises(ValueError, match="places"):
        stage.show(canvas)
    with pytest.raises(ValueError, match="table"):
        stage.light(LobeLight(light_of(4).harmonics))
    stage.release()
    mesh = LobeStage(context, own)
    few = dataclasses.replace(canvas, positions=canvas.positions[:-1])
    with pytest.raises(ValueError, match="own mesh"):
        mesh.show(few)
    mesh.release()
