"""A mesh in a pose under zonal lobes of light, on an OpenGL context; what shades it is subclasses'.

What changes each frame is written into buffers and textures that stay.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.zh import Lobes
from runtime.gpu_timer import GPUTimer
from runtime.holding import Holding
from runtime.material_shader import most_lobes
from runtime.one_dimensional import LobeSide, LobeSubject
from runtime.reflected import Side, Subject

__all__ = ["SIDES", "LitStage", "fetched"]

SIDES = ("front", "back")


class LitStage(Holding, ABC):
    """One subject under one light.

    Args:
        context: that everything lives in; it must be current.
        order: bands n of the light.
        program: of two shaders; its attributes are ``position`` and of either side the tangent and
            the normal.

    Attributes:
        milliseconds: of the last ``show`` (on the CPU) and the ``draw`` before the last (on the
            GPU, where it has timers), by name.
    """

    stay: tuple[str, ...] = ()
    """Buffers and textures that are held whatever the mesh is."""

    def __init__(self, context: moderngl.Context, order: int, program: Any) -> None:
        super().__init__(context)
        self.order = order
        self.program: Any = self._keep(program)
        self.milliseconds: dict[str, float] = {}
        self._shape: tuple[int, int, bool] | None = None
        self._faces: IntArray | None = None
        self._timer = self._keep(GPUTimer(context))

    def _pose(self, subject: Subject | LobeSubject) -> None:
        """Take vertices, frames and triangles, of another mesh if need be."""
        shape = len(subject.positions), len(subject.faces), subject.back is not None
        if shape != self._shape:
            self._allocate(shape)
        if subject.faces is not self._faces:
            self._held["faces"].write(np.ascontiguousarray(subject.faces, dtype="i4"))
            self._faces = subject.faces
        self._held["positions"].write(np.ascontiguousarray(subject.positions, dtype="f4"))
        sides: Sequence[Side | LobeSide] = subject.sides
        for name, side in zip(SIDES, sides, strict=False):
            pair = side.frames[..., [0, 2]].swapaxes(1, 2)  # tangent, then normal
            self._held[f"{name}_frames"].write(np.ascontiguousarray(pair, dtype="f4"))

    def _allocate(self, shape: tuple[int, int, bool]) -> None:
        """Buffers and textures of a new mesh: vertices, triangles, whether it has a back."""
        count, triangles, both = shape
        self._drop([name for name in self._held if name not in self.stay])
        self._held["faces"] = self.context.buffer(reserve=max(1, 12 * triangles))
        self._held["positions"] = self.context.buffer(reserve=max(1, 12 * count))
        for name in SIDES if both else SIDES[:1]:
            self._held[f"{name}_frames"] = self.context.buffer(reserve=max(1, 24 * count))
            self._allocate_side(name, count)
        seen = "front", "back" if both else "front"
        attributes = self._attributes(self._held["positions"], "position")
        for name, own in zip(SIDES, seen, strict=True):
            frames = self._held[f"{own}_frames"]
            attributes += self._attributes(frames, f"{name}_tangent", f"{name}_normal")
            attributes += self._attributes_of_side(name, own)
        faces = self._held["faces"]
        self._mesh = self.context.vertex_array(self.program, attributes, faces)
        self._set("two_sided", both)
        self._shape, self._faces = shape, None

    @abstractmethod
    def _allocate_side(self, name: str, count: int) -> None:
        """What else a side of so many vertices holds."""

    def _attributes_of_side(self, name: str, own: str) -> list[tuple[Any, ...]]:
        """What else the shader reads for a side, of the buffers of its own or the front's."""
        del name, own
        return []

    def _attributes(self, buffer: Any, *names: str) -> list[tuple[Any, ...]]:
        """Three floats each; those that the shader of a low order has no use for are skipped."""
        used = [name for name in names if name in self.program]
        layout = " ".join("3f" if name in used else "12x" for name in names)
        return [(buffer, layout, *used)] if used else []

    def _set(self, name: str, value: Any) -> None:
        """A uniform, unless the shader of a low order has no use for it."""
        if name in self.program:
            if isinstance(value, np.ndarray):
                self.program[name].write(np.ascontiguousarray(value, dtype="f4"))
            else:
                self.program[name] = value

    def light(self, lobes: Lobes) -> None:
        """Take a light of lobes for three colours: axes (3, N, 3), coefficients (3, N, n).

        Raises:
            ValueError: they are too many, or of another order.
        """
        colours, count, order = lobes.coefficients.shape
        most = most_lobes(self.order)
        if colours != 3 or count > most or order != self.order:
            raise ValueError(f"{colours} x {count} lobes of order {order} do not fit the shader")
        axes = np.zeros((3, most, 3), dtype="f4")
        zonal = np.zeros((3, most, order), dtype="f4")
        axes[:, :count], zonal[:, :count] = lobes.axes, lobes.coefficients
        axes[:, count:, 2] = 1.0
        self._set("axis", axes)
        self._set("zonal", zonal)
        self._set("lobes", count)

    def draw(self, frame: Any, matrix: FloatArray, eye: FloatArray) -> None:
        """Draw into a framebuffer over what is there; its depth is tested.

        Args:
            frame: of OpenGL.
            matrix: world to clip space, (4, 4), as ``Camera.matrix``.
            eye: where the camera is, (3,).
        """
        frame.use()
        self.context.enable_only(moderngl.DEPTH_TEST)
        self._set("view_projection", np.asarray(matrix).T)
        self._set("eye", np.asarray(eye))
        self._bind()
        with self._timer:
            self._mesh.render(moderngl.TRIANGLES)
        if self._timer.milliseconds is not None:
            self.milliseconds["draw"] = self._timer.milliseconds

    @abstractmethod
    def _bind(self) -> None:
        """Every texture to its unit."""


def fetched(texture: Any) -> Any:
    """A texture that is read texel by texel, whatever lies between them."""
    texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
    return texture
