"""What a GPU needs to rebuild visibility from latents: textures, and GLSL that reads them.

Every receiver's numbers lie together in one texture: its mean, then its row of each component of
its group, four coefficients a texel. A scale that a whole component shares is left to the latents,
so that a texel is used as it is. What a prior adds is in ``prtnet.gpu_prior``, what makes
visibility of lobes in ``prtnet.gpu_lobes``.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.glsl import WIDTH, filled, texel_format, texture, vectors
from prtnet.gpu_lobes import lobes_glsl
from prtnet.gpu_prior import PriorTables, prior_tables
from prtnet.lobe_numbers import LobeNumbers
from prtnet.model import VisibilityModel
from prtnet.storage import MOST

__all__ = ["COUNT_BITS", "GPUTables", "glsl", "gpu_tables", "write_gpu_tables"]

COUNT_BITS = 12  # of a receiver's second number: its latents, below them where they begin

GLSL = """\
// Visibility of a receiver from a pose's latents: GLSL 3.30 and GLSL ES 3.00 (WebGL 2).
// Made by prtnet; README.md beside this file says what the textures hold.

uniform highp sampler2D prtnet_rows;
uniform highp usampler2D prtnet_receivers;
uniform highp sampler2D prtnet_latents;

const highp int PRTNET_WIDTH = $WIDTH;  // texels in a row of a texture
const highp int PRTNET_TEXELS = $TEXELS;  // of one receiver's $COEFFICIENTS coefficients
const highp int PRTNET_ROW = $ROW;  // of one receiver's $NUMBERS numbers in one row
const highp vec4 PRTNET_MEAN_SCALE[PRTNET_ROW] = vec4[PRTNET_ROW]($SCALE);
const highp vec4 PRTNET_MEAN_OFFSET[PRTNET_ROW] = vec4[PRTNET_ROW]($OFFSET);
const highp vec4 PRTNET_PROFILE[PRTNET_ROW] = vec4[PRTNET_ROW]($PROFILE);

highp ivec2 prtnet_place(highp int index) {
    return ivec2(index % PRTNET_WIDTH, index / PRTNET_WIDTH);
}

$PRIOR// $MEANING
void $FUNCTION(highp int receiver, out highp vec4 v[PRTNET_ROW]) {
    highp uvec2 entry = texelFetch(prtnet_receivers, prtnet_place(receiver), 0).xy;
    highp int texel = int(entry.x);
    highp int latent = int(entry.y >> $BITSu);
    highp int last = latent + int(entry.y & $MASKu);
    for (highp int k = 0; k < PRTNET_ROW; ++k) {
        v[k] = PRTNET_MEAN_OFFSET[k]
             + PRTNET_MEAN_SCALE[k] * texelFetch(prtnet_rows, prtnet_place(texel + k), 0);
    }
    for (; latent < last; ++latent) {
        texel += PRTNET_ROW;
        highp float weight = texelFetch(prtnet_latents, prtnet_place(latent), 0).r;
        for (highp int k = 0; k < PRTNET_ROW; ++k) {
            v[k] += weight * PRTNET_PROFILE[k]
                  * texelFetch(prtnet_rows, prtnet_place(texel + k), 0);
        }
    }
$ADDED}
$LOBES"""

COEFFICIENTS = "Coefficient i is v[i / 4][i % 4], in the receiver's local frame."
NUMBERS = "Number i of those that stand for a receiver's lobes is v[i / 4][i % 4]."

ADDED = """\
    highp vec3 position;
    highp mat3 frame;
    prtnet_carried(receiver, position, frame);
    highp vec4 known[PRTNET_TEXELS];
    prtnet_prior(receiver, position, frame, known);
    for (highp int k = 0; k < PRTNET_TEXELS; ++k) v[k] += known[k];
"""

BOUNDS = """\
const highp vec4 PRTNET_LOW[PRTNET_TEXELS] = vec4[PRTNET_TEXELS]($LOW);
const highp vec4 PRTNET_HIGH[PRTNET_TEXELS] = vec4[PRTNET_TEXELS]($HIGH);

