"""Full harmonics turned for every vertex by OpenGL: what lobes are there to replace.

The vertex shader runs the zxzxz method ("LDPRT", Sloan, Luna and Snyder 2005, section 3.4) in
straight lines, written by ``prtnet.sh_rotation.zxzxz`` on words in place of numbers.
"""

from __future__ import annotations

from typing import Any

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.canvas import Canvas
from prtnet.glsl import WIDTH, filled
from prtnet.sh_rotation import zxzxz

VERTEX = """#version 330
const int POINT = $POINT;  // texels of a vertex
uniform sampler2D points;
uniform vec3 light[$COEFFICIENTS];
uniform mat4 view_projection;
in vec3 position;
in vec3 tangent;
in vec3 normal;
out vec3 radiance;

void main() {
    vec3 n = normalize(normal);
    vec3 t = normalize(tangent - dot(tangent, n) * n);
    vec3 b = cross(n, t);
    float across = length(n.xy);
    vec2 alpha = across > 0.0 ? n.xy / across : vec2(1.0, 0.0);
    vec2 beta = vec2(n.z, across);
    vec2 gamma = vec2(alpha.x * b.y - alpha.y * b.x, alpha.x * t.y - alpha.y * t.x);
    float f[4 * POINT];
    ivec2 first = ivec2((gl_VertexID % $COLUMNS) * POINT, gl_VertexID / $COLUMNS);
    for (int k = 0; k < POINT; ++k) {
        vec4 texel = texelFetch(points, first + ivec2(k, 0), 0);
        f[4 * k] = texel.x;
        f[4 * k + 1] = texel.y;
        f[4 * k + 2] = texel.z;
        f[4 * k + 3] = texel.w;
    }
$STEPS
    radiance = $SUM;
    gl_Position = view_projection * vec4(position, 1.0);
}
"""

FRAGMENT = """#version 330
in vec3 radiance;
out vec4 colour;
void main() { colour = vec4(radiance, 1.0); }
"""


class Written:
    """A number that is a word of a shader; what is made of it becomes a line there.

    Args:
        lines: that grow.
        word: of the number.
    """

    def __init__(self, lines: list[str], word: str) -> None:
        self.lines, self.word = lines, word

    def made(self, expression: str) -> Written:
        """A new number."""
        word = f"x{len(self.lines)}"
        self.lines.append(f"    float {word} = {expression};")
        return Written(self.lines, word)

    def __mul__(self, other: Any) -> Written:
        return self.made(f"{self.word} * {told(other)}")

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Written:
        return self.made(f"{self.word} + {told(other)}")

    def __sub__(self, other: Any) -> Written:
        return self.made(f"{self.word} - {told(other)}")

    def __neg__(self) -> Written:
        return self.made(f"-{self.word}")


def told(number: Any) -> str:
    """Its word, or its digits."""
    return number.word if isinstance(number, Written) else f"({float(number):.9e})"


def turned_shader(order: int) -> str:
    """The vertex shader for transfer of n bands."""
    lines: list[str] = []

    def word(text: str) -> Written:
        return Written(lines, text)

    rows = [word(f"f[{index}]") for index in range(order**2)]
    entries = [[word(f"{column}.{row}") for column in "tbn"] for row in "xyz"]
    angles = [(word(f"{name}.x"), word(f"{name}.y")) for name in ("alpha", "beta", "gamma")]
    turned = zxzxz(rows, entries, angles, order)
    point = -(-(order**2) // 4)
    words = {
        "POINT": point,
        "COEFFICIENTS": order**2,
        "COLUMNS": WIDTH // point,
        "STEPS": "\n".join(lines),
        "SUM": " + ".join(f"{one.word} * light[{index}]" for index, one in enumerate(turned)),
    }
    return filled(VERTEX, words)


class TurnedHarmonics:
    """Transfer of a mesh's vertices on a context, turned into frames and shaded.

    Args:
        context: that everything lives in.
        transfer: of vertices, matte, (V, n²); held in half precision, as lobes are.
        canvas: the mesh; counter-clockwise frames.
        harmonics: of light, (n², 3).
    """

    def __init__(
        self, context: moderngl.Context, transfer: FloatArray, canvas: Canvas, harmonics: FloatArray
    ) -> None:
        count, size = transfer.shape
        point = -(-size // 4)
        columns = WIDTH // point
        texels = np.zeros((-(-count // columns) * columns, 4 * point), dtype=np.float16)
        texels[:count, :size] = transfer
        shape = (columns * point, len(texels) // columns)
        self.texture = context.texture(shape, 4, texels.tobytes(), dtype="f2")
        self.texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
        shader = turned_shader(round(size**0.5))
        self.program: Any = context.program(vertex_shader=shader, fragment_shader=FRAGMENT)
        self.program["light"].write(np.ascontiguousarray(harmonics, dtype="f4").tobytes())
        parts = {"position": canvas.positions, "tangent": canvas.tangents, "normal": canvas.normals}
        buffers = [
            (context.buffer(np.ascontiguousarray(part, dtype="f4").tobytes()), "3f", name)
            for name, part in parts.items()
        ]
        faces = context.buffer(np.ascontiguousarray(canvas.faces, dtype="i4").tobytes())
        self.mesh = context.vertex_array(self.program, buffers, faces)
        self.context = context

    def draw(self, frame: Any, matrix: FloatArray, eye: FloatArray) -> None:
        """As ``runtime.lobe_stage.LobeStage.draw``; what is matte is alike for every eye."""
        del eye
        frame.use()
        self.program["view_projection"].write(matrix.T.astype("f4").tobytes())
        self.texture.use(0)
        self.program["points"].value = 0
        self.context.enable_only(moderngl.DEPTH_TEST)
        self.mesh.render(moderngl.TRIANGLES)
