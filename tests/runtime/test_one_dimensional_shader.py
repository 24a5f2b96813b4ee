"""The GLSL of 1D BRDFs against NumPy, vertex by vertex: transform feedback, no picture."""

from __future__ import annotations

import contextlib
import dataclasses

import moderngl
import numpy as np
import pytest

from prtnet.axis_frames import frame_about
from prtnet.glsl import harmonics_glsl
from prtnet.one_dimensional import OneDimensional
from prtnet.phong import phong_transfer, phong_zonal
from prtnet.zh import Lobes, exact_lobes
from runtime.material_shader import most_lobes
from runtime.one_dimensional import (
    LobeSide,
    above_horizon,
    one_dimensional_radiance,
)
from runtime.one_dimensional_shader import (
    lobe_columns,
    lobe_texels,
    one_dimensional_glsl,
    phong_glsl,
)
from tests.runtime.lobes import random_light, random_lobes, random_side
from tests.runtime.scenes import sky

pytestmark = pytest.mark.gl

EYE = np.array([3.0, 1.0, 0.5])
EXPONENTS = (0.0, 0.5, 1.0, 7.3, 1e3, 1e5, 1e30)

VERSIONS = ("330", "300 es\nprecision highp float;")
HEAD = """#version $VERSION
const int ORDER = $ORDER;
const int COEFFICIENTS = ORDER * ORDER;
"""

# A vertex for each number that comes out: drivers give back few of one vertex.
OPERATOR = """
uniform highp sampler2D given;  // a row for each case: its exponent, its vector
out float value;

void main() {
    const int numbers = COEFFICIENTS + ORDER;
    int row = gl_VertexID / numbers;
    int which = gl_VertexID % numbers;
    float v[COEFFICIENTS];
    float t[COEFFICIENTS];
    float k[ORDER];
    for (int i = 0; i < COEFFICIENTS; ++i) v[i] = texelFetch(given, ivec2(1 + i, row), 0).r;
    float e = texelFetch(given, ivec2(0, row), 0).r;
    phong(e, v, t);
    phong_zonal(e, k);
    value = which < COEFFICIENTS ? t[which] : k[which - COEFFICIENTS];
}
"""

LIGHT = """
uniform int lobes;
uniform vec3 axis[3 * $LOBES];
uniform float zonal[3 * $LOBES * ORDER];
"""

SHADED = """
uniform vec3 eye;
uniform vec3 diffuse;
uniform vec3 specular;
uniform vec3 transmitted;
uniform bool shadowed;
in float exponent;
in vec3 position;
in mat3 frame;
in mat3 other;
out vec3 radiance;

void main() {
    vec3 view = normalize(eye - position);
    radiance = one_dimensional(
        false, frame, view, diffuse, specular, exponent, transmitted, shadowed, other);
}
"""


def texture(context: moderngl.Context, array: np.ndarray, held: contextlib.ExitStack, unit: int):
    """Of (height, width, components), bound."""
    made = context.texture(array.shape[1::-1], array.shape[2], array.astype("f4"), dtype="f4")
    held.callback(made.release)
    made.filter = (moderngl.NEAREST, moderngl.NEAREST)
    made.use(unit)


def applied(
    context: moderngl.Context, exponents: np.ndarray, vectors: np.ndarray, version: str
) -> np.ndarray:
    """What the shader makes of exponents (C,) and vectors (C, n²): (C, n² + n)."""
    order = round(vectors.shape[1] ** 0.5)
    count = len(exponents) * (order**2 + order)
    head = HEAD.replace("$ORDER", str(order)).replace("$VERSION", version)
    with contextlib.ExitStack() as held:
        program = context.program(
            vertex_shader=head + phong_glsl(order) + OPERATOR, varyings=["value"]
        )
        held.callback(program.release)
        rows = np.concatenate([exponents[:, None], vectors], axis=1)
        texture(context, rows[..., None], held, 0)
        result = context.buffer(reserve=4 * count)
        held.callback(result.release)
        mesh = context.vertex_array(program, [])
        held.callback(mesh.release)
        mesh.transform(result, moderngl.POINTS, vertices=count)
        return np.frombuffer(result.read(), "f4").reshape(len(exponents), -1)


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6, 8])
def test_the_operator_is_numpys(context, order, version):
    rng = np.random.default_rng(order)
    exponents = np.repeat(EXPONENTS, 9).astype("f4").astype(np.float64)
    vectors = rng.normal(size=(len(exponents), order**2)).astype("f4").astype(np.float64)
    got = applied(context, exponents, vectors, version)
    np.testing.assert_allclose(
        got[:, : order**2], phong_transfer(exponents, vectors), atol=2e-6 * order
    )
    np.testing.assert_allclose(got[:, order**2 :], phong_zonal(exponents, order), atol=1e-6)


