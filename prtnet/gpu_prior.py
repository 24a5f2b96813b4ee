"""A prior for a shader: textures, and GLSL that adds it to what the latents rebuild.

What changes with a pose is a small texture of where the occluders are; the shader sums the caps
that a receiver sees, keeps the sums within the range of training, and multiplies them with its
cluster's map or runs the network. Learned numbers stay in the bytes the model stores them in; the
scales they share stand beside them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.glsl import filled, texture
from prtnet.gpu_patches import seen_by_sheet
from prtnet.gpu_skin import seen_by_skin
from prtnet.gpu_surroundings import SeenTables, fours
from prtnet.patches import PatchSurroundings
from prtnet.prior import MapPrior, NetworkPrior, Prior
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.storage import HALF_LIMIT, MOST, Stored

__all__ = ["PriorTables", "prior_tables"]

SMALLEST_HALF = 2.0**-24  # models that keep geometry in half precision are nearer to halves
MOST_SHORT = 2**16 - 1
SATURATED = 10.0  # tanh is ±1 in float32 from here on; some drivers overflow far outside

HEAD = """\
uniform highp sampler2D prtnet_prior_numbers;
uniform highp sampler2D prtnet_prior_weights;
uniform highp usampler2D prtnet_prior_indices;
uniform highp sampler2D prtnet_prior_pose;

const highp int PRTNET_INDICES = $INDICES;  // where those of what is seen begin
const highp int PRTNET_NUMBERS = $NUMBERS;

highp vec4 prtnet_number(highp int texel) {
    return texelFetch(prtnet_prior_numbers, prtnet_place(texel), 0);
}

highp vec4 prtnet_weight(highp int texel) {
    return texelFetch(prtnet_prior_weights, prtnet_place(texel), 0);
}

highp uvec4 prtnet_index(highp int texel) {
    return texelFetch(prtnet_prior_indices, prtnet_place(texel), 0);
}

highp vec4 prtnet_pose(highp int texel) {
    return texelFetch(prtnet_prior_pose, prtnet_place(texel), 0);
}

"""

KNOWN = """
// The same, kept within the range of training.
void prtnet_known(highp int receiver, highp vec3 position, highp mat3 frame,
                  out highp vec4 seen[PRTNET_SEEN_TEXELS]) {
    prtnet_seen(receiver, position, frame, seen);
    for (highp int k = 0; k < PRTNET_SEEN_TEXELS; ++k)
        seen[k] = clamp(seen[k], prtnet_number(2 * k), prtnet_number(2 * k + 1));
}

"""

MAPS = """\
// A receiver's part of visibility that its surroundings tell, by its cluster's map.
void prtnet_prior(highp int receiver, highp vec3 position, highp mat3 frame,
                  out highp vec4 v[PRTNET_TEXELS]) {
    highp vec4 seen[PRTNET_SEEN_TEXELS];
    prtnet_known(receiver, position, frame, seen);
    highp int cluster = int(prtnet_index(receiver / 4)[receiver % 4]);
    highp int at = cluster * 8 * PRTNET_SEEN_TEXELS * PRTNET_TEXELS;
    for (highp int o = 0; o < PRTNET_TEXELS; ++o) v[o] = vec4(0.0);
    for (highp int k = 0; k < PRTNET_SEEN_TEXELS; ++k) {
        highp vec4 x = seen[k], bent = x / (1.0 + 0.5 * abs(x));
        for (highp int j = 0; j < 4; ++j) {
            for (highp int o = 0; o < PRTNET_TEXELS; ++o)
                v[o] += x[j] * prtnet_weight(at + o)
                      + bent[j] * prtnet_weight(at + PRTNET_TEXELS + o);
            at += 2 * PRTNET_TEXELS;
        }
    }
    for (highp int o = 0; o < PRTNET_TEXELS; ++o)
        v[o] *= prtnet_number($SCALES + cluster * PRTNET_TEXELS + o);
}
"""

NETWORK = """\
// A receiver's part of visibility that its surroundings tell, by the network.
void prtnet_prior(highp int receiver, highp vec3 position, highp mat3 frame,
                  out highp vec4 v[PRTNET_TEXELS]) {
    highp vec4 seen[PRTNET_SEEN_TEXELS];
    prtnet_known(receiver, position, frame, seen);
    highp vec4 x;
$LAYERS}
"""

LAYER = """\
    for (highp int o = 0; o < $WIDTH_OUT; ++o) $NEW[o] = vec4(0.0);
