"""A 1D BRDF on an OpenGL context: pose, light and material are swapped, no shader is built again.

What :func:`runtime.one_dimensional.side_radiance` does, vertex by vertex. The material is four
uniforms, so an exponent moves with a slider.
"""

from __future__ import annotations

import time

import moderngl
import numpy as np

from prtnet.errors import PrtnetError
from prtnet.glsl import filled, harmonics_glsl
from prtnet.one_dimensional import OneDimensional
from runtime.lit_stage import SIDES, LitStage, fetched
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
COLOURS = ("diffuse", "specular", "transmitted")


class OneDimensionalStage(LitStage):
    """One subject under one light.

    Args:
        context: that everything lives in; it must be current.
        order: bands n of light and visibility.
        count: lobes of every vertex's visibility.
    """

    def __init__(self, context: moderngl.Context, order: int, count: int) -> None:
        words = {"ORDER": order, "LOBES": most_lobes(order), "HARMONICS": harmonics_glsl(order),
                 "INCLUDE": one_dimensional_glsl(order, count)}  # fmt: skip
        shader = filled(VERTEX_SHADER, words)
        program = context.program(vertex_shader=shader, fragment_shader=FRAGMENT_SHADER)
        super().__init__(context, order, program)
        self.count = count
        self._size = 1, 1  # of a texture of lobes
        for unit, side in enumerate(SIDES):
            self._set(f"{side}_lobes", unit)

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
        self._size = texels[0].shape[1::-1]
        if len(texels[0]) > int(self.context.info["GL_MAX_TEXTURE_SIZE"]):
            many = f"{len(subject.positions)} vertices of {self.count} lobes do not fit a texture"
            raise PrtnetError("--renderer gl", f"{many}; use --renderer cpu")
        self._pose(subject)
        for name, own in zip(SIDES, texels, strict=False):
            self._held[f"{name}_lobes"].write(own)
        self.milliseconds["upload"] = 1e3 * (time.perf_counter() - started)

    def _allocate_side(self, name: str, count: int) -> None:
        """Lobes."""
        del count  # as many as ``show`` has made texels of
        self._held[f"{name}_lobes"] = fetched(self.context.texture(self._size, 4, dtype="f4"))

    def material(self, material: OneDimensional) -> None:
        """Take a material."""
        for name in COLOURS:
            self._set(name, np.broadcast_to(getattr(material, name), 3))
        self._set("exponent", material.exponent)

    def _bind(self) -> None:
        """Lobes of either side; the front's where there is no back."""
        for unit, side in enumerate(SIDES):
            self._held.get(f"{side}_lobes", self._held["front_lobes"]).use(unit)
