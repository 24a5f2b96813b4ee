"""GLSL of 1D BRDFs: 3.30, nothing beyond WebGL 2's reach; what runtime.one_dimensional does.

An include for a vertex shader. The exponent is an argument, so it may change with time or from
vertex to vertex: the integrals of :mod:`prtnet.phong` follow one another with a few divisions, and
its weights are constants. The shader that includes it declares before

    const int ORDER, COEFFICIENTS                       n and n²
    uniform int lobes;                                  of light, of each colour
    uniform vec3 axis[3 * $LOBES];                      in world space, one colour after the other
    uniform float zonal[3 * $LOBES * ORDER];            of each, by bands
    void harmonics(vec3 d, out float y[COEFFICIENTS])   prtnet.glsl.harmonics_glsl

as the shader of any material has them, with ``runtime.material_shader.most_lobes`` for ``$LOBES``,
and calls ``one_dimensional``. Visibility is read from the textures ``front_lobes`` and
``back_lobes``, as :func:`lobe_texels` makes them.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.glsl import WIDTH
from prtnet.phong import Block, blocks
from prtnet.reflection import LOWEST
from prtnet.zh import Lobes
from runtime.material_shader import most_lobes

__all__ = ["lobe_columns", "lobe_texels", "one_dimensional_glsl", "phong_glsl"]

GLSL = """
const int SEEN = $SEEN;  // lobes of a vertex's visibility
const int SEEN_TEXELS = (ORDER + 6) / 4;  // of each: its axis, then its coefficients
const int SEEN_COLUMNS = $COLUMNS;  // vertices in a row of a texture
uniform highp sampler2D front_lobes;
uniform highp sampler2D back_lobes;

$PHONG
// As prtnet.axis_frames: +z is taken there by the shortest way.
mat3 frame_about(vec3 a) {
    float sine = length(a.xy);
    vec2 side = sine > 0.0 ? a.xy / sine : vec2(1.0, 0.0);
    vec2 less = (1.0 - a.z) * side;
    return mat3(1.0 - less.x * side.x, -less.x * side.y, -a.x,
                -less.x * side.y, 1.0 - less.y * side.y, -a.y, a);
}

// Visibility in a frame whose columns are given in the local one.
void seen(bool behind, mat3 turn, out float v[COEFFICIENTS]) {
    ivec2 first = ivec2((gl_VertexID % SEEN_COLUMNS) * SEEN * SEEN_TEXELS,
                        gl_VertexID / SEEN_COLUMNS);
    float y[COEFFICIENTS];
    float lobe[4 * SEEN_TEXELS];
    for (int i = 0; i < COEFFICIENTS; ++i) v[i] = 0.0;
    for (int k = 0; k < SEEN; ++k) {
        for (int j = 0; j < SEEN_TEXELS; ++j) {
            ivec2 place = first + ivec2(k * SEEN_TEXELS + j, 0);
            vec4 texel = behind ? texelFetch(back_lobes, place, 0)
                                : texelFetch(front_lobes, place, 0);
            lobe[4 * j] = texel.x;
            lobe[4 * j + 1] = texel.y;
            lobe[4 * j + 2] = texel.z;
            lobe[4 * j + 3] = texel.w;
        }
        harmonics(vec3(lobe[0], lobe[1], lobe[2]) * turn, y);
        for (int l = 0; l < ORDER; ++l)
            for (int i = l * l; i < (l + 1) * (l + 1); ++i) v[i] += lobe[3 + l] * y[i];
    }
}

// Light through a transfer vector in a frame whose columns are given in world space.
vec3 lit(mat3 turn, float t[COEFFICIENTS]) {
    vec3 sum = vec3(0.0);
    float y[COEFFICIENTS];
    for (int k = 0; k < lobes; ++k) {
        for (int c = 0; c < 3; ++c) {
            int lobe = c * $LOBES + k;
            if (c == 0 || axis[lobe] != axis[lobe - $LOBES]) harmonics(axis[lobe] * turn, y);
            for (int l = 0; l < ORDER; ++l) {
                float band = 0.0;
                for (int i = l * l; i < (l + 1) * (l + 1); ++i) band += t[i] * y[i];
                sum[c] += zonal[lobe * ORDER + l] * band;
            }
        }
    }
    return sum;
}

// (e + 1)/2pi times the integral of light, visibility and the e-th power of the cosine to an axis,
// given in the local frame, over the hemisphere around it.
vec3 lobe_radiance(bool behind, mat3 frame, vec3 local, float e) {
    mat3 turn = frame_about(local);
    float v[COEFFICIENTS];
    float t[COEFFICIENTS];
    seen(behind, turn, v);
    phong(e, v, t);
    return lit(frame * turn, t);
}

// The same of light alone, of an axis in world space.
vec3 unshadowed_radiance(vec3 a, float e) {
    float k[ORDER];
    phong_zonal(e, k);
    vec3 sum = vec3(0.0);
    for (int i = 0; i < lobes; ++i) {
        for (int c = 0; c < 3; ++c) {
            int lobe = c * $LOBES + i;
            float x = dot(axis[lobe], a);
            float before = 0.0;
            float p = 1.0;  // Legendre
            for (int l = 0; l < ORDER; ++l) {
                sum[c] += zonal[lobe * ORDER + l] * k[l] * p * float(2 * l + 1) * $SPHERE;
                float next = (float(2 * l + 1) * x * p - float(l) * before) / float(l + 1);
                before = p;
                p = next;
            }
        }
    }
    return sum;
}