$INPUTS    for (highp int o = 0; o < $WIDTH_OUT; ++o)
        $NEW[o] = $NEW[o] * prtnet_number($SCALE + o) + prtnet_number($BIAS + o);
"""

INPUT = """\
    for (highp int k = 0; k < $COUNT; ++k) {
        x = $VALUE;
        for (highp int j = 0; j < 4; ++j)
            for (highp int o = 0; o < $WIDTH_OUT; ++o)
                $NEW[o] += x[j] * prtnet_weight($FIRST + (4 * k + j) * $WIDTH_OUT + o);
    }
"""


@dataclass(frozen=True, eq=False)
class PriorTables:
    """A prior laid out for a shader.

    Attributes:
        textures: by name, whole rows (height, WIDTH, 4): ``prtnet_prior_weights`` in the bytes of
            the model, ``prtnet_prior_numbers`` float32, ``prtnet_prior_indices`` uint16 or uint32,
            and of skinned meshes ``prtnet_prior_rest`` float16 or float32.
        seen: what receivers see; ``seen.posed`` gives the texels of ``prtnet_prior_pose``.
        glsl: ``prtnet_carried`` and ``prtnet_prior``, for behind ``prtnet_place``.
    """

    textures: dict[str, Any]
    seen: SeenTables
    glsl: str


def prior_tables(prior: Prior, stored: Callable[[str], Stored]) -> PriorTables:
    """A prior laid out for a shader.

    Args:
        prior: maps or a network.
        stored: a learned array of the prior as it is stored, by its name.

    Raises:
        PrtnetError: no shader is known for its kind.
    """
    sees = prior.surroundings
    if isinstance(sees, SkinSurroundings):
        seen = seen_by_skin(sees)
    elif isinstance(sees, PatchSurroundings):
        seen = seen_by_sheet(sees)
    else:
        raise PrtnetError("model", f"sees {sees.kind}, which no shader does; use model.onnx")
    bounds = np.stack([in_slots(prior.low, seen.slots), in_slots(prior.high, seen.slots)])
    bounds = bounds.reshape(2, -1, 4).swapaxes(0, 1).reshape(-1, 4)
    numbers = [bounds, seen.numbers]
    indices = []
    first = len(bounds) + len(seen.numbers)
    if isinstance(prior, MapPrior):
        indices.append(fours(prior.cluster[None], 0)[0])
        weights, own = map_texels(stored("maps"), seen.slots)
        text = filled(MAPS, {"SCALES": first})
    elif isinstance(prior, NetworkPrior):
        weights, own, text = network_texels(prior, stored, seen.slots, first)
    else:
        raise PrtnetError("model", f"has a prior by {prior.kind}, which no shader does")
    words = {"INDICES": sum(len(part) for part in indices), "NUMBERS": len(bounds)}
    every = np.concatenate([*indices, seen.indices])
    textures = {
        "prtnet_prior_weights": weights,
        "prtnet_prior_numbers": np.concatenate([*numbers, own]).astype(np.float32),
        "prtnet_prior_indices": every.astype(np.uint16 if every.max() <= MOST_SHORT else np.uint32),
    }
    if len(seen.rest):
        half = np.clip(seen.rest, -HALF_LIMIT, HALF_LIMIT).astype(np.float16)
        fits = np.abs(half - seen.rest).max() < SMALLEST_HALF
        textures["prtnet_prior_rest"] = half if fits else seen.rest
    return PriorTables(
        {name: texture(texels) for name, texels in textures.items()},
        seen,
        filled(HEAD, words) + seen.glsl + KNOWN + text,
    )


def in_slots(values: Any, slots: IntArray) -> Any:
    """Rows (F, …) in the slots of features; zeros where there is none."""
    placed = np.zeros((len(slots), *values.shape[1:]), dtype=values.dtype)
    placed[slots >= 0] = values[slots[slots >= 0]]
    return placed


def whole_columns(values: Any) -> Any:
    """Columns (…, N) filled up to whole texels, (…, ⌈N / 4⌉, 4)."""
    texels = -(-values.shape[-1] // 4)
    padded = np.zeros((*values.shape[:-1], 4 * texels), dtype=values.dtype)
    padded[..., : values.shape[-1]] = values
    return padded.reshape(*values.shape[:-1], texels, 4)


def unit_of(values: Any) -> int:
    """What a texel of 8 bits is to be multiplied by: it is read as its integer over ``MOST``."""
    return MOST if values.dtype == np.int8 else 1


def map_texels(maps: Stored, slots: IntArray) -> tuple[Any, FloatArray]:
    """Texels of weights, row after row of features and their saturated form, and of scales."""
    clusters, rows, size = maps.values.shape
    pairs = maps.values.reshape(clusters, 2, rows // 2, size).transpose(2, 0, 1, 3)
    placed = whole_columns(in_slots(pairs, slots).swapaxes(0, 1))  # [C, slots, 2, texels, 4]
    scale = np.broadcast_to(maps.scale, (clusters, 1, size)) * unit_of(maps.values)
    return placed.reshape(-1, 4), whole_columns(scale).reshape(-1, 4)


def network_texels(
    prior: NetworkPrior, stored: Callable[[str], Stored], slots: IntArray, first: int
) -> tuple[Any, FloatArray, str]:
    """Texels of weights and, behind ``first``, of numbers, and the GLSL that reads them."""
    layers = [stored(f"weight{k}") for k in range(len(prior.weights))]
    code = stored("code")
    # Tables too small to be rounded stay float32, and make all of them so.
    dtype = np.result_type(*(table.values.dtype for table in (*layers, code)))
    *layers, code = (in_dtype(table, dtype) for table in (*layers, code))
    codes = whole_columns(code.values)  # [V, texels, 4]
    seen, own = len(prior.low), code.values.shape[1]
    weights: list[Any] = [codes.reshape(-1, 4)]
    numbers: list[FloatArray] = [whole_columns(numbered(code, own))]
    parts: list[str] = []
    at, number = len(weights[0]), first + len(numbers[0])
    sources = [
        (f"{len(slots) // 4}", "seen[k]"),
        (f"{codes.shape[1]}", f"prtnet_weight(receiver * {codes.shape[1]} + k)"
         f" * prtnet_number({first} + k)"),
    ]  # fmt: skip
    for index, (layer, bias) in enumerate(zip(layers, prior.biases, strict=True)):
        rows: Any = layer.values
        if index == 0:
            rows = np.concatenate([in_slots(rows[:seen], slots), rows[seen:]])
        rows = np.pad(rows, [(0, -len(rows) % 4), (0, 0)])
        texels = whole_columns(rows)
        width = texels.shape[1]
        new = "v" if index == len(layers) - 1 else f"layer{index}"
        words: dict[str, object] = {
            "WIDTH_OUT": width, "NEW": new, "SCALE": number, "BIAS": number + width,
        }  # fmt: skip
        inputs, row = [], at
        for count, value in sources:
            inputs.append(filled(INPUT, {**words, "COUNT": count, "VALUE": value, "FIRST": row}))
            row += 4 * int(count) * width
        declared = "" if new == "v" else f"    highp vec4 {new}[{width}];\n"
        parts.append(declared + filled(LAYER, {**words, "INPUTS": "".join(inputs)}))
        weights.append(texels.reshape(-1, 4))
        numbers += [whole_columns(numbered(layer, len(bias))), whole_columns(bias)]
        at, number = row, number + 2 * width
        sources = [(str(width), f"tanh(clamp({new}[k], -{SATURATED}, {SATURATED}))")]
    text = filled(NETWORK, {"LAYERS": "".join(parts)})
    return np.concatenate(weights), np.concatenate(numbers), text


def in_dtype(stored: Stored, dtype: Any) -> Stored:
    """The same values in another type."""
    return dataclasses.replace(stored, values=stored.values.astype(dtype))


def numbered(stored: Stored, width: int) -> FloatArray:
    """What each column's texels are multiplied by, (width,) float32."""
    scale = np.broadcast_to(stored.scale.ravel(), width) * unit_of(stored.values)
    return scale.astype(np.float32)
