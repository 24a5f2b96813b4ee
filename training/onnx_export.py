"""Fitted models as ONNX: features, regressor and reconstruction in one graph of portable operators.

Every node mirrors a line of the NumPy reference (:mod:`prtnet.features`, :mod:`prtnet.model`).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import onnx

from prtnet import sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.features import SMALLEST, Features, JointAngles, Occluders
from prtnet.files import writing
from prtnet.model import VisibilityModel
from training.onnx_graph import GraphBuilder

__all__ = ["build_onnx", "export_onnx"]


def joint_matrices(graph: GraphBuilder, joints: int) -> str:
    """(P, J, 3, 4) matrices at the head of the pose."""
    return graph.reshape(graph.slice("pose", 0, 12 * joints, 1), [-1, joints, 3, 4])


def squared_columns(graph: GraphBuilder, linear: str) -> str:
    """Squared lengths (…, 1, 3) of the columns of (…, 3, 3), not below SMALLEST."""
    return graph.clip(graph.total(graph.node("Mul", linear, linear), 2, keep=True), SMALLEST)


def joint_angle_nodes(graph: GraphBuilder, features: JointAngles) -> str:
    """(P, 1, 6·A) columns of the moving joints' local rotations."""
    matrices = joint_matrices(graph, features.joints)
    linear = graph.slice(matrices, 0, 3, 3)
    rotation = graph.node("Div", linear, graph.node("Sqrt", squared_columns(graph, linear)))
    child = graph.node("Gather", rotation, graph.constant(features.joint), axis=1)
    above = graph.constant(np.maximum(features.parent, 0))
    has_parent = (features.parent >= 0)[:, None, None].astype(np.float32)
    parent = graph.node("Gather", rotation, above, axis=1)
    parent = graph.node("Mul", parent, graph.constant(has_parent))
    parent = graph.node("Add", parent, graph.constant((1.0 - has_parent) * np.eye(3)))
    local = graph.node("MatMul", graph.node("Transpose", parent, perm=[0, 1, 3, 2]), child)
    return graph.reshape(graph.slice(local, 0, 2, 3), [-1, 1, 6 * len(features.joint)])


def cap_moment_map(order: int) -> FloatArray:
    """Constant (1 + 126, order²) from the moments of :func:`occluder_nodes` to SH coefficients.

    The moments are Σ I_0, then the table of Σ r(k) m(k) for the rows r = I_1, I_2, I_3 q, I_4 q
    and the columns m = u, q over all spheres k, where u is the direction and q its six quadratic
    monomials. Band l is a homogeneous polynomial of degree l: its coefficients on the monomials
    1, u, q, q ⊗ u, q ⊗ q are found by least squares over directions.
    """
    u = sh.fibonacci_sphere(200).astype(np.float64)
    basis = sh.evaluate(u, order)
    q = u[:, QUADRATIC[0]] * u[:, QUADRATIC[1]]
    cubic, quartic = q[:, :, None] * u[:, None], q[:, :, None] * q[:, None]
    exact = [np.ones((len(u), 1)), u, q, cubic.reshape(len(u), -1), quartic.reshape(len(u), -1)]
    cell = 1 + np.arange(14 * 9).reshape(14, 9)
    rows = [np.array([0]), cell[0, :3], cell[1, 3:], cell[2:8, :3].ravel(), cell[8:, 3:].ravel()]
    result = np.zeros((1 + cell.size, order**2))
    for degree in range(order):
        band = slice(degree**2, (degree + 1) ** 2)
        solution = np.linalg.lstsq(exact[degree], basis[:, band], rcond=None)[0]
        result[rows[degree], band] = 2.0 * math.pi * solution
    return result


QUADRATIC = np.triu_indices(3)  # x², xy, xz, y², yz, z²


