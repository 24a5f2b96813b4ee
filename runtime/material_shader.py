"""The vertex shader of any material: GLSL 3.30, nothing beyond WebGL 2's reach.

One source for every BRDF: an operator is a texture of numbers. Lobes of light are turned into the
vertex's frame by turning their axes. Visibility comes from a texture, four coefficients a texel, or
is rebuilt from a model's latents by the GLSL that is exported for engines. Spherical harmonics are
written out for the order, from the constants of :mod:`prtnet.sh`.
"""

from __future__ import annotations

from prtnet.glsl import filled, harmonics_glsl
from prtnet.gpu_tables import GPUTables, glsl
from prtnet.limits import MOST_LIGHT_LOBES
from prtnet.reflection import LOWEST

__all__ = ["FRAGMENT_SHADER", "most_lobes", "vertex_shader"]

VERTEX_SHADER = """#version 330
const int COEFFICIENTS = $COEFFICIENTS;
const int ORDER = $ORDER;
const int TEXELS = (COEFFICIENTS + 3) / 4;

uniform mat4 view_projection;
uniform vec3 eye;
uniform int lobes;
uniform vec3 axis[3 * $LOBES];  // of a colour's lobes, one colour after the other
uniform float zonal[3 * $LOBES * ORDER];  // of each, by bands
uniform int bands;  // of light and visibility that are shown
uniform bool two_sided;
uniform int factors;
uniform int view_coefficients;
uniform highp sampler2D matrices;  // M^b: a row of texels for each row of each factor
uniform highp sampler2D view_factors;  // w^b: a texel for each coefficient, a row for each factor

in vec3 position;
in vec3 front_tangent;
in vec3 front_normal;
in vec3 back_tangent;
in vec3 back_normal;
out vec3 front;
out vec3 back;

$HARMONICS
$VISIBILITY
vec3 radiance(bool behind, vec3 tangent, vec3 normal) {
    mat3 frame = mat3(tangent, cross(normal, tangent), normal);
    float light[3 * COEFFICIENTS];
    float y[COEFFICIENTS];
    for (int c = 0; c < 3; ++c) {
        for (int i = 0; i < COEFFICIENTS; ++i) light[c * COEFFICIENTS + i] = 0.0;
        for (int k = 0; k < lobes; ++k) {
            int lobe = c * $LOBES + k;
            harmonics(axis[lobe] * frame, y);
            for (int l = 0; l < ORDER; ++l) {
                if (l >= bands) break;
                float g = zonal[lobe * ORDER + l];
                for (int i = l * l; i < (l + 1) * (l + 1); ++i)
                    light[c * COEFFICIENTS + i] += g * y[i];
            }
        }
    }
    vec4 v[TEXELS];
    visibility(behind, v);
    if (bands < ORDER)
        for (int i = bands * bands; i < 4 * TEXELS; ++i) v[i / 4][i % 4] = 0.0;
    vec3 view = normalize(eye - position) * frame;
    view = normalize(vec3(view.xy, max(view.z, $LOWEST)));
    harmonics(view, y);
    vec3 sum = vec3(0.0);
    for (int b = 0; b < factors; ++b) {
        vec3 lit = vec3(0.0);
        for (int i = 0; i < COEFFICIENTS; ++i) {
            if (i >= bands * bands) break;
            float product = 0.0;
            for (int k = 0; k < TEXELS; ++k)
                product += dot(texelFetch(matrices, ivec2(k, b * COEFFICIENTS + i), 0), v[k]);
            lit += product * vec3(light[i], light[COEFFICIENTS + i], light[2 * COEFFICIENTS + i]);
        }
        vec3 seen = vec3(0.0);
        for (int i = 0; i < view_coefficients; ++i)
            seen += y[i] * texelFetch(view_factors, ivec2(i, b), 0).rgb;
        sum += seen * lit;
    }
    return sum;
}

void main() {
    front = radiance(false, front_tangent, front_normal);
    back = two_sided ? radiance(true, back_tangent, back_normal) : front;
    gl_Position = view_projection * vec4(position, 1.0);
}
"""

GIVEN = """
const int COLUMNS = $COLUMNS;  // vertices in a row of a texture of visibility
uniform highp sampler2D front_visibility;
uniform highp sampler2D back_visibility;

void visibility(bool behind, out vec4 v[TEXELS]) {
    ivec2 first = ivec2((gl_VertexID % COLUMNS) * TEXELS, gl_VertexID / COLUMNS);
    for (int k = 0; k < TEXELS; ++k) {
        ivec2 place = first + ivec2(k, 0);
        v[k] = behind ? texelFetch(back_visibility, place, 0)
                      : texelFetch(front_visibility, place, 0);
    }
}
"""

REBUILT = """
in int front_receiver;
in int back_receiver;

void visibility(bool behind, out vec4 v[TEXELS]) {
    prtnet_visibility(behind ? back_receiver : front_receiver, v);
}
"""

FRAGMENT_SHADER = """#version 330
in vec3 front;
in vec3 back;
out vec4 colour;

void main() {
    colour = vec4(gl_FrontFacing ? front : back, 1.0);
}
"""


def vertex_shader(order: int, columns: int, tables: GPUTables | None = None) -> str:
    """The shader for visibility of an order.

    Args:
        order: bands n.
        columns: vertices in a row of the textures of visibility.
        tables: of a model, to rebuild visibility from its latents.
    """
    words = {
        "VISIBILITY": GIVEN if tables is None else glsl(tables) + REBUILT,
        "COEFFICIENTS": order**2,
        "ORDER": order,
        "COLUMNS": columns,
        "LOBES": most_lobes(order),
        "LOWEST": f"{LOWEST:e}",
        "HARMONICS": harmonics_glsl(order),
    }
    return filled(VERTEX_SHADER, words)


def most_lobes(order: int) -> int:
    """Of each colour: as many as hold any light of the order, or more."""
    return max(MOST_LIGHT_LOBES, 2 * order - 1)
