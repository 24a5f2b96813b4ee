"""What a GPU needs to rebuild visibility from latents: textures, and GLSL that reads them.

Every receiver's numbers lie together in one texture: its mean, then its row of each component of
its group, four coefficients a texel. A scale that a whole component shares is left to the latents,
so that a texel is used as it is.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.model import VisibilityModel
from prtnet.storage import MOST

__all__ = [
    "COUNT_BITS",
    "FORMATS",
    "WIDTH",
    "GPUTables",
    "glsl",
    "gpu_tables",
    "write_gpu_tables",
]

WIDTH = 2048  # texels in a row of a texture; every WebGL 2 device has at least this
COUNT_BITS = 12  # of a receiver's second number: its latents, below them where they begin

FORMATS = {"int4": "RGBA8_SNORM", "int8": "RGBA8_SNORM", "float16": "RGBA16F", "float32": "RGBA32F"}

GLSL = """\
// Visibility of a receiver from a pose's latents: GLSL 3.30 and GLSL ES 3.00 (WebGL 2).
// Made by prtnet; README.md beside this file says what the textures hold.

uniform highp sampler2D prtnet_rows;
uniform highp usampler2D prtnet_receivers;
uniform highp sampler2D prtnet_latents;

const highp int PRTNET_WIDTH = $WIDTH;  // texels in a row of a texture
const highp int PRTNET_TEXELS = $TEXELS;  // of one receiver's $COEFFICIENTS coefficients
const highp vec4 PRTNET_MEAN_SCALE[PRTNET_TEXELS] = vec4[PRTNET_TEXELS]($SCALE);
const highp vec4 PRTNET_MEAN_OFFSET[PRTNET_TEXELS] = vec4[PRTNET_TEXELS]($OFFSET);
const highp vec4 PRTNET_PROFILE[PRTNET_TEXELS] = vec4[PRTNET_TEXELS]($PROFILE);

highp ivec2 prtnet_place(highp int index) {
    return ivec2(index % PRTNET_WIDTH, index / PRTNET_WIDTH);
}

