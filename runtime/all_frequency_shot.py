"""Pictures of all-frequency fields in one light, by OpenGL or by NumPy, one after another.

A light is only worked out when it changes; a camera that walks around costs the last step alone.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from prtnet.all_frequency import AllFrequencyField
from prtnet.arrays import FloatArray
from runtime.all_frequency import gathered, seen_from, transformed
from runtime.camera import Camera
from runtime.draw import RendererName
from runtime.rasteriser import rasterise

__all__ = ["Drawer", "framing", "opened"]


class Drawer(Protocol):
    """What both ways of drawing offer: one sample at every pixel's middle."""

    def light(self, coefficients: FloatArray) -> None:
        """Take a light: Haar coefficients of its segments, (24, (n/2)², 3)."""
        ...

    def draw(self, matrix: FloatArray, eye: FloatArray) -> FloatArray:
        """(H, W, 4) float32 linear, top row first, of world to clip space and an eye (3,)."""
        ...


class NumPyDrawer:
    """The reference."""

    def __init__(self, fields: Sequence[AllFrequencyField], size: tuple[int, int]) -> None:
        self.fields, self.size = fields, size
        before = np.cumsum([0, *(len(one) for one in fields[:-1])])
        self.positions = np.concatenate([one.surface.positions for one in fields])
        self.faces = np.concatenate(
            [one.surface.faces + start for one, start in zip(fields, before, strict=True)]
        )

    def light(self, coefficients: FloatArray) -> None:
        """As ``Drawer.light``."""
        self.rows = [gathered(one, transformed(one, coefficients)) for one in self.fields]

    def draw(self, matrix: FloatArray, eye: FloatArray) -> FloatArray:
        """As ``Drawer.draw``."""
        pairs = zip(self.fields, self.rows, strict=True)
        colours = np.concatenate([seen_from(field, rows, eye) for field, rows in pairs])
        return rasterise(self.positions, self.faces, colours, matrix, self.size)


class GLDrawer:
    """By OpenGL, all into one framebuffer.

    Args:
        fields: what is drawn.
        size: of pictures, in samples.
        made: gives everything back.
    """

    def __init__(
        self,
        fields: Sequence[AllFrequencyField],
        size: tuple[int, int],
        made: contextlib.ExitStack,
    ) -> None:
        from runtime.all_frequency_stage import AllFrequencyStage
        from runtime.gl import check_size, create_context, framed

        context = create_context()
        made.callback(context.release)
        made.enter_context(context)
        check_size(context, size)
        self.size, self.stages = size, []
        for one in fields:
            self.stages.append(AllFrequencyStage(context, one))
            made.callback(self.stages[-1].release)
        self.frame = framed(context, size, made)

    def light(self, coefficients: FloatArray) -> None:
        """As ``Drawer.light``."""
        for stage in self.stages:
            stage.light(coefficients)

    def draw(self, matrix: FloatArray, eye: FloatArray) -> FloatArray:
        """As ``Drawer.draw``."""
        from runtime.gl import pixels_of

        self.frame.use()
        self.frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        for stage in self.stages:
            stage.draw(self.frame, matrix, eye)
        return pixels_of(self.frame, self.size)


@contextlib.contextmanager
def opened(
    fields: Sequence[AllFrequencyField], renderer: RendererName, size: tuple[int, int]
) -> Iterator[Drawer]:
    """What draws fields that stand together, for as many pictures as wanted.

    Args:
        fields: of one size of cube maps.
        renderer: 'gl' or 'cpu'.
        size: of pictures, in samples.

    Raises:
        PrtnetError: there is no OpenGL, or the picture or a field is too large for it.
    """
    if renderer == "cpu":
        yield NumPyDrawer(fields, size)
        return
    with contextlib.ExitStack() as made:
        yield GLDrawer(fields, size, made)


def framing(
    fields: Sequence[AllFrequencyField], aspect: float, azimuth: float, elevation: float
) -> Camera:
    """Sees the first of them as ``Camera.framing`` does, and cuts nothing off the others."""
    first, *others = (one.surface.positions for one in fields)
    camera = Camera.framing(first, aspect, azimuth, elevation)
    if not others:
        return camera
    reach = np.linalg.norm(np.concatenate(others) - np.asarray(camera.eye), axis=1).max()
    far = max(camera.far, 1.1 * float(reach))
    return dataclasses.replace(camera, near=min(camera.near, 1e-3 * far), far=far)