def seen_nodes(graph: GraphBuilder, features: Occluders) -> tuple[str, str]:
    """Each sphere's sin² of the cap (P, C, M·K) and direction (P, C, M·K, 3)."""
    clusters, points, near = features.near.shape
    matrices = joint_matrices(graph, features.joints)
    riding = graph.node("Gather", matrices, graph.constant(features.spheres.joint), axis=1)
    centre = np.concatenate([features.spheres.centre, np.ones((len(features.spheres), 1))], 1)
    centres = graph.total(graph.node("Mul", riding, graph.constant(centre[:, None])), 3)
    first_column = graph.slice(riding, 0, 1, 3)  # [P, S, 3, 1]
    scale2 = graph.total(graph.node("Mul", first_column, first_column), 2)  # [P, S, 1]
    radius2 = graph.node(
        "Mul", scale2, graph.constant(features.spheres.radius.astype(np.float64)[:, None] ** 2)
    )
    home = graph.node("Gather", matrices, graph.constant(features.cluster_joint), axis=1)
    linear = graph.slice(home, 0, 3, 3)
    square = squared_columns(graph, linear)  # [P, C, 1, 3]
    inverse = graph.node("Div", linear, square)
    offset = graph.reshape(graph.slice(home, 3, 4, 3), [-1, clusters, 1, 3])
    flat = graph.constant(features.near.reshape(clusters, -1))
    away = graph.node("Sub", graph.node("Gather", centres, flat, axis=1), offset)
    point = np.repeat(features.point, near, axis=1)  # [C, M·K, 3]
    local = graph.node("Sub", graph.node("MatMul", away, inverse), graph.constant(point))
    distance2 = graph.clip(
        graph.total(graph.node("Mul", local, local), 3, keep=True), SMALLEST
    )  # [P, C, M·K, 1]
    own = graph.node("Gather", radius2, flat, axis=1)  # [P, C, M·K, 1]
    own = graph.node("Div", own, graph.slice(square, 0, 1, 3))
    sine2 = graph.clip(graph.node("Div", own, distance2), 0.0, 1.0)
    direction = graph.node("Div", local, graph.node("Sqrt", distance2))
    shape = [-1, clusters, points, near]
    return graph.reshape(sine2, [*shape[:3], 1, near]), graph.reshape(direction, [*shape, 3])


def occluder_nodes(graph: GraphBuilder, features: Occluders) -> str:
    """(P, C, M · order²) summed SH of the caps."""
    clusters, points, _ = features.near.shape
    sine2, direction = seen_nodes(graph, features)  # [P, C, M, 1, K], [P, C, M, K, 3]
    one = graph.constant(1.0)
    cosine = graph.node("Sqrt", graph.node("Sub", one, sine2))
    across = graph.node("Mul", sine2, graph.constant(0.5))  # I_1
    along = graph.node("Mul", across, cosine)  # I_2
    # I_3 = I_1 (4 − 5 sin²) / 4 and I_4 = I_2 (4 − 7 sin²) / 4
    third = graph.node("Sub", one, graph.node("Mul", sine2, graph.constant(1.25)))
    fourth = graph.node("Sub", one, graph.node("Mul", sine2, graph.constant(1.75)))
    component = graph.node("Transpose", direction, perm=[0, 1, 2, 4, 3])  # [P, C, M, 3, K]
    left, right = (graph.constant(np.asarray(index)) for index in QUADRATIC)
    quadratic = graph.node(
        "Mul",
        graph.node("Gather", component, left, axis=3),
        graph.node("Gather", component, right, axis=3),
    )
    rows = graph.node(
        "Concat",
        across,
        along,
        graph.node("Mul", quadratic, graph.node("Mul", across, third)),
        graph.node("Mul", quadratic, graph.node("Mul", along, fourth)),
        axis=3,
    )  # [P, C, M, 14, K]
    columns = graph.node("Concat", component, quadratic, axis=3)  # [P, C, M, 9, K]
    columns = graph.node("Transpose", columns, perm=[0, 1, 2, 4, 3])
    table = graph.reshape(graph.node("MatMul", rows, columns), [-1, clusters, points, 126])
    zeroth = graph.total(graph.node("Sub", one, cosine), 4)  # [P, C, M, 1]
    moments = graph.node("Concat", zeroth, table, axis=3)
    caps = graph.node("MatMul", moments, graph.constant(cap_moment_map(features.order)))
    return graph.reshape(caps, [-1, clusters, points * features.order**2])


def feature_nodes(graph: GraphBuilder, features: Features, pose_size: int) -> str:
    """(P, 1 or C, F) features, morph weights last."""
    if isinstance(features, JointAngles):
        value, clusters, joints = joint_angle_nodes(graph, features), 1, features.joints
    elif isinstance(features, Occluders):
        value, clusters = occluder_nodes(graph, features), len(features.near)
        joints = features.joints
    else:
        raise TypeError(f"no ONNX form of {type(features).__name__}")
    morphs = pose_size - 12 * joints
    if morphs == 0:
        return value
    weights = graph.reshape(graph.slice("pose", 12 * joints, pose_size, 1), [-1, 1, morphs])
    copies = graph.node("Mul", weights, graph.constant(np.ones((clusters, 1))))
    return graph.node("Concat", value, copies, axis=2)


