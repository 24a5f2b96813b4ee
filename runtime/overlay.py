"""Small pictures laid over what is on the screen, on the GPU.

As :func:`runtime.picture.laid_over` does it in NumPy.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["Overlay"]

VERTEX_SHADER = """#version 330
uniform vec4 place;  // left, top, width, height in pixels
uniform vec2 size;  // of the framebuffer
out vec2 texel;

void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
    texel = corner * place.zw;
    vec2 at = (place.xy + texel) / size;
    gl_Position = vec4(2.0 * at.x - 1.0, 1.0 - 2.0 * at.y, 0.0, 1.0);
}
"""

FRAGMENT_SHADER = """#version 330
uniform sampler2D picture;  // its first row is the top one
in vec2 texel;
out vec4 colour;

void main() {
    colour = texelFetch(picture, ivec2(texel), 0);
}
"""


class Overlay:
    """Lays pictures with opacity over a framebuffer of sRGB colours.

    Args:
        context: that everything lives in.
    """

    def __init__(self, context: moderngl.Context) -> None:
        self.context = context
        self.program: Any = context.program(
            vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER
        )
        self.corners = context.vertex_array(self.program, [])

    def release(self) -> None:
        """Give everything back but the context."""
        self.corners.release()
        self.program.release()

    def draw(self, target: Any, picture: FloatArray, place: tuple[int, int]) -> None:
        """Lay a picture over what is there.

        Args:
            target: a framebuffer.
            picture: (H, W, 4) uint8 sRGB and opacity, top row first.
            place: pixels from the left and from the top.
        """
        target.use()
        context = self.context
        texture = context.texture(picture.shape[1::-1], 4, np.ascontiguousarray(picture))
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        texture.use(0)
        self.program["picture"] = 0
        self.program["place"] = (*map(float, place), *map(float, picture.shape[1::-1]))
        self.program["size"] = tuple(map(float, target.size))
        context.enable_only(moderngl.BLEND)
        context.blend_func = moderngl.SRC_ALPHA, moderngl.ONE_MINUS_SRC_ALPHA
        self.corners.render(moderngl.TRIANGLE_STRIP, vertices=4)
        context.enable_only(moderngl.NOTHING)
        texture.release()
