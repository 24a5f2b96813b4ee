"""The folder that a game engine takes: the ONNX graph, its facts, and how to use them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from prtnet.files import writing
from prtnet.gpu_tables import COUNT_BITS, FORMATS, WIDTH, gpu_tables, write_gpu_tables
from prtnet.model import VisibilityModel
from prtnet.output_space import OutputSpace
from training.onnx_export import export_latent_onnx, export_onnx

__all__ = ["export_folder"]

FACTS = (
    "prtnet", "scene_name", "scene_kind", "scene_sha256", "mesh_sha256", "two_sided", "pose_size",
    "dropped_joints", "clips", "held_out", "training_error", "held_out_error",
)  # fmt: skip

README = """\
# {scene_name}: soft shadows

`model.onnx` (opset 15, float32) turns a pose into every receiver's visibility.

| | name | shape |
|---|---|---|
| input | `pose` | (poses, {pose_size}) |
| output | `visibility` | (poses, {receivers}, {coefficients}) |

**Pose.** {pose}

**Visibility.** Real orthonormal spherical harmonics of order {order} (index l² + l + m, with the
Condon–Shortley phase) in each receiver's local frame: z is the vertex normal, x its tangent made
perpendicular to it. 1 is open, 0 blocked, there is no cosine inside. A receiver is a unique vertex:
`model.json` has its tangent at rest under `rest_tangents`, which is skinned like any tangent.
Where its large arrays are stored in fewer bytes ({storage} here), Cast, Mul and Add at the head of
the graph make floats of them; onnxruntime does that once, when it loads.

**Shading.** Rotate the light's coefficients into the local frame (or the visibility out of it),
multiply light and visibility, and integrate with the clamped cosine and the BRDF.

# On the GPU

{gpu}"""

GPU = """\
`latent.onnx` turns the pose into `latents` (poses, {latents}); a shader rebuilds the visibility of
each vertex from them and from textures made once of `gpu.bin`. Per frame only the latents travel.

`gpu.bin` is little-endian; `gpu.json` gives each texture's format, dtype, shape (height, width,
channels) and byte offset. Textures are {width} texels wide and are read with `texelFetch`, texel i
at (i % {width}, i / {width}); no filter, no mipmaps.

| texture | texel |
|---|---|
| `prtnet_rows` ({rows}) | the receivers one after the other: {texels} texels of \
mean, then {texels} of each component of its group; \
coefficient i is channel i % 4 of texel i / 4, padded with zeros |
| `prtnet_receivers` (RG32UI) | of receiver i: its first texel in `prtnet_rows`; its \
first latent · 2^{bits} + its number of latents |
| `prtnet_latents` (R32F) | one latent each: the output of `latent.onnx` as it is, \
uploaded every frame |

With t the texel of coefficient i (8-bit integers are signed normalised: t = q / 127),

    visibility[i] = mean_offset[i] + mean_scale[i] t_mean[i]
                    + profile[i] (sum over k of latent[k] t_k[i])

`latent.onnx` has the components' scales inside. `prtnet.glsl` does this in GLSL 3.30 or
GLSL ES 3.00: put it behind your `#version` line and precision statements, bind the three textures,
and call `prtnet_visibility(receiver, v)`.
"""

CONSTANT = """\
The model knows no pose but the mean: there are no latents, and no `latent.onnx`. `gpu.bin` and
`prtnet.glsl` hold the means.
"""

POSES = {
    "skinned": "The joints' model-space matrices, 3 rows of 4 each, row after row, in the order "
    "of the file's skin; then the morph weights.",
    "point_cache": "The vertices' positions, x y z each.",
}


WITH_PRIOR = """\
**On the GPU.** This model looks at what surrounds every receiver (a prior by {prior}), which
latents alone do not tell: `model.onnx` has it all, and there are no tables for a shader."""


def export_folder(model: VisibilityModel, out: Path) -> dict[str, int]:
    """Write the graphs, the GPU's tables, ``model.json`` and ``README.md``, replacing the folder.

    Returns:
        Sizes of the files in bytes, by name.

    Raises:
        PrtnetError: the folder cannot be written, or the model gives no plain visibility.
    """
    OutputSpace.of(model.metadata).require_plain("export it")
    facts = {name: model.metadata[name] for name in FACTS if name in model.metadata}
    facts |= {
        "kind": model.kind,
        "features": model.features.kind,
        "order": model.order,
        "receivers": model.receiver_count,
        "storage": model.storage,
        "latents": int(model.latents.sum()),
    }
    tables = None if model.prior is not None else gpu_tables(model)
    facts["prior"] = None if model.prior is None else model.prior.kind
    with writing(out) as partial:
        partial.mkdir()
        export_onnx(model, partial / "model.onnx")
        if tables is not None:
            if facts["latents"]:
                export_latent_onnx(model, tables.latent_scale, partial / "latent.onnx")
            write_gpu_tables(tables, partial)
        (partial / "README.md").write_text(readme(facts), encoding="utf-8")
        facts["rest_tangents"] = model.rest_tangents.tolist()
        (partial / "model.json").write_text(json.dumps(facts) + "\n", encoding="utf-8")
    return {file.name: file.stat().st_size for file in sorted(out.iterdir())}


def readme(facts: dict[str, Any]) -> str:
    """What the engine programmer reads."""
    coefficients = facts["order"] ** 2
    gpu = GPU if facts["latents"] else CONSTANT
    if facts["prior"] is not None:
        gpu = WITH_PRIOR
    gpu = gpu.format(
        **facts, width=WIDTH, texels=-(-coefficients // 4), bits=COUNT_BITS,
        rows=FORMATS[facts["storage"]],
    )  # fmt: skip
    pose = POSES[facts["scene_kind"]]
    return README.format(**facts, coefficients=coefficients, pose=pose, gpu=gpu)
