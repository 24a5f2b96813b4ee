"""The folder that a game engine takes: the ONNX graph, its facts, and how to use them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from prtnet.files import writing
from prtnet.glsl import WIDTH, texel_format
from prtnet.gpu_tables import COUNT_BITS, GPUTables, gpu_tables, write_gpu_tables
from prtnet.model import VisibilityModel
from prtnet.output_space import OutputSpace
from training.onnx_export import export_latent_onnx, export_onnx
from training.onnx_occluders import export_occluder_onnx

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
{latent} Textures are made once of `gpu.bin`.

`gpu.bin` is little-endian; `gpu.json` gives each texture's format, dtype, shape (height, width,
channels) and byte offset. Textures are {width} texels wide and are read with `texelFetch`, texel i
at (i % {width}, i / {width}); no filter, no mipmaps.

| texture | texel |
|---|---|
| `prtnet_rows` ({rows}) | the receivers one after the other: {texels} texels of \
mean, then {texels} of each component of its group; \
{number} i is channel i % 4 of texel i / 4, padded with zeros |
| `prtnet_receivers` (RG32UI) | of receiver i: its first texel in `prtnet_rows`; its \
first latent · 2^{bits} + its number of latents |
| `prtnet_latents` (R32F) | one latent each: the output of `latent.onnx` as it is, \
uploaded every frame |

With t the texel of {number} i (8-bit integers are signed normalised: t = q / 127),

    {result}[i] = mean_offset[i] + mean_scale[i] t_mean[i]
    {blank}       + profile[i] (sum over k of latent[k] t_k[i])

`latent.onnx` has the components' scales inside. `prtnet.glsl` does this in GLSL 3.30 or
GLSL ES 3.00: put it behind your `#version` line and precision statements, bind all textures that
`gpu.json` names, and call `prtnet_visibility(receiver, v)`.
"""

LOBES = """
**Lobes.** Those {numbers} numbers stand for the {lobes} zonal lobes of a receiver's visibility: the
coefficient of the first band, which needs no lobe; then of each lobe three that point along its
axis; then of each lobe its bands l = 1 … {last}, g_l sqrt((2l + 1) / 4 pi). `prtnet_visibility` has
made coefficients of them; `prtnet_lobes(receiver, axis, g)` gives unit axes in the local frame and
g. A lobe is turned by turning its axis: into the frame of the mirrored view, for 1D BRDFs.
"""

LATENT = """\
`latent.onnx` turns the pose into `latents` (poses, {latents}); a shader rebuilds the visibility of
each vertex from them and from textures. Per frame only the latents travel."""

CONSTANT = """\
The clusters know no pose but the mean: there are no latents, and no `latent.onnx`; the texture of
latents is never read. A shader takes the means from textures."""

POSES = {
    "skinned": "The joints' model-space matrices, 3 rows of 4 each, row after row, in the order "
    "of the file's skin; then the morph weights.",
    "point_cache": "The vertices' positions, x y z each.",
}


PRIOR = """
**Surroundings.** To that the shader adds what every receiver sees around it (a prior by {prior}),
and keeps the sum within the bounds of training. `occluders.onnx` turns the pose into `occluders`
(poses, {occluders}, 4): the texels of `prtnet_prior_pose`, in rows of {width}, to be uploaded for
every pose as well.

| texture | texel |
|---|---|
| `prtnet_prior_pose` (RGBA32F) | {posed} |
{textures}

An engine that has these matrices and centres at hand may fill the texture itself, without
`occluders.onnx`. `prtnet_carried` in `prtnet.glsl` says where the pose carries a receiver; one that
knows so already may call `prtnet_prior(receiver, position, frame, v)` by itself.
"""

POSED = {
    "skin": "three rows of each joint's matrix from rest; centre and squared radius of each sphere,"
    " an empty one last; centroid and vector area, a texel each, of each patch of skin, an empty "
    "one last. About joint 0, in units of the character's size",
    "patches": "every vertex; normal and tangent, a texel each, of every front receiver; centroid "
    "and vector area, a texel each, of every patch, an empty one last. About vertex 0, in units of "
    "the sheet's size",
}

HOLDS = {
    "prtnet_prior_weights": "learned numbers",
    "prtnet_prior_numbers": "the range of training, and what the learned numbers are multiplied by",
    "prtnet_prior_indices": "which occluders a receiver looks at",
    "prtnet_prior_rest": "receivers at rest: position, normal, tangent, and the joints that carry "
    "them",
}


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
        **({"lobes": model.lobes} if model.lobes else {}),
    }
    tables = gpu_tables(model)
    facts["prior"] = None if model.prior is None else model.prior.kind
    with writing(out) as partial:
        partial.mkdir()
        export_onnx(model, partial / "model.onnx")
        if facts["latents"]:
            export_latent_onnx(model, tables.latent_scale, partial / "latent.onnx")
        if model.prior is not None:
            export_occluder_onnx(model, partial / "occluders.onnx")
        write_gpu_tables(tables, partial)
        gpu = readme_gpu(facts, tables)
        (partial / "README.md").write_text(readme(facts, gpu), encoding="utf-8")
        facts["rest_tangents"] = model.rest_tangents.tolist()
        (partial / "model.json").write_text(json.dumps(facts) + "\n", encoding="utf-8")
    return {file.name: file.stat().st_size for file in sorted(out.iterdir())}


def readme(facts: dict[str, Any], gpu: str) -> str:
    """What the engine programmer reads."""
    pose = POSES[facts["scene_kind"]]
    return README.format(**facts, coefficients=facts["order"] ** 2, pose=pose, gpu=gpu)


def readme_gpu(facts: dict[str, Any], tables: GPUTables) -> str:
    """Its part on rebuilding visibility in a shader."""
    latent = (LATENT if facts["latents"] else CONSTANT).format(**facts)
    numbers, result = len(tables.profile), "visibility" if tables.lobes is None else "number"
    text = GPU.format(
        **facts, latent=latent, width=WIDTH, texels=-(-numbers // 4), bits=COUNT_BITS,
        rows=texel_format(tables.rows), result=result, blank=" " * len(result),
        number="coefficient" if tables.lobes is None else "number",
    )  # fmt: skip
    if tables.lobes is not None:
        text += LOBES.format(numbers=numbers, lobes=tables.lobes.count, last=tables.order - 1)
    if tables.prior is None:
        return text
    seen = tables.prior.seen
    rows = [
        f"| `{name}` ({texel_format(array)}) | {HOLDS[name]} |"
        for name, array in tables.prior.textures.items()
    ]
    return text + PRIOR.format(
        **facts, occluders=seen.posed_texels, width=WIDTH, posed=POSED[seen.kind],
        textures="\n".join(rows),
    )  # fmt: skip