@pytest.mark.parametrize("order", [2, 4, 6])
def test_small_entries_keep_their_digits(context, order):
    """Those of m > 0, under a steep lobe, seen one by one."""
    vectors = np.eye(order**2)
    exponents = np.full(order**2, 300.0)
    got = applied(context, exponents, vectors, VERSIONS[0])[:, : order**2]
    expected = phong_transfer(exponents, vectors)
    assert 0 < np.abs(expected[expected != 0]).min() < 1e-2
    np.testing.assert_allclose(got, expected, rtol=3e-6, atol=1e-35)


def shaded(
    context: moderngl.Context,
    positions: np.ndarray,
    sides: tuple[LobeSide, LobeSide],
    light: Lobes,
    material: OneDimensional,
    shadowed: bool,
    exponents: np.ndarray,
    version: str = VERSIONS[0],
) -> np.ndarray:
    """Radiance of vertices, (V, 3); each with an exponent of its own."""
    _, count, order = sides[0].visibility.coefficients.shape
    most = most_lobes(order)
    words = {"$ORDER": str(order), "$LOBES": str(most), "$VERSION": version}
    source = HEAD + LIGHT + harmonics_glsl(order) + one_dimensional_glsl(order, count) + SHADED
    for word, value in words.items():
        source = source.replace(word, value)
    axes, zonal = np.zeros((3, most, 3), "f4"), np.zeros((3, most, order), "f4")
    lobes = light.axes.shape[1]
    axes[:, :lobes], zonal[:, :lobes] = light.axes, light.coefficients
    uniforms = {
        "lobes": np.int32(lobes), "axis": axes, "zonal": zonal, "eye": EYE.astype("f4"),
        "shadowed": np.int32(shadowed), "front_lobes": np.int32(0), "back_lobes": np.int32(1),
    }  # fmt: skip
    for name in ("diffuse", "specular", "transmitted"):
        uniforms[name] = np.broadcast_to(getattr(material, name), 3).astype("f4")
    attributes = {
        "exponent": (exponents, "1f"), "position": (positions, "3f"),
        **{name: (side.frames.swapaxes(1, 2), "9f") for name, side in zip(
            ("frame", "other"), sides, strict=True)},
    }  # fmt: skip
    with contextlib.ExitStack() as held:
        program = context.program(vertex_shader=source, varyings=["radiance"])
        held.callback(program.release)
        for name, value in uniforms.items():
            if name in program:
                program[name].write(np.ascontiguousarray(value))
        for unit, side in enumerate(sides):
            texture(context, lobe_texels(side.visibility), held, unit)
        layout = []
        for name, (data, form) in attributes.items():
            if name in program:
                buffer = context.buffer(np.ascontiguousarray(data, dtype="f4"))
                held.callback(buffer.release)
                layout.append((buffer, form, name))
        result = context.buffer(reserve=12 * len(positions))
        held.callback(result.release)
        mesh = context.vertex_array(program, layout)
        held.callback(mesh.release)
        mesh.transform(result, moderngl.POINTS, vertices=len(positions))
        return np.frombuffer(result.read(), "f4").reshape(-1, 3)


def scene(order: int, count: int, lobes: int = 3) -> tuple[np.ndarray, tuple[LobeSide, LobeSide]]:
    front = random_side(count, order, lobes=lobes)
    back = LobeSide(random_lobes((count, lobes), order, 5), front.frames * [1.0, -1.0, -1.0])
    return np.random.default_rng(1).normal(size=(count, 3)), (front, back)


