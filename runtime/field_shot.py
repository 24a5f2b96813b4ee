"""A picture of a field on a mesh, by OpenGL or by NumPy."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.canvas import Canvas
from prtnet.lobe_field import LobeField
from prtnet.transfer import TransferField
from runtime.camera import Camera
from runtime.draw import RendererName, averaged, finer
from runtime.lobe_picture import strip_rows, strips_by_numpy
from runtime.lobe_shading import LobeLight, light_table

__all__ = ["FieldShot", "opened_field", "seen_from_origin"]


Draw = Callable[
    [Canvas, LobeLight, FloatArray, FloatArray, tuple[int, int], int], Iterator[FloatArray]
]
"""As ``strips_by_numpy`` of one field."""


@dataclass(frozen=True, eq=False)
class FieldShot:
    """What a picture is of.

    Attributes:
        canvas: the mesh, posed.
        light: SH coefficients of the environment's radiance, world frame, (n², 3).
        camera: where from.
        size: of the picture, in pixels.
    """

    canvas: Canvas
    light: FloatArray
    camera: Camera
    size: tuple[int, int]

    def draw(
        self,
        field: LobeField | TransferField,
        renderer: RendererName = "cpu",
        by_table: bool = True,
        samples: int = 4,
    ) -> FloatArray:
        """The picture, (H, W, 4) linear. Full transfer, turned exactly, is drawn by NumPy always.

        Args:
            field: of the light's order.
            renderer: 'gl' or 'cpu'.
            by_table: lobes are looked up in the light's table; otherwise evaluated.
            samples: a pixel, a square number.

        Raises:
            PrtnetError: the picture or the field is too large, or there is no OpenGL.
        """
        by_table = by_table and isinstance(field, LobeField)
        with opened_field(field, renderer, by_table) as draw:
            return self.drawn_by(draw, by_table, samples)

    def drawn_by(self, draw: Draw, by_table: bool, samples: int = 4) -> FloatArray:
        """The same by what ``opened_field`` gives, for a field that is drawn more than once."""
        fine = finer(self.size, samples)
        light = LobeLight(self.light, light_table(self.light) if by_table else None)
        canvas, camera = seen_from_origin(self.canvas, self.camera)
        matrix, eye = camera.matrix(self.size[0] / self.size[1]), np.asarray(camera.eye)
        scale = fine[1] // self.size[1]
        strips = draw(canvas, light, eye, matrix, fine, strip_rows(fine, scale))
        return np.concatenate(
            [averaged(strip, (self.size[0], len(strip) // scale)) for strip in strips]
        )


def seen_from_origin(canvas: Canvas, camera: Camera) -> tuple[Canvas, Camera]:
    """The same picture with the eye at the origin: what float32 holds is best there."""
    eye = np.asarray(camera.eye)
    x, y, z = (np.asarray(camera.target) - eye).tolist()
    return (
        dataclasses.replace(canvas, positions=canvas.positions - eye),
        dataclasses.replace(camera, eye=(0.0, 0.0, 0.0), target=(x, y, z)),
    )


@contextlib.contextmanager
def opened_field(
    field: LobeField | TransferField, renderer: RendererName, by_table: bool
) -> Iterator[Draw]:
    """What draws a field on a canvas, by NumPy, or, lobes alone, by a context of its own.

    Raises:
        PrtnetError: the field is too large, or there is no OpenGL.
    """
    if renderer == "cpu" or not isinstance(field, LobeField):
        yield functools.partial(strips_by_numpy, field)
        return
    from runtime.gl import check_size, create_context, framed, pixels_of
    from runtime.lobe_stage import LobeStage

    context = create_context()
    with contextlib.ExitStack() as made:
        made.callback(context.release)
        made.enter_context(context)
        stage = LobeStage(context, field, by_table)
        made.callback(stage.release)

        def draw(
            canvas: Canvas,
            light: LobeLight,
            eye: FloatArray,
            matrix: FloatArray,
            size: tuple[int, int],
            step: int,
        ) -> Iterator[FloatArray]:
            """All strips in one framebuffer."""
            check_size(context, size)
            step = min(step, size[1])
            stage.light(light)
            stage.show(canvas)
            with contextlib.ExitStack() as picture:
                frame = framed(context, (size[0], step), picture)
                for top in range(0, size[1], step):
                    frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
                    # The window that the whole picture has, of which the framebuffer is a strip.
                    frame.viewport = (0, top + step - size[1], *size)
                    stage.draw(frame, matrix, eye)
                    yield pixels_of(frame, (size[0], step))[: size[1] - top]

        yield draw
