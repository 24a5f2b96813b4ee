"""What one receiver sees, rebuilt on the GPU as for a picture, and read back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.glsl import filled
from prtnet.gpu_tables import GPUTables, glsl

__all__ = ["VertexProbe"]

SHADER = """#version 330
$VISIBILITY
uniform int receiver;
$DECLARED

void main() {
    vec4 v[PRTNET_TEXELS];
    prtnet_visibility(receiver, v);
$WRITTEN
}
"""


class VertexProbe:
    """The exported GLSL, run for one receiver alone by transform feedback.

    Args:
        context: that everything lives in; it must be current.
        tables: of a model.
        units: where each of its textures is bound when the probe is called, by name.
    """

    def __init__(
        self, context: moderngl.Context, tables: GPUTables, units: Mapping[str, int]
    ) -> None:
        self.size = tables.order**2
        names = [f"seen{k}" for k in range(-(-self.size // 4))]
        words = {
            "VISIBILITY": glsl(tables),
            "DECLARED": "\n".join(f"out vec4 {name};" for name in names),
            "WRITTEN": "\n".join(f"    {name} = v[{k}];" for k, name in enumerate(names)),
        }
        self.program: Any = context.program(vertex_shader=filled(SHADER, words), varyings=names)
        for name, unit in units.items():
            if name in self.program:
                self.program[name] = unit
        self._mesh: Any = context.vertex_array(self.program, [])
        self._result: Any = context.buffer(reserve=16 * len(names))
        # OpenGL draws nothing without one.
        self._pixel: Any = context.renderbuffer((1, 1))
        self._frame: Any = context.framebuffer([self._pixel])
        self._scope: Any = context.scope(self._frame)

    def __call__(self, receiver: int) -> FloatArray:
        """Its visibility in its local frame, (n²,) float32."""
        self.program["receiver"] = receiver
        with self._scope:
            self._mesh.transform(self._result, moderngl.POINTS, vertices=1)
        return np.frombuffer(self._result.read(), dtype=np.float32)[: self.size].copy()

    def release(self) -> None:
        """Give everything back but the context."""
        held = self._scope, self._frame, self._pixel, self._mesh, self._result, self.program
        for one in held:
            one.release()
