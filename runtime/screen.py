"""From linear radiance to the screen, on the GPU: samples, exposure, background, sRGB.

The same steps as :func:`runtime.picture.develop`, in a fragment shader.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray

__all__ = ["Screen"]

SAMPLES = 4  # a pixel, where OpenGL has as many

VERTEX_SHADER = """#version 330
const vec2 CORNERS[3] = vec2[3](vec2(-1.0, -1.0), vec2(3.0, -1.0), vec2(-1.0, 3.0));

void main() {
    gl_Position = vec4(CORNERS[gl_VertexID], 0.0, 1.0);
}
"""

FRAGMENT_SHADER = """#version 330
uniform sampler2D linear_colour;
uniform float exposure;
uniform vec2 size;  // of the picture, in pixels
out vec4 colour;

vec3 backdrop(vec2 place) {
    vec2 at = vec2(place.x - 0.5 * size.x, size.y - place.y - 0.55 * size.y) / size.y;
    float glow = exp(-2.2 * (at.x * at.x + 1.69 * at.y * at.y));
    return mix(vec3(0.018, 0.019, 0.022), vec3(0.115, 0.12, 0.13), glow);
}

void main() {
    vec4 drawn = texelFetch(linear_colour, ivec2(gl_FragCoord.xy), 0);
    vec3 lit = exposure * drawn.rgb + (1.0 - drawn.a) * backdrop(gl_FragCoord.xy);
    lit = clamp(lit, 0.0, 1.0);
    vec3 curve = 1.055 * pow(max(lit, vec3(0.0031308)), vec3(1.0 / 2.4)) - 0.055;
    colour = vec4(mix(12.92 * lit, curve, step(vec3(0.0031308), lit)), 1.0);
}
"""


class Screen:
    """A picture that is drawn in linear colour and shown as sRGB.

    Args:
        context: that everything lives in.
        samples: a pixel; fewer where OpenGL has fewer.
    """

    def __init__(self, context: moderngl.Context, samples: int = SAMPLES) -> None:
        self.context = context
        self.samples = min(samples, int(context.max_samples))
        self.program: Any = context.program(
            vertex_shader=VERTEX_SHADER, fragment_shader=FRAGMENT_SHADER
        )
        self.triangle = context.vertex_array(self.program, [])
        self.size = (0, 0)
        self._held: list[Any] = []
        self.frame: Any = None
        self._resolved: Any = None

    def release(self) -> None:
        """Give everything back but the context."""
        for held in (*self._held, self.triangle, self.program):
            held.release()
        self._held = []

    @property
    def resources(self) -> list[Any]:
        """What holds samples and pixels."""
        return list(self._held)

    def clear(self, size: tuple[int, int]) -> Any:
        """A framebuffer of this size to draw linear colour into, empty."""
        if size != self.size:
            for held in self._held:
                held.release()
            context = self.context
            colour = context.renderbuffer(size, 4, samples=self.samples, dtype="f2")
            depth = context.depth_renderbuffer(size, samples=self.samples)
            self.frame = context.framebuffer([colour], depth)
            texture = context.texture(size, 4, dtype="f2")
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            self._resolved = context.framebuffer([texture])
            self._held = [self.frame, colour, depth, self._resolved, texture]
            self.size = size
        self.frame.use()
        self.frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        return self.frame

    def linear(self) -> FloatArray:
        """What has been drawn: (H, W, 4) float32, top row first."""
        self.context.copy_framebuffer(self._resolved, self.frame)
        data = np.frombuffer(self._resolved.read(components=4, dtype="f2"), dtype="f2")
        return data.reshape(self.size[1], self.size[0], 4)[::-1].astype(np.float32)

    def present(self, target: Any, exposure: float) -> None:
        """Show what has been drawn in a framebuffer of the same size."""
        self.context.copy_framebuffer(self._resolved, self.frame)
        target.use()
        self.context.enable_only(moderngl.NOTHING)
        self._resolved.color_attachments[0].use(0)
        self.program["linear_colour"] = 0
        self.program["exposure"] = exposure
        self.program["size"] = self.size
        self.triangle.render(moderngl.TRIANGLES, vertices=3)
