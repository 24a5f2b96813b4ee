"""A 1D BRDF on an OpenGL context: pose, light and material are swapped, no shader is built again.

What :func:`runtime.one_dimensional.side_radiance` does, vertex by vertex. The material is four
uniforms, so an exponent moves with a slider.
"""

from __future__ import annotations

import time
from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.glsl import filled, harmonics_glsl
from prtnet.one_dimensional import OneDimensional
from prtnet.zh import Lobes
from runtime.gpu_timer import GPUTimer
from runtime.material_shader import FRAGMENT_SHADER, most_lobes
from runtime.one_dimensional import LobeSubject
from runtime.one_dimensional_shader import lobe_texels, one_dimensional_glsl

__all__ = ["OneDimensionalStage"]

VERTEX_SHADER = """#version 330
const int ORDER = $ORDER;
const int COEFFICIENTS = ORDER * ORDER;

uniform mat4 view_projection;
uniform vec3 eye;
uniform int lobes;
uniform vec3 axis[3 * $LOBES];
uniform float zonal[3 * $LOBES * ORDER];
uniform bool two_sided;
uniform vec3 diffuse;
uniform vec3 specular;
uniform float exponent;
uniform vec3 transmitted;

in vec3 position;
in vec3 front_tangent;
in vec3 front_normal;
in vec3 back_tangent;
in vec3 back_normal;
out vec3 front;
out vec3 back;

$HARMONICS
$INCLUDE
vec3 radiance(bool behind, mat3 frame, mat3 other) {
    return one_dimensional(behind, frame, normalize(eye - position), diffuse, specular, exponent,
                           transmitted, two_sided, other);
}

void main() {
    mat3 face = mat3(front_tangent, cross(front_normal, front_tangent), front_normal);
    mat3 rear = mat3(back_tangent, cross(back_normal, back_tangent), back_normal);
    front = radiance(false, face, rear);
    back = two_sided ? radiance(true, rear, face) : front;
    gl_Position = view_projection * vec4(position, 1.0);
}
"""
SIDES = ("front", "back")
COLOURS = ("diffuse", "specular", "transmitted")