def reconstruction_nodes(
    graph: GraphBuilder,
    model: VisibilityModel,
    value: str,
    weight: FloatArray,
    bias: FloatArray,
    order: IntArray,
) -> None:
    """From the last layer's inputs (P, C, 1, N), clusters in ``order``, to ``visibility``.

    Clusters of equally many latents form one batched product. A last latent that is always one
    carries the mean.
    """
    counts = model.latents[order]
    starts = np.concatenate([[0], np.cumsum(model.latents)])
    parts = []
    for count in np.unique(counts):
        inside = np.flatnonzero(counts == count)  # contiguous: ``order`` sorts by count
        clusters = order[inside]
        own = value
        if len(inside) < len(order):
            own = graph.slice(value, int(inside[0]), int(inside[-1]) + 1, 1)
        to_latent = np.zeros((len(clusters), weight.shape[1], count + 1))
        to_latent[..., :count] = weight[clusters, :, :count]
        shift = np.ones((len(clusters), 1, count + 1))
        shift[:, 0, :count] = bias[clusters, :count]
        latent = graph.node("MatMul", own, graph.constant(to_latent))
        latent = graph.node("Add", latent, graph.constant(shift))
        basis = np.stack(
            [
                np.concatenate([model.basis[starts[c] : starts[c] + count], model.mean[c : c + 1]])
                for c in clusters
            ]
        )
        slots = graph.node("MatMul", latent, graph.constant(basis))
        size = len(clusters) * model.receivers.shape[1]
        parts.append(graph.reshape(slots, [-1, size, model.order**2]))
    every = parts[0] if len(parts) == 1 else graph.node("Concat", *parts, axis=1)
    position = np.empty_like(order)
    position[order] = np.arange(len(order))
    cluster, slot = np.divmod(model.slot_of_receiver, model.receivers.shape[1])
    index = position[cluster] * model.receivers.shape[1] + slot
    graph.node("Gather", every, graph.constant(index), axis=1, output="visibility")


def build_onnx(model: VisibilityModel) -> onnx.ModelProto:
    """The model as a checked ONNX graph: ``pose`` (poses, D) in, ``visibility`` (poses, V, n²) out.

    The input PCA is multiplied into the first layer in float64, where that makes it smaller.
    """
    graph = GraphBuilder()
    order = np.argsort(model.latents, kind="stable")
    value = feature_nodes(graph, model.features, model.pose_size)
    regressor = model.regressor

    def by_cluster(array: FloatArray) -> FloatArray:
        return np.broadcast_to(array.astype(np.float64), (len(order), *array.shape[1:]))[order]

    clusters = 1 if isinstance(model.features, JointAngles) else len(order)
    value = graph.reshape(value, [-1, clusters, 1, model.input_mean.shape[1]])
    if clusters > 1 and not np.array_equal(order, np.arange(len(order))):
        value = graph.node("Gather", value, graph.constant(order), axis=1)
    mean, basis = by_cluster(model.input_mean)[:, None], by_cluster(model.input_basis)
    centred = graph.node("Sub", value, graph.constant(mean))
    first = regressor.weight if regressor.hidden_weight is None else regressor.hidden_weight
    value = graph.node("MatMul", centred, graph.constant(basis @ by_cluster(first)))
    weight, bias = regressor.weight, regressor.bias
    if regressor.hidden_weight is not None and regressor.hidden_bias is not None:
        shift = by_cluster(regressor.hidden_bias)[:, None]
        value = graph.node("Tanh", graph.node("Add", value, graph.constant(shift)))
    else:  # the latents are there already
        weight = np.broadcast_to(np.eye(weight.shape[2]), (len(order), *2 * weight.shape[2:]))
    reconstruction_nodes(graph, model, value, weight, bias, order)
    shape = [model.receiver_count, model.order**2]
    return graph.model(model.pose_size, shape, {"prtnet": "visibility", "kind": model.kind})


def export_onnx(model: VisibilityModel, path: str | Path) -> None:
    """Write :func:`build_onnx` to a file, whole or not at all."""
    proto = build_onnx(model)
    with writing(path) as partial:
        onnx.save(proto, partial)
