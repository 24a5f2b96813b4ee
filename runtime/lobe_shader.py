"""GLSL of fields of lobes: 3.30, nothing beyond WebGL 2's reach; what runtime.lobe_shading does.

A patch is shaded pixel by pixel: its lobes are an array of textures, filtered where they may be
interpolated. A mesh is shaded vertex by vertex: its lobes are one texture, whole vertices a row.
Either looks lobes up in a table of the light, or evaluates them.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.glsl import CONCENTRIC, WIDTH, filled, harmonics_glsl
from prtnet.lobe_field import LobeField
from prtnet.reflection import LOWEST
from prtnet.zh import bands_apart
from runtime.lobe_shading import TABLE

__all__ = ["lobe_layers", "mesh_shaders", "patch_shaders", "point_texels", "vertex_texture"]

HEAD = """#version $VERSION
const int ORDER = $ORDER;
const int COEFFICIENTS = ORDER * ORDER;
const int FIRST = $FIRST;  // band of the lobes
const int ROWS = $ROWS;
const int LOBES = $LOBES;  // of a row
uniform int rows;  // as many again: loops that compilers do not unroll are compiled much faster
uniform int lobes;
const int TEXELS = $TEXELS;  // of a lobe: its axis, then its coefficients
uniform highp vec3 light[$LIGHT];
uniform highp sampler2DArray table;  // a layer a band, of light over table_scale
uniform highp float table_scale;
uniform highp sampler2DArray view_factors;  // a layer a row
uniform highp vec3 eye;

$HARMONICS
vec3 band_light(int l, vec2 place) { return textureLod(table, vec3(place, float(l)), 0.0).rgb; }
"""

# Of any point. Before it: vec4 low_of(int row), vec4 lobe_of(int texel).
SHADE = """
vec3 lobe_light(vec3 axis, float g[ORDER]) {
    vec3 sum = vec3(0.0);
#ifdef BY_TABLE
    vec2 place = vec2(atan(axis.y, axis.x) * $TURN,
                      (acos(clamp(axis.z, -1.0, 1.0)) * $STEPS + 0.5) * $ROW);
    for (int l = FIRST; l < ORDER; ++l) sum += g[l] * band_light(l, place);
    return table_scale * sum;
#else
    float y[COEFFICIENTS];
    harmonics(axis, y);
    for (int l = FIRST; l < ORDER; ++l) {
        vec3 band = vec3(0.0);
        for (int i = l * l; i < (l + 1) * (l + 1); ++i) band += y[i] * light[i];
        sum += g[l] * band;
    }
    return sum;
#endif
}

vec3 row_light(int row, mat3 frame) {
    vec4 low = low_of(row);
    vec3 linear = frame * vec3(-low.w, -low.y, low.z);
    vec3 sum = low.x * light[0] - linear.x * light[3] - linear.y * light[1] + linear.z * light[2];
    float lobe[4 * TEXELS];
    float g[ORDER];
    for (int k = 0; k < lobes; ++k) {
        for (int j = 0; j < TEXELS; ++j) {
            vec4 texel = lobe_of((row * LOBES + k) * TEXELS + j);
            lobe[4 * j] = texel.x;
            lobe[4 * j + 1] = texel.y;
            lobe[4 * j + 2] = texel.z;
            lobe[4 * j + 3] = texel.w;
        }
        for (int l = FIRST; l < ORDER; ++l) g[l] = lobe[3 + l - FIRST];
        vec3 axis = vec3(lobe[0], lobe[1], lobe[2]);
        axis /= max(length(axis), 1e-6);
        sum += lobe_light(frame * axis, g);
    }
    return sum;
}

$CONCENTRIC
// local: towards the eye, in the frame of the relief's normal.
vec3 shade(mat3 frame, vec3 local) {
#ifdef GLOSSY
    vec2 place = on_square(normalize(vec3(local.xy, max(local.z, $LOWEST))));
    vec3 sum = vec3(0.0);
    for (int row = 0; row < rows; ++row)
        sum += textureLod(view_factors, vec3(place, float(row)), 0.0).rgb * row_light(row, frame);
    return sum;
#else
    return row_light(0, frame);
#endif
}
"""

PATCH_VERTEX = """#version $VERSION
uniform mat4 view_projection;
in vec3 position;
in vec3 tangent;
in vec3 normal;
in vec2 place;
out vec3 at_position;
out vec3 at_tangent;
out vec3 at_normal;
out vec2 at_place;

void main() {
    at_position = position;
    at_tangent = tangent;
    at_normal = normal;
    at_place = place;
    gl_Position = view_projection * vec4(position, 1.0);
}
"""

PATCH_READS = """
uniform highp sampler2DArray low_map;
uniform highp sampler2DArray lobe_map;
uniform highp sampler2D normal_map;
in vec3 at_position;
in vec3 at_tangent;
in vec3 at_normal;
in vec2 at_place;
out vec4 colour;

vec4 low_of(int row) { return textureLod(low_map, vec3(at_place, float(row)), 0.0); }
vec4 lobe_of(int texel) { return textureLod(lobe_map, vec3(at_place, float(texel)), 0.0); }
"""

PATCH_MAIN = """
void main() {
    vec3 n = normalize(at_normal);
    vec3 t = normalize(at_tangent - dot(at_tangent, n) * n);
    // The back bulges as the front does: in a mirror.
    mat3 frame = mat3(t, cross(n, t), gl_FrontFacing ? n : -n);
    vec3 local = vec3(0.0);
#ifdef GLOSSY
    vec3 view = normalize(eye - at_position) * frame;
    vec3 up = normalize(textureLod(normal_map, at_place, 0.0).xyz);
    vec3 along = normalize(vec3(1.0, 0.0, 0.0) - up.x * up);
    local = view * mat3(along, cross(up, along), up);
#endif
    colour = vec4(shade(frame, local), 1.0);
}
"""

MESH_READS = """
const int POINT = ROWS * (1 + LOBES * TEXELS);  // texels of a vertex
uniform highp sampler2D points;
uniform mat4 view_projection;
in vec3 position;
in vec3 tangent;
in vec3 normal;
out vec3 radiance;

