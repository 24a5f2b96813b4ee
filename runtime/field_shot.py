"""A picture of a field on a mesh, by OpenGL or by NumPy."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.canvas import Canvas
from prtnet.lobe_field import LobeField
from prtnet.transfer import TransferField
from runtime.camera import Camera
from runtime.draw import RendererName, averaged, finer
from runtime.lobe_picture import strip_rows, strips_by_numpy
from runtime.lobe_shading import LobeLight, light_table

__all__ = ["FieldShot"]


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
        fine = finer(self.size, samples)
        by_table = by_table and isinstance(field, LobeField)
        light = LobeLight(self.light, light_table(self.light) if by_table else None)
        canvas, camera = seen_from_origin(self.canvas, self.camera)
        matrix, eye = camera.matrix(self.size[0] / self.size[1]), np.asarray(camera.eye)
        by_gl = renderer == "gl" and isinstance(field, LobeField)
        draw: Any = strips_by_gl if by_gl else strips_by_numpy
        scale = fine[1] // self.size[1]
        strips = draw(field, canvas, light, eye, matrix, fine, strip_rows(fine, scale))
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


def strips_by_gl(
    field: LobeField,
    canvas: Canvas,
    light: LobeLight,
    eye: FloatArray,
    matrix: FloatArray,
    size: tuple[int, int],
    step: int,
) -> Iterator[FloatArray]:
    """As ``strips_by_numpy``, by a context of its own, all of them in one framebuffer."""
    from runtime.gl import check_size, create_context, framed, pixels_of
    from runtime.lobe_stage import LobeStage

    context = create_context()
    with contextlib.ExitStack() as made:
        made.callback(context.release)
        made.enter_context(context)
        check_size(context, size)
        step = min(step, size[1])
        stage = LobeStage(context, field, light.table is not None)
        made.callback(stage.release)
        stage.light(light)
        stage.show(canvas)
        frame = framed(context, (size[0], step), made)
        for top in range(0, size[1], step):
            frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
            # The window that the whole picture has, of which the framebuffer is a strip.
            frame.viewport = (0, top + step - size[1], *size)
            stage.draw(frame, matrix, eye)
            yield pixels_of(frame, (size[0], step))[: size[1] - top]
