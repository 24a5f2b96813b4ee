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
from prtnet.features import (
    FULL_FOLD,
    SMALLEST,
    DihedralAngles,
    Features,
    JointAngles,
    LocalJoints,
    Occluders,
)
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


def unit_nodes(graph: GraphBuilder, vectors: str) -> str:
    """Unit vectors of (P, 3, E); a vanishing one stays nearly zero."""
    square = graph.clip(graph.total(graph.node("Mul", vectors, vectors), 1, keep=True), SMALLEST)
    return graph.node("Div", vectors, graph.node("Sqrt", square))


def cross_nodes(graph: GraphBuilder, a: str, b: str) -> str:
    """Cross products of (P, 3, E)."""
    ahead, behind = graph.constant(np.array([1, 2, 0])), graph.constant(np.array([2, 0, 1]))

    def product(first: str, second: str) -> str:
        left = graph.node("Gather", a, first, axis=1)
        return graph.node("Mul", left, graph.node("Gather", b, second, axis=1))

    return graph.node("Sub", product(ahead, behind), product(behind, ahead))


def dihedral_angle_nodes(graph: GraphBuilder, features: DihedralAngles, pose_size: int) -> str:
    """(P, 1, E) 2 sin(θ/2) of every interior edge."""
    points = graph.reshape("pose", [-1, pose_size // 3, 3])
    points = graph.node("Transpose", points, perm=[0, 2, 1])
    start, end, left, right = (
        graph.node("Gather", points, graph.constant(features.edge[:, k]), axis=2) for k in range(4)
    )
    along, left, right = (
        unit_nodes(graph, graph.node("Sub", vertex, start)) for vertex in (end, left, right)
    )
    first = unit_nodes(graph, cross_nodes(graph, along, left))
    second = unit_nodes(graph, cross_nodes(graph, right, along))
    cosine = graph.total(graph.node("Mul", first, second), 1, keep=True)
    sine = graph.node("Mul", cross_nodes(graph, first, second), along)
    two = graph.constant(2.0)
    twice = graph.node("Mul", graph.total(sine, 1, keep=True), two)
    base = graph.clip(graph.node("Add", graph.node("Mul", cosine, two), two), FULL_FOLD)
    return graph.node("Div", twice, graph.node("Sqrt", base))


def local_joint_nodes(graph: GraphBuilder, features: LocalJoints) -> str:
    """(P, C, 3·J) where the joints are in the frame of each cluster's joint."""
    matrices = joint_matrices(graph, features.joints)
    home = graph.node("Gather", matrices, graph.constant(features.cluster_joint), axis=1)
    linear, offset = graph.slice(home, 0, 3, 3), graph.slice(home, 3, 4, 3)
    inverse = graph.node("Div", linear, squared_columns(graph, linear))
    inverse = graph.node("Transpose", inverse, perm=[0, 1, 3, 2])
    places = graph.node("Transpose", graph.slice(matrices, 3, 4, 3), perm=[0, 3, 2, 1])
    away = graph.node("Sub", places, offset)  # [P, C, 3, J]
    local = graph.node("MatMul", inverse, away)
    square = graph.total(graph.node("Mul", local, local), 2, keep=True)
    distance = graph.node("Sqrt", graph.clip(square, SMALLEST))
    reach = graph.constant(features.reach[:, None, None])
    seen = graph.node("Div", local, graph.node("Add", distance, reach))
    return graph.reshape(seen, [-1, len(features.cluster_joint), 3 * features.joints])


def near_nodes(graph: GraphBuilder, features: Occluders) -> tuple[str, str]:
    """The clusters' spheres in their joint's frame, about the mean of their reference points.

    Returns:
        Centres, components leading (P, C, 3, K), and squared radii (P, C, 1, K), in joint units.
    """
    matrices = joint_matrices(graph, features.joints)
    rides, near = graph.constant(features.spheres.joint), graph.constant(features.near)
    centre = np.concatenate([features.spheres.centre, np.ones((len(features.spheres), 1))], 1)
    riding = graph.node("Gather", matrices, rides, axis=1)  # [P, S, 3, 4]
    centres = graph.total(graph.node("Mul", riding, graph.constant(centre[:, None])), 3)
    home = graph.node("Gather", matrices, graph.constant(features.cluster_joint), axis=1)
    linear, offset = graph.slice(home, 0, 3, 3), graph.slice(home, 3, 4, 3)
    radius2 = features.spheres.radius.astype(np.float64) ** 2
    if features.one_scale:
        square = squared_columns(graph, graph.slice(graph.slice(linear, 0, 1, 1), 0, 1, 3))
        own = graph.constant(radius2[features.near][:, None])
    else:
        square = squared_columns(graph, linear)  # [P, C, 1, 3]
        column = graph.slice(matrices, 0, 1, 3)
        scale2 = graph.total(graph.node("Mul", column, column), 2)  # [P, J, 1]
        radii2 = graph.node("Gather", scale2, rides, axis=1)
        radii2 = graph.node("Mul", radii2, graph.constant(radius2[:, None]))
        own = graph.node("Gather", radii2, near, axis=1)
        own = graph.reshape(own, [-1, len(features.near), 1, features.near.shape[1]])
        own = graph.node("Div", own, graph.slice(square, 0, 1, 3))
    inverse = graph.node("Transpose", graph.node("Div", linear, square), perm=[0, 1, 3, 2])
    origin = features.point.mean(axis=1)[..., None]
    shift = graph.node("Add", graph.node("MatMul", inverse, offset), graph.constant(origin))
    columns = graph.node(
        "Transpose", graph.node("Gather", centres, near, axis=1), perm=[0, 1, 3, 2]
    )
    return graph.node("Sub", graph.node("MatMul", inverse, columns), shift), own


QUADRATIC = np.triu_indices(3)  # x², xy, xz, y², yz, z²


def band_map(order: int) -> FloatArray:
    """(order², order²): from 1; x, y, z; the five of :func:`recentred` to 2π y_lm on the sphere."""
    x, y, z = sh.fibonacci_sphere(50).astype(np.float64).T
    parts = [
        np.ones_like(x),
        x,
        y,
        z,
        x * y,
        y * z,
        2 * z * z - x * x - y * y,
        x * z,
        x * x - y * y,
    ]
    raw = np.stack(parts, axis=1)[:, : order**2]
    exact = sh.evaluate(np.stack([x, y, z], axis=1), order)
    return 2.0 * math.pi * np.linalg.lstsq(raw, exact, rcond=None)[0]


def recentred(point: FloatArray) -> FloatArray:
    """(…, 10, 5): from Σw(1; c; c⊗c) to the five harmonic quadratics of Σw(c − p), p (…, 3)."""
    pick = np.zeros((6, 5))  # x², xy, xz, y², yz, z² to xy, yz, 2z² − x² − y², xz, x² − y²
    pick[[1, 4, 2], [0, 1, 3]] = 1.0
    pick[[0, 3, 5], 2] = [-1.0, -1.0, 2.0]
    pick[[0, 3], 4] = [1.0, -1.0]
    left, right = QUADRATIC
    moments = np.zeros((*point.shape[:-1], 10, 6))  # (c − p)(c − p)ᵀ = ccᵀ − cpᵀ − pcᵀ + ppᵀ
    moments[..., 0, :] = point[..., left] * point[..., right]
    for column, (i, j) in enumerate(zip(left, right, strict=True)):
        moments[..., 1 + i, column] -= point[..., j]
        moments[..., 1 + j, column] -= point[..., i]
        moments[..., 4 + column, column] = 1.0
    return moments @ pick


def occluder_nodes(graph: GraphBuilder, features: Occluders) -> str:
    """(P, C, M · order²): for each point Σ w_0, Σ w_1 a, Σ w_2 h(a) over spheres at a from it.

    w_l = I_l / |a|^l, with I_l the cap's integrals, is a function of the squared distance alone,
    which is linear in the monomials of the centre; so are the sums, about the points' mean. Only
    then are they moved to each point: few numbers.
    """
    clusters, points, _ = features.point.shape
    local, radius2 = near_nodes(graph, features)
    left, right = (graph.constant(index) for index in QUADRATIC)
    pair = (graph.node("Gather", local, index, axis=2) for index in (left, right))
    monomials = graph.node("Concat", local, graph.node("Mul", *pair), axis=2)  # [P, C, 9, K]
    point = features.point.astype(np.float64)
    point = point - point.mean(axis=1, keepdims=True)
    to_distance = np.zeros((clusters, points, 9))
    to_distance[..., :3], to_distance[..., [3, 6, 8]] = -2.0 * point, 1.0
    distance2 = graph.node("MatMul", graph.constant(to_distance), monomials)  # [P, C, M, K]
    norm2 = graph.constant((point**2).sum(axis=-1, keepdims=True))
    distance2 = graph.clip(graph.node("Add", distance2, norm2), SMALLEST)
    sine2 = graph.clip(graph.node("Div", radius2, distance2), 0.0, 1.0)
    one = graph.constant(1.0)
    cosine = graph.node("Sqrt", graph.node("Sub", one, sine2))
    bands = [graph.total(graph.node("Sub", one, cosine), 3, keep=True)]  # [P, C, M, 1]
    weights = []  # of I_1 = sin²/2 and I_2 = cos sin²/2
    if features.order > 1:
        half = graph.node("Mul", sine2, graph.constant(0.5))
        weights.append(graph.node("Div", half, graph.node("Sqrt", distance2)))
    if features.order > 2:
        weights.append(graph.node("Div", graph.node("Mul", half, cosine), distance2))
    for degree, weight in enumerate(weights, start=1):
        total = graph.total(weight, 3, keep=True)
        rows = monomials if degree == 2 else local
        sums = graph.node("MatMul", weight, graph.node("Transpose", rows, perm=[0, 1, 3, 2]))
        if degree == 1:
            bands.append(graph.node("Sub", sums, graph.node("Mul", total, graph.constant(point))))
            continue
        moments = graph.node("Concat", total, sums, axis=3)
        moments = graph.reshape(moments, [-1, clusters, points, 1, 10])
        weighed = graph.node("Mul", moments, graph.constant(recentred(point).swapaxes(2, 3)))
        bands.append(graph.total(weighed, 4))
    every = graph.node("Concat", *bands, axis=3) if len(bands) > 1 else bands[0]
    return graph.reshape(every, [-1, clusters, points * features.order**2])


def feature_nodes(graph: GraphBuilder, features: Features, pose_size: int) -> str:
    """(P, 1 or C, F) values, morph weights last; those of Occluders lack :func:`band_map`."""
    if isinstance(features, DihedralAngles):
        return dihedral_angle_nodes(graph, features, pose_size)
    if isinstance(features, JointAngles):
        value, clusters = joint_angle_nodes(graph, features), 1
    elif isinstance(features, LocalJoints):
        value, clusters = local_joint_nodes(graph, features), len(features.cluster_joint)
    elif isinstance(features, Occluders):
        value, clusters = occluder_nodes(graph, features), len(features.near)
    else:
        raise TypeError(f"no ONNX form of {type(features).__name__}")
    morphs = pose_size - 12 * features.joints
    if morphs == 0:
        return value
    weights = graph.slice("pose", 12 * features.joints, pose_size, 1)
    weights = graph.reshape(weights, [-1, 1, morphs])
    copies = graph.node("Mul", weights, graph.constant(np.ones((clusters, 1))))
    return graph.node("Concat", value, copies, axis=2)


def first_layer_nodes(
    graph: GraphBuilder,
    model: VisibilityModel,
    value: str,
    first: FloatArray | None,
    order: IntArray,
) -> str:
    """(P, C, 1, N): features through the input PCA and the first layer, clusters in ``order``.

    Without a first layer these are the reduced inputs, (P, 1 or C, 1, K).
    """
    size = model.input_mean.shape[1]
    mean: FloatArray = model.input_mean.astype(np.float64)
    basis: FloatArray = model.input_basis.astype(np.float64)
    if isinstance(model.features, JointAngles | DihedralAngles):  # the same for all clusters
        value = graph.reshape(value, [-1, 1, 1, size])
        centred = graph.node("Sub", value, graph.constant(mean[0]))
        reduced = graph.node("MatMul", centred, graph.constant(basis[0]))
        return (
            reduced
            if first is None
            else graph.node("MatMul", reduced, graph.constant(first[order]))
        )
    # Everything linear in a cluster's features is one matrix.
    linear: FloatArray = np.eye(size)
    if isinstance(model.features, Occluders):
        caps = model.features.point.shape[1] * model.features.order**2
        bands = band_map(model.features.order)
        linear[:caps, :caps] = np.kron(np.eye(model.features.point.shape[1]), bands)
    value = graph.reshape(value, [-1, len(order), 1, size])
    if not np.array_equal(order, np.arange(len(order))):
        value = graph.node("Gather", value, graph.constant(order), axis=1)
    mean = np.linalg.solve(linear.T, mean[order][..., None])[..., 0]
    centred = graph.node("Sub", value, graph.constant(mean[:, None]))
    weight = linear @ basis[order]
    if first is not None:
        weight = weight @ first[order]
    return graph.node("MatMul", centred, graph.constant(weight))


def regressor_nodes(
    graph: GraphBuilder, model: VisibilityModel, value: str, order: IntArray
) -> tuple[str, FloatArray]:
    """What the last layer sees of the features, (P, C, 1, N), and that layer's weights (C, N, L).

    Of a layer without a hidden one before it nothing is left but the unit matrix.
    """
    regressor = model.regressor
    weight: FloatArray = regressor.weight.astype(np.float64)
    if regressor.hidden_weight is not None and regressor.hidden_bias is not None:
        hidden: FloatArray = regressor.hidden_weight.astype(np.float64)
        value = first_layer_nodes(graph, model, value, hidden, order)
        shift = graph.constant(regressor.hidden_bias[order][:, None])
        return graph.node("Tanh", graph.node("Add", value, shift)), weight
    if regressor.pairs is None:
        value = first_layer_nodes(graph, model, value, weight, order)
    else:
        reduced = first_layer_nodes(graph, model, value, None, order)
        pair = (graph.node("Gather", reduced, graph.constant(k), axis=3) for k in regressor.pairs)
        every = graph.node("Concat", reduced, graph.node("Mul", *pair), axis=3)
        value = graph.node("MatMul", every, graph.constant(weight[order]))
    return value, np.broadcast_to(np.eye(weight.shape[2]), (len(order), *2 * weight.shape[2:]))


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
    """The model as a checked graph: ``pose`` (poses, D) in, ``visibility`` (poses, V, n²) out."""
    graph = GraphBuilder()
    order = np.argsort(model.latents, kind="stable")
    value = feature_nodes(graph, model.features, model.pose_size)
    value, weight = regressor_nodes(graph, model, value, order)
    reconstruction_nodes(graph, model, value, weight, model.regressor.bias, order)
    shape = [model.receiver_count, model.order**2]
    return graph.model(model.pose_size, shape, {"prtnet": "visibility", "kind": model.kind})


def export_onnx(model: VisibilityModel, path: str | Path) -> None:
    """Write :func:`build_onnx` to a file, whole or not at all."""
    proto = build_onnx(model)
    with writing(path) as partial:
        onnx.save(proto, partial)
