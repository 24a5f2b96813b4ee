"""A mesh with a colour of its own at every vertex, on an OpenGL context: heat maps."""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from runtime.material_shader import FRAGMENT_SHADER
from runtime.shading import Surface

__all__ = ["Painted"]

VERTEX_SHADER = """#version 330
uniform mat4 view_projection;
in vec3 position;
in vec3 front_colour;
in vec3 back_colour;
out vec3 front;
out vec3 back;

void main() {
    front = front_colour;
    back = back_colour;
    gl_Position = view_projection * vec4(position, 1.0);
}
"""


class Painted:
    """Draws coloured surfaces.

    Args:
        context: that everything lives in.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.program: Any = context.program(
            vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER
        )

    def release(self) -> None:
        """Give everything back but the context."""
        self.program.release()

    def draw(self, frame: Any, surface: Surface, matrix: FloatArray, gain: float) -> None:
        """Draw a surface whose transfer is its colour, linear RGB (V, 3), times a gain."""
        frame.use()
        self.context.enable_only(moderngl.DEPTH_TEST)
        self.program["view_projection"].write(np.ascontiguousarray(matrix.T, dtype="f4"))
        back = surface.transfer if surface.back_transfer is None else surface.back_transfer
        columns = [surface.positions, gain * surface.transfer, gain * back]
        buffer = self.context.buffer(np.concatenate(columns, axis=1, dtype="f4"))
        faces = self.context.buffer(np.ascontiguousarray(surface.faces, dtype="i4"))
        names = "position", "front_colour", "back_colour"
        mesh = self.context.vertex_array(self.program, [(buffer, "3f 3f 3f", *names)], faces)
        mesh.render(moderngl.TRIANGLES)
        for held in (mesh, faces, buffer):
            held.release()
