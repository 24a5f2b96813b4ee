"""What a shader wants to know of a pose to see what surrounds every receiver, as a graph.

The twin of ``prtnet.gpu_skin.posed_skin`` and ``prtnet.gpu_patches.posed_patches``: texels of four
numbers, a few for each joint, sphere, patch or vertex.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx

from prtnet.model import VisibilityModel
from prtnet.patches import PatchSurroundings
from prtnet.skin_surroundings import SkinSurroundings
from training.onnx_export import write_graph
from training.onnx_expression import Value
from training.onnx_graph import GraphBuilder
from training.onnx_patches import patch_table_nodes, sheet_nodes
from training.onnx_skin import Carried, carry_nodes

__all__ = ["build_occluder_onnx", "export_occluder_onnx"]


def build_occluder_onnx(model: VisibilityModel) -> onnx.ModelProto:
    """A checked graph: ``pose`` (poses, D) in, ``occluders`` (poses, N, 4) out.

    Raises:
        TypeError: there is no prior, or none that a graph is known for.
    """
    graph = GraphBuilder()
    sees = None if model.prior is None else model.prior.surroundings
    if isinstance(sees, SkinSurroundings):
        count = skin_texels(graph, sees)
    elif isinstance(sees, PatchSurroundings):
        count = sheet_texels(graph, sees, model.pose_size)
    else:
        raise TypeError(f"no occluders of {type(sees).__name__}")
    return graph.model(
        model.pose_size, "occluders", [count, 4], {"prtnet": "occluders", "kind": model.kind}
    )


def skin_texels(graph: GraphBuilder, sees: SkinSurroundings) -> int:
    """``occluders`` of a skinned mesh; how many texels they are."""
    carry = carry_nodes(graph, sees)  # [P, J, 12]
    spheres = Carried(carry, sees.sphere_joint)
    radius2 = spheres.scale2() * (sees.sphere_radius.astype(np.float64) ** 2)
    patches = Carried(carry, sees.patch_joint, sees.patch_weight)
    middle, area = patches.point(sees.patch_centre), patches.area(sees.patch_area)
    nothing = middle.take([0], 1) * 0.0
    empty = carry.take([0], 1).take([0, 1, 2, 3], 2) * 0.0

    def texels(*rows: Value) -> str:
        """(P, N, 4) of the channels (P, 1 or 3, N) of each."""
        whole = graph.node("Concat", *(row.name for row in rows), axis=1)
        return graph.reshape(graph.node("Transpose", whole, perm=[0, 2, 1]), [0, -1, 4])

    graph.node(
        "Concat",
        carry.reshaped(0, -1, 4).name,
        texels(spheres.point(sees.sphere_centre), radius2), empty.name,
        texels(middle, nothing, area, nothing), empty.name, empty.name,
        axis=1, output="occluders",
    )  # fmt: skip
    return 3 * sees.joints + len(sees.sphere_joint) + 1 + 2 * (len(sees.patch_joint) + 1)


def sheet_texels(graph: GraphBuilder, sees: PatchSurroundings, pose_size: int) -> int:
    """``occluders`` of a point cache; how many texels they are."""
    sheet = sheet_nodes(graph, sees, pose_size)
    vertices = Value(graph, sheet.points)
    vertices = vertices - vertices.take([0], 1)
    frames = Value(graph, sheet.axes).take([2, 0], 2)  # [P, R, 2, 3]
    table = Value(graph, patch_table_nodes(graph, sees, vertices.name, sheet.crosses))
    middle, area = table.take([0, 1, 2], 2), table.take([3, 4, 5], 2)  # [P, S + 1, 3]
    scale = 1.0 / sees.size
    parts = [vertices * scale, frames.reshaped(0, -1, 3)]
    middle = middle * scale
    both = graph.node("Concat", middle.name, area.name, axis=2)
    parts.append(Value(graph, graph.reshape(both, [0, -1, 3])))
    whole = Value(graph, graph.node("Concat", *(part.name for part in parts), axis=1))
    nothing = whole.take([0], 2) * 0.0
    graph.node("Concat", whole.name, nothing.name, axis=2, output="occluders")
    return sees.patch.shape[1] + 2 * len(sees.vertex) + 2 * (int(sees.patch.max()) + 2)


def export_occluder_onnx(model: VisibilityModel, path: str | Path) -> None:
    """Write :func:`build_occluder_onnx` to a file, whole or not at all."""
    write_graph(build_occluder_onnx(model), path)