vec4 texel_of(int k) {
    int column = gl_VertexID % $COLUMNS;
    return texelFetch(points, ivec2(column * POINT + k, gl_VertexID / $COLUMNS), 0);
}
vec4 low_of(int row) { return texel_of(row); }
vec4 lobe_of(int texel) { return texel_of(ROWS + texel); }
"""

MESH_MAIN = """
void main() {
    vec3 n = normalize(normal);
    vec3 t = normalize(tangent - dot(tangent, n) * n);
    mat3 frame = mat3(t, cross(n, t), n);
    radiance = shade(frame, normalize(eye - position) * frame);
    gl_Position = view_projection * vec4(position, 1.0);
}
"""

MESH_FRAGMENT = """#version $VERSION
in vec3 radiance;
out vec4 colour;
void main() { colour = vec4(radiance, 1.0); }
"""


def patch_shaders(field: LobeField, by_table: bool, version: str = "330") -> tuple[str, str]:
    """Vertex and fragment shader of a patch on a mesh.

    Args:
        field: its order, rows, lobes and whether it is glossy are built in.
        by_table: lobes are looked up in the light's table.
        version: of GLSL, and the default precisions where it asks for them.
    """
    words = words_of(field, by_table, version)
    fragment = HEAD + PATCH_READS + SHADE + PATCH_MAIN
    return filled(PATCH_VERTEX, words), filled(fragment, words)


def mesh_shaders(field: LobeField, by_table: bool, version: str = "330") -> tuple[str, str]:
    """Vertex and fragment shader of a mesh with lobes at its vertices; see ``patch_shaders``."""
    words = words_of(field, by_table, version)
    return filled(HEAD + MESH_READS + SHADE + MESH_MAIN, words), filled(MESH_FRAGMENT, words)


def words_of(field: LobeField, by_table: bool, version: str) -> dict[str, object]:
    """What is built into shaders."""
    defines = "#define BY_TABLE\n" * by_table + "#define GLOSSY\n" * (field.view is not None)
    return {
        "VERSION": f"{version}\n{defines}",
        "ORDER": field.order,
        "FIRST": bands_apart(field.count),
        "ROWS": field.rows,
        "ROW": f"{1.0 / TABLE[1]:.9e}",
        "LOBES": field.count,
        "TEXELS": texels_of(field),
        "LIGHT": max(4, 4 if by_table else field.order**2),
        "HARMONICS": "" if by_table else harmonics_glsl(field.order),
        "TURN": f"{0.5 / math.pi:.9e}",
        "STEPS": f"{(TABLE[1] - 1) / math.pi:.9e}",
        "CONCENTRIC": CONCENTRIC,
        "LOWEST": f"{LOWEST:e}",
        "COLUMNS": columns_of(field),
    }


def texels_of(field: LobeField) -> int:
    """Texels of a lobe."""
    return -(-(3 + max(field.order - bands_apart(field.count), 0)) // 4)


def columns_of(field: LobeField) -> int:
    """Vertices in a row of a texture.

    Raises:
        PrtnetError: not even one fits.
    """
    columns = WIDTH // (field.rows * (1 + field.count * texels_of(field)))
    if columns == 0:
        what = f"{field.rows} rows of {field.count} lobes are too many for a texture"
        raise PrtnetError("--renderer gl", f"{what}; use --renderer cpu")
    return columns


def point_texels(field: LobeField) -> FloatArray:
    """What a shader reads of every point: the low bands of its rows, then their lobes.

    Returns:
        (K, R (1 + N T), 4) float16, T texels a lobe.
    """
    count, rows, texels = len(field), field.rows, texels_of(field)
    result = np.zeros((count, rows * (1 + field.count * texels), 4), dtype=np.float16)
    result[:, :rows] = field.low
    lobes = np.zeros((count, rows, field.count, 4 * texels), dtype=np.float16)
    lobes[..., :3] = field.axes
    used = field.coefficients[..., bands_apart(field.count) :]
    lobes[..., 3 : 3 + used.shape[-1]] = used
    result[:, rows:] = lobes.reshape(count, -1, 4)
    return result


def lobe_layers(field: LobeField, size: tuple[int, int]) -> tuple[FloatArray, FloatArray]:
    """The low bands (R, H, W, 4) and lobes (R N T, H, W, 4) of a patch as layers of textures.

    Args:
        field: of a patch.
        size: texels along x and y, W and H.
    """
    layers = np.moveaxis(point_texels(field), 1, 0).reshape(-1, size[1], size[0], 4)
    return layers[: field.rows], layers[field.rows :]


def vertex_texture(field: LobeField) -> FloatArray:
    """Lobes of vertices, (rows, texels, 4) float16, whole vertices a row."""
    texels = point_texels(field)
    columns = columns_of(field)
    whole = np.zeros((max(1, -(-len(texels) // columns)) * columns, *texels.shape[1:]), np.float16)
    whole[: len(texels)] = texels
    return whole.reshape(-1, columns * texels.shape[1], 4)
