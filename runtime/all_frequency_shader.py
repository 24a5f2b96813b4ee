"""GLSL of all-frequency transfer: 3.30, nothing beyond WebGL 2's reach; see runtime.all_frequency.

Three programs. One sums products over the segments that reach a vertex, a texel for each row of
each vertex, and is run when the light has changed; what is summed on the CPU may stand in the same
texture. One, run when the eye has moved, looks view factors up, a texel for each vertex: a fragment
shader, because OpenGL in software runs those alone on all cores. The last draws the mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.glsl import CONCENTRIC, WIDTH, filled, texture
from prtnet.reflection import LOWEST
from runtime.all_frequency_products import Runs

__all__ = [
    "columns_of",
    "draw_shaders",
    "product_texels",
    "run_textures",
    "seen_shaders",
    "sum_shaders",
]

TRIANGLE_VERTEX = """#version $VERSION
const vec2 CORNERS[3] = vec2[3](vec2(-1.0, -1.0), vec2(3.0, -1.0), vec2(-1.0, 3.0));
void main() { gl_Position = vec4(CORNERS[gl_VertexID], 0.0, 1.0); }
"""

SUM_FRAGMENT = """#version $VERSION
uniform highp sampler2D products;  // m texels of a representative, one behind another
uniform highp isampler2D starts;  // of each vertex's runs, and the end of the last
uniform highp isampler2D first;  // representative of a run
uniform highp isampler2D weights;  // of a run, four a texel
uniform int vertices;
uniform int texels;  // of a run's weights
out vec4 sum;

ivec2 at(int k) { return ivec2(k % $WIDTH, k / $WIDTH); }
vec3 product(int k) { return texelFetch(products, at(k), 0).rgb; }

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    int vertex = place.y * $COLUMNS + place.x / $ROWS;
    vec3 total = vec3(0.0);
    int end = vertex < vertices ? texelFetch(starts, at(vertex + 1), 0).x : 0;
    int run = vertex < vertices ? texelFetch(starts, at(vertex), 0).x : 0;
    for (; run < end; ++run) {
        int k = texelFetch(first, at(run), 0).x * $ROWS + place.x % $ROWS;
        for (int j = 0; j < texels; ++j) {
            vec4 w = vec4(texelFetch(weights, at(run * texels + j), 0));
            total += w.x * product(k) + w.y * product(k + $ROWS)
                   + w.z * product(k + 2 * $ROWS) + w.w * product(k + 3 * $ROWS);
            k += 4 * $ROWS;
        }
    }
    sum = vec4(total, 1.0);
}
"""

SEEN_FRAGMENT = """#version $VERSION
uniform highp sampler2D sums;  // m texels of a vertex, whole vertices a row
uniform highp sampler2DArray view_factors;  // a layer a row
uniform highp sampler2D positions;
uniform highp sampler2D tangents;
uniform highp sampler2D normals;
uniform int rows;  // m again: a loop that compilers do not unroll is compiled much faster
uniform int vertices;
uniform highp vec3 eye;
out vec4 radiance;

$CONCENTRIC
void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    int vertex = place.y * $WIDTH + place.x;
    radiance = vec4(0.0, 0.0, 0.0, 1.0);
    if (vertex >= vertices) return;
    vec3 n = normalize(texelFetch(normals, place, 0).rgb);
    vec3 tangent = texelFetch(tangents, place, 0).rgb;
    vec3 t = normalize(tangent - dot(tangent, n) * n);
    vec3 local = normalize(eye - texelFetch(positions, place, 0).rgb) * mat3(t, cross(n, t), n);
    vec2 cell = on_square(normalize(vec3(local.xy, max(local.z, $LOWEST))));
    ivec2 texel = ivec2((vertex % $COLUMNS) * $ROWS, vertex / $COLUMNS);
    for (int row = 0; row < rows; ++row)
        radiance.rgb += texelFetch(sums, texel + ivec2(row, 0), 0).rgb
                      * textureLod(view_factors, vec3(cell, float(row)), 0.0).rgb;
}
"""

DRAW_VERTEX = """#version $VERSION
uniform highp sampler2D radiances;  // a texel a vertex
uniform mat4 view_projection;
in vec3 position;
out vec3 radiance;

void main() {
    radiance = texelFetch(radiances, ivec2(gl_VertexID % $WIDTH, gl_VertexID / $WIDTH), 0).rgb;
    gl_Position = view_projection * vec4(position, 1.0);
}
"""

DRAW_FRAGMENT = """#version $VERSION
in vec3 radiance;
out vec4 colour;
void main() { colour = vec4(radiance, 1.0); }
"""


def sum_shaders(rows: int, version: str = "330") -> tuple[str, str]:
    """Vertex and fragment shader of what sums products: one triangle over all texels.

    Args:
        rows: m, built in.
        version: of GLSL, and the default precisions where it asks for them.
    """
    words = words_of(rows, version)
    return filled(TRIANGLE_VERTEX, words), filled(SUM_FRAGMENT, words)


def seen_shaders(rows: int, version: str = "330") -> tuple[str, str]:
    """Vertex and fragment shader of what vertices show an eye; see ``sum_shaders``."""
    words = words_of(rows, version)
    return filled(TRIANGLE_VERTEX, words), filled(SEEN_FRAGMENT, words)


def draw_shaders(version: str = "330") -> tuple[str, str]:
    """Vertex and fragment shader of what draws the mesh; see ``sum_shaders``."""
    words = {"VERSION": version, "WIDTH": WIDTH}
    return filled(DRAW_VERTEX, words), filled(DRAW_FRAGMENT, words)


def words_of(rows: int, version: str) -> dict[str, object]:
    """What is built into shaders."""
    return {"VERSION": version, "COLUMNS": columns_of(rows), "ROWS": rows, "WIDTH": WIDTH,
            "CONCENTRIC": CONCENTRIC, "LOWEST": f"{LOWEST:e}"}  # fmt: skip


def columns_of(rows: int) -> int:
    """Vertices in a row of the texture of sums.

    Raises:
        PrtnetError: not even one fits.
    """
    if rows > WIDTH:
        what = f"{rows} rows of a vertex are too many for a texture"
        raise PrtnetError("--renderer gl", f"{what}; use --renderer cpu")
    return WIDTH // rows


def run_textures(runs: Runs) -> dict[str, Any]:
    """What stays on the GPU, (height, WIDTH, channels) each: starts, first and weights."""
    count, terms = runs.weights.shape
    padded = np.zeros((count, 4 * -(-terms // 4)), dtype=np.int16)
    padded[:, :terms] = runs.weights
    return {
        "starts": texture(runs.starts[:, None]),
        "first": texture(runs.first[:, None]),
        "weights": texture(padded.reshape(-1, 4)),
    }


def product_texels(products: FloatArray) -> FloatArray:
    """Products (representatives, m, 3) as a texture (height, WIDTH, 3) float32.

    Behind them are zeros where terms that a cluster has not point to: they weigh nothing, and must
    be numbers.
    """
    behind = np.zeros((3, *products.shape[1:]), dtype=np.float32)
    return np.asarray(texture(np.concatenate([products, behind]).reshape(-1, 3)))
