"""Pieces of GLSL, and arrays as textures: what every shader of this project is made of.

GLSL 3.30 and GLSL ES 3.00 (WebGL 2): textures are read texel by texel, in rows of ``WIDTH``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.sh import polynomial

__all__ = [
    "CONCENTRIC",
    "FORMATS",
    "WIDTH",
    "filled",
    "harmonics_glsl",
    "texel_format",
    "texture",
    "vectors",
]

WIDTH = 2048  # texels in a row of a texture; every WebGL 2 device has at least this

FORMATS = {
    "int8": "RGBA8_SNORM",
    "float16": "RGBA16F",
    "float32": "RGBA32F",
    "uint16": "RGBA16UI",
    "uint32": "RGBA32UI",
}
"""Of OpenGL, by the type of the numbers; those of two or one a texel begin with RG or R."""

CONCENTRIC = """// The concentric map of the square [0, 1]^2 at a direction above the horizon.
vec2 on_square(vec3 d) {
    const float PI = 3.14159265358979;
    float radius = sqrt(clamp(1.0 - d.z, 0.0, 1.0));
    float angle = abs(d.x) + abs(d.y) > 0.0 ? atan(d.y, d.x) : 0.0;
    if (angle < -0.25 * PI) angle += 2.0 * PI;
    float quarter = floor((angle + 0.25 * PI) / (0.5 * PI));
    float off = (angle - quarter * 0.5 * PI) * (4.0 / PI) * radius;
    int side = int(quarter) % 4;
    vec2 place = side == 0 ? vec2(radius, off) : side == 1 ? vec2(-off, radius)
               : side == 2 ? vec2(-radius, -off) : vec2(off, -radius);
    return 0.5 * place + 0.5;
}
"""
"""``prtnet.hemisphere.places``, as texture coordinates."""


def texel_format(array: Any) -> str:
    """OpenGL's name of the format of a texture (height, width, channels)."""
    return FORMATS[array.dtype.name].replace("RGBA", "RGBA"[: array.shape[2]])


def texture(texels: Any) -> Any:
    """Texels (N, channels) as whole rows (height, WIDTH, channels), zeros behind; at least one."""
    count, channels = texels.shape
    whole = np.zeros((max(1, -(-count // WIDTH)) * WIDTH, channels), dtype=texels.dtype)
    whole[:count] = texels
    return whole.reshape(-1, WIDTH, channels)


def filled(text: str, words: Mapping[str, object]) -> str:
    """A text whose ``$WORD`` s are what the mapping says; no word begins like a later one."""
    for word, value in words.items():
        text = text.replace(f"${word}", str(value))
    return text


def vectors(values: FloatArray, texels: int) -> str:
    """Numbers as GLSL vec4s, padded with zeros, as exact as float32."""
    padded = np.zeros(4 * texels, dtype=np.float32)
    padded[: len(values)] = values
    return ", ".join(
        "vec4(" + ", ".join(f"{float(value):.9e}" for value in four) + ")"
        for four in padded.reshape(-1, 4)
    )


def harmonics_glsl(order: int, name: str = "harmonics") -> str:
    """``void harmonics(vec3 d, out float y[n²])``: the basis at a unit direction."""
    lines = ["float zz = d.z * d.z;"]
    for m in range(1, order):  # Re and Im of (x + iy)^m
        if m == 1:
            lines += ["float c1 = d.x;", "float s1 = d.y;"]
        else:
            lines.append(f"float c{m} = d.x * c{m - 1} - d.y * s{m - 1};")
            lines.append(f"float s{m} = d.x * s{m - 1} + d.y * c{m - 1};")
    for band in range(order):
        centre = band * band + band
        for m in range(band + 1):
            first, *others = polynomial(band, m)
            value = f"{first:.9e}"
            for other in others:
                value = f"({value} * zz + {other:.9e})"
            if (band - m) % 2:
                value += " * d.z"
            if m == 0:
                lines.append(f"y[{centre}] = {value};")
                continue
            lines.append(f"float q{band}{m} = {value};")
            lines.append(f"y[{centre + m}] = q{band}{m} * c{m};")
            lines.append(f"y[{centre - m}] = q{band}{m} * s{m};")
    body = "\n".join(f"    {line.replace('float', 'highp float')}" for line in lines)
    head = f"void {name}(highp vec3 d, out highp float y[{order**2}])"
    return f"{head} {{\n{body}\n}}\n"