// Radiance towards a unit direction in world space.
//   behind, frame    the side that is seen, and its frame
//   shadowed, other  whether what is transmitted is shadowed by the other side, and its frame
vec3 one_dimensional(bool behind, mat3 frame, vec3 view, vec3 diffuse, vec3 specular, float e,
                     vec3 transmitted, bool shadowed, mat3 other) {
    vec3 local = view * frame;
    local = normalize(vec3(local.xy, max(local.z, $LOWEST)));
    vec3 sum = vec3(0.0);
    for (int term = 0; term < 3; ++term) {  // one body: less to compile
        vec3 weight = term == 0 ? diffuse : term == 1 ? specular : transmitted;
        if (weight == vec3(0.0)) continue;
        if (term == 2 && !shadowed) {
            sum += weight * unshadowed_radiance(-frame[2], 1.0);
            continue;
        }
        mat3 own = frame;
        if (term == 2) own = other;
        vec3 a = term == 1 ? vec3(-local.xy, local.z) : vec3(0.0, 0.0, 1.0);
        sum += weight * lobe_radiance(behind != (term == 2), own, a, term == 1 ? e : 1.0);
    }
    return sum;
}
"""


def one_dimensional_glsl(order: int, count: int) -> str:
    """The include.

    Args:
        order: bands n of light and visibility.
        count: lobes c of each vertex's visibility.
    """
    words = {
        "$PHONG": phong_glsl(order),
        "$SEEN": str(count),
        "$COLUMNS": str(lobe_columns(order, count)),
        "$LOBES": str(most_lobes(order)),
        "$LOWEST": f"{LOWEST:e}",
        "$SPHERE": f"{1.0 / (4.0 * math.pi):.9e}",
    }
    text = GLSL
    for word, value in words.items():
        text = text.replace(word, value)
    return text


def lobe_columns(order: int, count: int) -> int:
    """Vertices in a row of a texture of lobes."""
    return WIDTH // (count * texels_of(order))


def texels_of(order: int) -> int:
    """Texels of one lobe."""
    return (order + 6) // 4


def lobe_texels(lobes: Lobes) -> FloatArray:
    """Lobes of vertices as a texture: (rows, texels, 4) float32, whole vertices a row.

    Args:
        lobes: axes (V, c, 3), coefficients (V, c, n).
    """
    vertices, count, order = lobes.coefficients.shape
    columns = lobe_columns(order, count)
    data = np.zeros((max(1, -(-vertices // columns)) * columns, count, 4 * texels_of(order)), "f4")
    data[:vertices, :, :3] = lobes.axes
    data[:vertices, :, 3 : 3 + order] = lobes.coefficients
    return data.reshape(-1, columns * count * texels_of(order), 4)


def phong_glsl(order: int) -> str:
    """``void phong(float e, float v[n²], out float t[n²])`` and ``phong_zonal(e, out float k[n])``.

    As ``prtnet.phong.phong_transfer`` and ``phong_zonal``. Only distinct entries are computed, only
    those that are not zero are used.
    """
    transfer = []
    for block in blocks(order):
        transfer += [*integral_lines(block.m, len(block.weights)), *entry_lines(block)]
    zonal = [*integral_lines(0, order), *(f"k[{band}] = i{band};" for band in range(order))]
    return (
        function("phong(float e, float v[COEFFICIENTS], out float t[COEFFICIENTS])", transfer)
        + function("phong_zonal(float e, out float k[ORDER])", zonal)
    )  # fmt: skip


def function(head: str, lines: list[str]) -> str:
    """A GLSL function without a result."""
    body = "\n".join(f"    {line}" for line in lines)
    return f"void {head} {{\n{body}\n}}\n\n"


def integral_lines(m: int, count: int) -> list[str]:
    """``iL`` of one m for L < count, after those of the m before: ``prtnet.phong.integrals``."""
    if m == 0:
        lines = ["float first = 1.0;", "float second = (e + 1.0) / (e + 2.0);"]
        lines += [f"float i{degree};" for degree in range(max(2, count))]
    else:
        lines = [f"first *= {2 * m}.0 / (e + {2 * m + 1}.0);"]
        lines += [f"second *= {2 * m}.0 / (e + {2 * m + 2}.0);"]
    lines += ["i0 = first;", "i1 = second;"]
    for degree in range(count - 2):
        ratio = f"(e - {degree}.0) / (e + {degree + 2 * m + 3}.0)"
        lines.append(f"i{degree + 2} = i{degree} * ({ratio});")
    return lines


def entry_lines(block: Block) -> list[str]:
    """The distinct entries of one m, and the products of both signs."""
    lines = []
    for column, weights in enumerate(block.weights.T):
        terms = [f"{w:.9e} * i{degree}" for degree, w in enumerate(weights) if w > 0.0]
        lines.append(f"float m{block.m}_{column} = {' + '.join(terms)};")
    for index in block.indices:
        for row, target in enumerate(index):
            products = [
                f"m{block.m}_{column} * v[{source}]"
                for column, source in zip(block.place[row], index, strict=True)
            ]
            lines.append(f"t[{target}] = {' + '.join(products)};")
    return lines