// Coefficient i is v[i / 4][i % 4], in the receiver's local frame.
void prtnet_visibility(highp int receiver, out highp vec4 v[PRTNET_TEXELS]) {
    highp uvec2 entry = texelFetch(prtnet_receivers, prtnet_place(receiver), 0).xy;
    highp int texel = int(entry.x);
    highp int latent = int(entry.y >> $BITSu);
    highp int last = latent + int(entry.y & $MASKu);
    for (highp int k = 0; k < PRTNET_TEXELS; ++k) {
        v[k] = PRTNET_MEAN_OFFSET[k]
             + PRTNET_MEAN_SCALE[k] * texelFetch(prtnet_rows, prtnet_place(texel + k), 0);
    }
    for (; latent < last; ++latent) {
        texel += PRTNET_TEXELS;
        highp float weight = texelFetch(prtnet_latents, prtnet_place(latent), 0).r;
        for (highp int k = 0; k < PRTNET_TEXELS; ++k) {
            v[k] += weight * PRTNET_PROFILE[k]
                  * texelFetch(prtnet_rows, prtnet_place(texel + k), 0);
        }
    }
}
"""


@dataclass(frozen=True, eq=False)
class GPUTables:
    """Textures of one model, whole rows of ``WIDTH`` texels.

    Attributes:
        rows: (height, WIDTH, 4) int8, float16 or float32; 8 bits are read as signed normalised.
        receivers: (height, WIDTH, 2) uint32: each receiver's first texel in ``rows``, and its first
            latent and number of latents, the latter in the low ``COUNT_BITS``.
        mean_scale, mean_offset: mean = offset + scale · texel, (n²,) each.
        profile: what a coefficient's sum over components is multiplied by, (n²,).
        latent_scale: what each latent is to be multiplied by before a shader uses it, (Σ latents,).
    """

    rows: Any
    receivers: Any
    mean_scale: FloatArray
    mean_offset: FloatArray
    profile: FloatArray
    latent_scale: FloatArray


def gpu_tables(model: VisibilityModel) -> GPUTables:
    """The model's means and components laid out for a shader.

    Raises:
        PrtnetError: the model has more latents than a receiver's entry can count.
    """
    starts = model.first_component
    if model.latents.max() >= 2**COUNT_BITS or model.latents.sum() >= 2 ** (32 - COUNT_BITS):
        raise PrtnetError("model", "has too many latents for a shader; train it with fewer")
    mean = model.stored("mean")
    if model.coding is None:
        basis, profile = model.stored("basis"), np.ones(model.order**2, dtype=np.float32)
        values, scale = basis.values, basis.scale
    else:
        coded = model.coding.encode(model.basis)
        values, scale, profile = coded.values, coded.scale, model.coding.profile
    # A normalised texel is its integer over MOST.
    unit = MOST if values.dtype == np.int8 else 1
    coefficients = model.order**2
    texels = -(-coefficients // 4)
    group, slot = np.divmod(model.slot_of_receiver, model.receivers.shape[1])
    counts = model.latents[group].astype(np.int64)
    first = np.cumsum((1 + counts) * texels) - (1 + counts) * texels
    total = int(((1 + counts) * texels).sum())
    height = -(-total // WIDTH)
    flat = np.zeros((height * WIDTH, 4), dtype=values.dtype)
    mean_rows = by_slot(mean.values, coefficients)
    basis_rows = by_slot(values, coefficients)
    for row in range(1 + int(model.latents.max())):  # of all receivers that have so many
        has = np.flatnonzero(counts >= row)
        source, at = (mean_rows, group) if row == 0 else (basis_rows, starts[group] + row - 1)
        padded = np.zeros((len(has), 4 * texels), dtype=flat.dtype)
        padded[:, :coefficients] = source[at[has], slot[has]]
        place = first[has, None] + row * texels + np.arange(texels)
        flat[place] = padded.reshape(len(has), texels, 4)
    entries = np.zeros((-(-len(group) // WIDTH) * WIDTH, 2), dtype=np.uint32)
    entries[: len(group), 0] = first
    entries[: len(group), 1] = (starts[group].astype(np.int64) << COUNT_BITS) | counts
    offset = np.zeros(coefficients) if mean.offset is None else mean.offset
    return GPUTables(
        flat.reshape(height, WIDTH, 4),
        entries.reshape(-1, WIDTH, 2),
        np.broadcast_to(unit * mean.scale.ravel(), coefficients).astype(np.float32),
        offset.astype(np.float32),
        profile,
        np.broadcast_to(unit * scale[:, 0], len(values)).astype(np.float32),
    )


def by_slot(rows: Any, coefficients: int) -> Any:
    """(rows, R · n²) as (rows, R, n²)."""
    return rows.reshape(len(rows), rows.shape[1] // coefficients, coefficients)


def glsl(tables: GPUTables) -> str:
    """The shader include for these tables."""
    coefficients = len(tables.mean_scale)
    texels = -(-coefficients // 4)
    words = {
        "$WIDTH": str(WIDTH),
        "$TEXELS": str(texels),
        "$COEFFICIENTS": str(coefficients),
        "$SCALE": vectors(tables.mean_scale, texels),
        "$OFFSET": vectors(tables.mean_offset, texels),
        "$PROFILE": vectors(tables.profile, texels),
        "$BITS": str(COUNT_BITS),
        "$MASK": str(2**COUNT_BITS - 1),
    }
    text = GLSL
    for word, value in words.items():
        text = text.replace(word, value)
    return text


def vectors(values: FloatArray, texels: int) -> str:
    """Numbers as GLSL vec4s, padded with zeros, as exact as float32."""
    padded = np.zeros(4 * texels, dtype=np.float32)
    padded[: len(values)] = values
    return ", ".join(
        "vec4(" + ", ".join(f"{float(value):.9e}" for value in four) + ")"
        for four in padded.reshape(-1, 4)
    )


def write_gpu_tables(tables: GPUTables, folder: Path) -> None:
    """Write ``gpu.bin``, its layout ``gpu.json``, and ``prtnet.glsl`` into a folder."""
    textures: dict[str, Any] = {}
    offset = 0
    with open(folder / "gpu.bin", "wb") as file:
        for name, array, texel in (
            ("prtnet_rows", tables.rows, FORMATS[tables.rows.dtype.name]),
            ("prtnet_receivers", tables.receivers, "RG32UI"),
        ):
            little = array.astype(array.dtype.newbyteorder("<"))
            textures[name] = {
                "format": texel,
                "dtype": array.dtype.name,
                "shape": list(array.shape),
                "byte_offset": offset,
                "byte_length": little.nbytes,
            }
            offset += file.write(little.tobytes())
    latents = len(tables.latent_scale)
    height = max(1, -(-latents // WIDTH))
    shape = [height, WIDTH, 1]
    textures["prtnet_latents"] = {"format": "R32F", "dtype": "float32", "shape": shape}
    layout = {
        "file": "gpu.bin",
        "width": WIDTH,
        "count_bits": COUNT_BITS,
        "latents": latents,
        "textures": textures,
        "mean_scale": tables.mean_scale.tolist(),
        "mean_offset": tables.mean_offset.tolist(),
        "profile": tables.profile.tolist(),
    }
    (folder / "gpu.json").write_text(json.dumps(layout, indent=1) + "\n", encoding="utf-8")
    (folder / "prtnet.glsl").write_text(glsl(tables), encoding="utf-8")