"""

BOUNDED = """\
    for (highp int k = 0; k < PRTNET_TEXELS; ++k)
        v[k] = clamp(v[k], PRTNET_LOW[k], PRTNET_HIGH[k]);
"""


@dataclass(frozen=True, eq=False)
class GPUTables:
    """Textures of one model, whole rows of ``WIDTH`` texels.

    Attributes:
        rows: (height, WIDTH, 4) int8, float16 or float32; 8 bits are read as signed normalised.
        receivers: (height, WIDTH, 2) uint32: each receiver's first texel in ``rows``, and its first
            latent and number of latents, the latter in the low ``COUNT_BITS``.
        order: n of visibility.
        mean_scale, mean_offset: mean = offset + scale · texel, (n²,) each; (N,) of lobes that stand
            for visibility as N numbers.
        profile: what a coefficient's sum over components is multiplied by, as many.
        latent_scale: what each latent is to be multiplied by before a shader uses it, (Σ latents,).
        prior: what is added; None for models without one.
        bounds: that visibility is kept between, (2, n²); None for no bounds.
        lobes: what the numbers stand for; None where they are coefficients.
    """

    rows: Any
    receivers: Any
    order: int
    mean_scale: FloatArray
    mean_offset: FloatArray
    profile: FloatArray
    latent_scale: FloatArray
    prior: PriorTables | None = None
    bounds: FloatArray | None = None
    lobes: LobeNumbers | None = None

    @property
    def textures(self) -> dict[str, Any]:
        """Those that stay the same in all poses, by their names in GLSL."""
        own = {"prtnet_rows": self.rows, "prtnet_receivers": self.receivers}
        return own if self.prior is None else own | self.prior.textures


def gpu_tables(model: VisibilityModel) -> GPUTables:
    """The model's means, components and prior laid out for a shader.

    Raises:
        PrtnetError: the model has more latents than a receiver's entry can count, or no shader is
            known for its prior.
    """
    starts = model.first_component
    if model.latents.max() >= 2**COUNT_BITS or model.latents.sum() >= 2 ** (32 - COUNT_BITS):
        raise PrtnetError("model", "has too many latents for a shader; train it with fewer")
    mean = model.stored("mean")
    if model.coding is None:
        basis, profile = model.stored("basis"), np.ones(model.numbers, dtype=np.float32)
        values, scale = basis.values, basis.scale
    else:
        coded = model.coding.encode(model.basis)
        values, scale, profile = coded.values, coded.scale, model.coding.profile
    # A normalised texel is its integer over MOST.
    unit = MOST if values.dtype == np.int8 else 1
    coefficients = model.numbers
    texels = -(-coefficients // 4)
    group, slot = np.divmod(model.slot_of_receiver, model.receivers.shape[1])
    counts = model.latents[group].astype(np.int64)
    first = np.cumsum((1 + counts) * texels) - (1 + counts) * texels
    flat = np.zeros((int(((1 + counts) * texels).sum()), 4), dtype=values.dtype)
    mean_rows = by_slot(mean.values, coefficients)
    basis_rows = by_slot(values, coefficients)
    for row in range(1 + int(model.latents.max())):  # of all receivers that have so many
        has = np.flatnonzero(counts >= row)
        source, at = (mean_rows, group) if row == 0 else (basis_rows, starts[group] + row - 1)
        padded = np.zeros((len(has), 4 * texels), dtype=flat.dtype)
        padded[:, :coefficients] = source[at[has], slot[has]]
        place = first[has, None] + row * texels + np.arange(texels)
        flat[place] = padded.reshape(len(has), texels, 4)
    entries = np.stack([first, (starts[group].astype(np.int64) << COUNT_BITS) | counts], axis=1)
    offset = np.zeros(coefficients) if mean.offset is None else mean.offset
    prior = None
    if model.prior is not None:
        prior = prior_tables(model.prior, lambda name: model.stored(f"prior.{name}"))
    return GPUTables(
        texture(flat),
        texture(entries.astype(np.uint32)),
        model.order,
        np.broadcast_to(unit * mean.scale.ravel(), coefficients).astype(np.float32),
        offset.astype(np.float32),
        profile,
        np.broadcast_to(unit * scale[:, 0], len(values)).astype(np.float32),
        prior,
        model.bounds,
        model.lobe_numbers,
    )


def by_slot(rows: Any, coefficients: int) -> Any:
    """(rows, R · N) as (rows, R, N)."""
    return rows.reshape(len(rows), rows.shape[1] // coefficients, coefficients)


def glsl(tables: GPUTables) -> str:
    """The shader include for these tables."""
    numbers, texels = len(tables.mean_scale), -(-(tables.order**2) // 4)
    row = -(-numbers // 4)
    prior, added = "", ""
    if tables.prior is not None:
        prior, added = tables.prior.glsl + "\n", ADDED
    if tables.bounds is not None:
        low, high = (vectors(bound, texels) for bound in tables.bounds)
        prior += filled(BOUNDS, {"LOW": low, "HIGH": high})
        added += BOUNDED
    words = {
        "WIDTH": WIDTH,
        "TEXELS": texels,
        "COEFFICIENTS": tables.order**2,
        "ROW": row,
        "NUMBERS": numbers,
        "SCALE": vectors(tables.mean_scale, row),
        "OFFSET": vectors(tables.mean_offset, row),
        "PROFILE": vectors(tables.profile, row),
        "BITS": COUNT_BITS,
        "MASK": 2**COUNT_BITS - 1,
        "PRIOR": prior,
        "ADDED": added,
        "FUNCTION": "prtnet_visibility" if tables.lobes is None else "prtnet_numbers",
        "MEANING": COEFFICIENTS if tables.lobes is None else NUMBERS,
        "LOBES": "" if tables.lobes is None else lobes_glsl(tables.lobes),
    }
    return filled(GLSL, words)


def write_gpu_tables(tables: GPUTables, folder: Path) -> None:
    """Write ``gpu.bin``, its layout ``gpu.json``, and ``prtnet.glsl`` into a folder."""
    textures: dict[str, Any] = {}
    offset = 0
    with open(folder / "gpu.bin", "wb") as file:
        for name, array in tables.textures.items():
            little = array.astype(array.dtype.newbyteorder("<"))
            textures[name] = {
                "format": texel_format(array),
                "dtype": array.dtype.name,
                "shape": list(array.shape),
                "byte_offset": offset,
                "byte_length": little.nbytes,
            }
            offset += file.write(little.tobytes())
    latents = len(tables.latent_scale)
    posed = {"prtnet_latents": (latents, 1)}
    if tables.prior is not None:
        posed["prtnet_prior_pose"] = tables.prior.seen.posed_texels, 4
    for name, (count, channels) in posed.items():
        shape = [max(1, -(-count // WIDTH)), WIDTH, channels]
        texel = "R32F" if channels == 1 else "RGBA32F"
        textures[name] = {"format": texel, "dtype": "float32", "shape": shape}
    layout: dict[str, Any] = {
        "file": "gpu.bin",
        "width": WIDTH,
        "count_bits": COUNT_BITS,
        "latents": latents,
        "textures": textures,
        "mean_scale": tables.mean_scale.tolist(),
        "mean_offset": tables.mean_offset.tolist(),
        "profile": tables.profile.tolist(),
    }
    if tables.lobes is not None:
        layout["lobes"] = tables.lobes.count
    if tables.bounds is not None:
        layout["bounds"] = tables.bounds.tolist()
    if tables.prior is not None:
        seen = tables.prior.seen
        layout["occluders"] = {"kind": seen.kind, "texels": seen.posed_texels, **seen.layout}
    (folder / "gpu.json").write_text(json.dumps(layout, indent=1) + "\n", encoding="utf-8")
    (folder / "prtnet.glsl").write_text(glsl(tables), encoding="utf-8")