class OneDimensionalStage:
    """One subject under one light.

    Args:
        context: that everything lives in; it must be current.
        order: bands n of light and visibility.
        count: lobes of every vertex's visibility.

    Attributes:
        milliseconds: of the last ``show`` (on the CPU) and the ``draw`` before the last (on the
            GPU, where it has timers), by name.
    """

    def __init__(self, context: moderngl.Context, order: int, count: int) -> None:
        self.context, self.order, self.count = context, order, count
        words = {"ORDER": order, "LOBES": most_lobes(order), "HARMONICS": harmonics_glsl(order),
                 "INCLUDE": one_dimensional_glsl(order, count)}  # fmt: skip
        self.program: Any = context.program(
            vertex_shader=filled(VERTEX_SHADER, words), fragment_shader=FRAGMENT_SHADER
        )
        self.milliseconds: dict[str, float] = {}
        self.timer = GPUTimer(context)
        self._held: dict[str, Any] = {}
        self._mesh: Any = None
        self._shape: tuple[int, int, bool] | None = None
        for unit, side in enumerate(SIDES):
            self._set(f"{side}_lobes", np.int32(unit))

    def release(self) -> None:
        """Give everything back but the context."""
        for held in [self._mesh, *self._held.values(), self.program]:
            if held is not None:
                held.release()
        self._held.clear()
        self._mesh = None

    @property
    def resources(self) -> list[Any]:
        """Buffers and textures that are held."""
        return list(self._held.values())

    def show(self, subject: LobeSubject) -> None:
        """Take a subject's pose.

        Raises:
            PrtnetError: it has more vertices than a texture of this OpenGL holds.
            ValueError: its lobes are of another number or order.
        """
        started = time.perf_counter()
        for side in subject.sides:
            if side.visibility.coefficients.shape[1:] != (self.count, self.order):
                raise ValueError(f"the shader is for {self.count} lobes of order {self.order}")
        texels = [lobe_texels(side.visibility).astype("f4") for side in subject.sides]
        if len(texels[0]) > int(self.context.info["GL_MAX_TEXTURE_SIZE"]):
            many = f"{len(subject.positions)} vertices of {self.count} lobes do not fit a texture"
            raise PrtnetError("--renderer gl", f"{many}; use --renderer cpu")
        shape = (len(subject.positions), len(subject.faces), subject.back is not None)
        if shape != self._shape:
            self._allocate(shape, texels)
        self._held["faces"].write(np.ascontiguousarray(subject.faces, dtype="i4"))
        self._held["positions"].write(np.ascontiguousarray(subject.positions, dtype="f4"))
        for name, side, own in zip(SIDES, subject.sides, texels, strict=False):
            pair = side.frames[..., [0, 2]].swapaxes(1, 2)  # tangent, then normal
            self._held[f"{name}_frames"].write(np.ascontiguousarray(pair, dtype="f4"))
            self._held[f"{name}_lobes"].write(own)
        self.milliseconds["upload"] = 1e3 * (time.perf_counter() - started)

    def _allocate(self, shape: tuple[int, int, bool], texels: list[FloatArray]) -> None:
        """Buffers and textures of a new mesh."""
        count, faces, both = shape
        for held in [self._mesh, *self._held.values()]:
            if held is not None:
                held.release()
        buffer, held = self.context.buffer, self._held
        held.clear()
        held["faces"] = buffer(reserve=max(1, 12 * faces))
        held["positions"] = buffer(reserve=max(1, 12 * count))
        for name, own in zip(SIDES, texels, strict=False):
            held[f"{name}_frames"] = buffer(reserve=max(1, 24 * count))
            held[f"{name}_lobes"] = self.context.texture(own.shape[1::-1], 4, dtype="f4")
            held[f"{name}_lobes"].filter = (moderngl.NEAREST, moderngl.NEAREST)
        rear = held["back_frames" if both else "front_frames"]
        self._mesh = self.context.vertex_array(
            self.program,
            [
                (held["positions"], "3f", "position"),
                *self._used(held["front_frames"], "front_tangent", "front_normal"),
                *self._used(rear, "back_tangent", "back_normal"),
            ],
            held["faces"],
        )
        self._set("two_sided", np.int32(both))
        self._shape = shape

    def _used(self, buffer: Any, *names: str) -> list[tuple[Any, ...]]:
        """Three floats each; those that the shader of a low order has no use for are skipped."""
        used = [name for name in names if name in self.program]
        layout = " ".join("3f" if name in used else "12x" for name in names)
        return [(buffer, layout, *used)] if used else []

    def light(self, light: Lobes) -> None:
        """Take a light of lobes for three colours: axes (3, N, 3), coefficients (3, N, n).

        Raises:
            ValueError: they are too many, or of another order.
        """
        colours, count, order = light.coefficients.shape
        most = most_lobes(self.order)
        if colours != 3 or count > most or order != self.order:
            raise ValueError(f"{colours} x {count} lobes of order {order} do not fit the shader")
        axes, zonal = np.zeros((3, most, 3), "f4"), np.zeros((3, most, order), "f4")
        axes[:, :count], zonal[:, :count] = light.axes, light.coefficients
        self._set("axis", axes)
        self._set("zonal", zonal)
        self._set("lobes", np.int32(count))

    def material(self, material: OneDimensional) -> None:
        """Take a material."""
        for name in COLOURS:
            self._set(name, np.broadcast_to(getattr(material, name), 3).astype("f4"))
        self._set("exponent", np.float32(material.exponent))

    def draw(self, frame: Any, matrix: FloatArray, eye: FloatArray) -> None:
        """Draw into a framebuffer over what is there; its depth is tested.

        Args:
            frame: of OpenGL.
            matrix: world to clip space, (4, 4), as ``Camera.matrix``.
            eye: where the camera is, (3,).
        """
        frame.use()
        self.context.enable_only(moderngl.DEPTH_TEST)
        self._set("view_projection", np.asarray(matrix).T.astype("f4"))
        self._set("eye", np.asarray(eye).astype("f4"))
        for unit, side in enumerate(SIDES):
            self._held.get(f"{side}_lobes", self._held["front_lobes"]).use(unit)
        with self.timer:
            self._mesh.render(moderngl.TRIANGLES)
        if self.timer.milliseconds is not None:
            self.milliseconds["draw"] = self.timer.milliseconds

    def _set(self, name: str, value: Any) -> None:
        """A uniform, unless the shader of a low order has no use for it."""
        if name in self.program:
            self.program[name].write(np.ascontiguousarray(value))
