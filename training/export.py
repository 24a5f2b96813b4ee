"""The folder that a game engine takes: the ONNX graph, its facts, and how to use them."""

from __future__ import annotations

import json
from pathlib import Path

from prtnet.files import writing
from prtnet.model import VisibilityModel
from prtnet.output_space import OutputSpace
from training.onnx_export import export_onnx

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

**Shading.** Rotate the light's coefficients into the local frame (or the visibility out of it),
multiply light and visibility, and integrate with the clamped cosine and the BRDF.
"""

POSES = {
    "skinned": "The joints' model-space matrices, 3 rows of 4 each, row after row, in the order "
    "of the file's skin; then the morph weights.",
    "point_cache": "The vertices' positions, x y z each.",
}


def export_folder(model: VisibilityModel, out: Path) -> dict[str, int]:
    """Write ``model.onnx``, ``model.json`` and ``README.md`` into a folder, replacing it.

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
    }
    text = README.format(
        **facts,
        coefficients=model.order**2,
        pose=POSES[facts["scene_kind"]],
    )
    facts["rest_tangents"] = model.rest_tangents.tolist()
    with writing(out) as partial:
        partial.mkdir()
        export_onnx(model, partial / "model.onnx")
        (partial / "model.json").write_text(json.dumps(facts) + "\n", encoding="utf-8")
        (partial / "README.md").write_text(text, encoding="utf-8")
    return {file.name: file.stat().st_size for file in sorted(out.iterdir())}