def expected_of(positions, sides, light, material, shadowed, exponents) -> np.ndarray:
    parts = np.empty((len(positions), 3))
    for exponent in np.unique(exponents):
        own = np.flatnonzero(exponents == exponent)
        front, back = (
            LobeSide(
                Lobes(side.visibility.axes[own], side.visibility.coefficients[own]),
                side.frames[own],
            )
            for side in sides
        )
        single = dataclasses.replace(material, exponent=float(exponent))
        parts[own] = one_dimensional_radiance(
            positions[own], front, EYE, light, single, back if shadowed else None
        )
    return parts


MIXED = OneDimensional((0.1, 0.2, 0.3), (0.5, 0.4, 0.3), 7.3, (0.2, 0.1, 0.4))
SINGLE = {
    "diffuse": OneDimensional(0.8, 0.0, 1.0, 0.0),
    "specular": OneDimensional(0.0, (0.7, 0.5, 0.9), 1.0, 0.0),
    "transmitted": OneDimensional(0.0, 0.0, 1.0, (0.3, 0.2, 0.7)),
    "mixed": MIXED,
}


@pytest.mark.parametrize("shadowed", [False, True])
@pytest.mark.parametrize("name", SINGLE)
@pytest.mark.parametrize(
    ("order", "version"), [*((order, VERSIONS[0]) for order in (1, 2, 4, 6)), (4, VERSIONS[1])]
)
def test_the_shader_does_what_numpy_does(context, order, version, name, shadowed):
    positions, sides = scene(order, 60)
    light = random_light(order)
    exponents = np.resize(np.array(EXPONENTS, dtype="f4"), 60)
    given = (positions, sides, light, SINGLE[name], shadowed, exponents)
    expected = expected_of(*given)
    assert np.abs(expected).max() > 1e-4
    got = shaded(context, *given, version)
    np.testing.assert_allclose(got, expected, atol=2e-5 * np.abs(expected).max())


def test_many_vertices_fill_several_rows(context):
    order, lobes = 4, 4
    count = 2 * lobe_columns(order, lobes) + 17
    positions, sides = scene(order, count, lobes)
    sides = (LobeSide(above_horizon(sides[0].visibility), sides[0].frames),
             LobeSide(above_horizon(sides[1].visibility), sides[1].frames))  # fmt: skip
    light = exact_lobes(sky(order).T)  # colours share their axes
    given = (positions, sides, light, MIXED, True, np.full(count, 12.5))
    expected = expected_of(*given)
    assert len(lobe_texels(sides[0].visibility)) > 1
    np.testing.assert_allclose(
        shaded(context, *given), expected, atol=2e-5 * np.abs(expected).max()
    )


def test_frames_around_any_axis(context):
    axes = random_lobes((40, 3), 1, 0).axes.reshape(-1, 3)
    step = np.array([0.0, 1e-30, 1e-6, 1e-3])
    beside = np.stack([0.6 * step, -0.8 * step, np.sqrt(1.0 - step**2)], axis=1)
    axes = np.concatenate([axes, beside, beside * [1.0, 1.0, -1.0]])
    source = HEAD.replace("$ORDER", "4").replace("$VERSION", VERSIONS[0]) + LIGHT.replace(
        "$LOBES", str(most_lobes(4))
    )
    source += harmonics_glsl(4) + one_dimensional_glsl(4, 1)
    source += "in vec3 given;\nout mat3 frame;\nvoid main() { frame = frame_about(given); }\n"
    with contextlib.ExitStack() as held:
        program = context.program(vertex_shader=source, varyings=["frame"])
        held.callback(program.release)
        buffer = context.buffer(axes.astype("f4"))
        held.callback(buffer.release)
        mesh = context.vertex_array(program, [(buffer, "3f", "given")])
        held.callback(mesh.release)
        result = context.buffer(reserve=36 * len(axes))
        held.callback(result.release)
        mesh.transform(result, moderngl.POINTS, vertices=len(axes))
        columns = np.frombuffer(result.read(), "f4").reshape(-1, 3, 3)
    frames = columns.swapaxes(1, 2)
    gram = columns @ frames
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=1e-6)
    near = np.hypot(axes[:, 0], axes[:, 1]) < 1e-19  # 32 bits know no side of the pole there
    far = ~near | (axes[:, 2] > 0.0)
    np.testing.assert_allclose(frames[far], frame_about(axes)[far], atol=1e-6)
    np.testing.assert_allclose(frames[..., 2], axes, atol=1e-6)
