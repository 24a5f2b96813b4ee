"""Fitted models as ONNX: features, regressor and reconstruction in one graph of portable operators.

Every node mirrors a line of the NumPy reference (:mod:`prtnet.features`, :mod:`prtnet.model`).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import onnx

from prtnet import sh
from prtnet.arrays import FloatArray
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
from prtnet.model import Regressor, VisibilityModel
from prtnet.storage import Stored
from training.awake import awake, awake_clusters
from training.clamping import UnitBox, clamp_nodes, from_unit_nodes, unit_box
from training.onnx_components import matrix_nodes
from training.onnx_expression import Value, cross, dot, unit
from training.onnx_graph import GraphBuilder
from training.onnx_prior import prior_nodes
from training.reconstruction import (
    LatentLayer,
    Places,
    latent_layer,
    mean_nodes,
    visibility_nodes,
)

__all__ = ["build_latent_onnx", "build_onnx", "export_latent_onnx", "export_onnx", "write_graph"]


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
    child = graph.node("Gather", rotation, graph.index(features.joint), axis=1)
    above = graph.index(np.maximum(features.parent, 0))
    has_parent = (features.parent >= 0)[:, None, None].astype(np.float32)
    parent = graph.node("Gather", rotation, above, axis=1)
    parent = graph.node("Mul", parent, graph.constant(has_parent))
    parent = graph.node("Add", parent, graph.constant((1.0 - has_parent) * np.eye(3)))
    local = graph.node("MatMul", graph.node("Transpose", parent, perm=[0, 1, 3, 2]), child)
    return graph.reshape(graph.slice(local, 0, 2, 3), [-1, 1, 6 * len(features.joint)])


def dihedral_angle_nodes(graph: GraphBuilder, features: DihedralAngles, pose_size: int) -> str:
    """(P, 1, E) 2 sin(θ/2) of every interior edge."""
    points = graph.reshape("pose", [-1, pose_size // 3, 3])
    every = Value(graph, graph.node("Transpose", points, perm=[0, 2, 1]))
    start, *others = (every.take(features.edge[:, k], 2) for k in range(4))
    along, left, right = (unit(vertex - start, SMALLEST) for vertex in others)
    first = unit(cross(along, left), SMALLEST)
    second = unit(cross(right, along), SMALLEST)
    twice = dot(cross(first, second), along) * 2.0
    base = (dot(first, second) * 2.0 + 2.0).clip(FULL_FOLD)
    return (twice / base.sqrt()).name


def local_joint_nodes(graph: GraphBuilder, features: LocalJoints) -> str:
    """(P, C, 3·J) where the joints are in the frame of each cluster's joint."""
    matrices = joint_matrices(graph, features.joints)
    home = graph.node("Gather", matrices, graph.index(features.cluster_joint), axis=1)
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
    rides, near = graph.index(features.spheres.joint), graph.index(features.near)
    centre = np.concatenate([features.spheres.centre, np.ones((len(features.spheres), 1))], 1)
    riding = graph.node("Gather", matrices, rides, axis=1)  # [P, S, 3, 4]
    centres = graph.total(graph.node("Mul", riding, graph.constant(centre[:, None])), 3)
    home = graph.node("Gather", matrices, graph.index(features.cluster_joint), axis=1)
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


RAW = {1: 1, 2: 5, 3: 15}  # numbers a point, by order
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
    """(P, C, M · RAW): for each point Σ w_0, Σ w_1 (1; c), Σ w_2 (1; c; c⊗c) over spheres at c.

    w_l = I_l / |a|^l, with I_l the cap's integrals and a from the point to the centre, is a
    function of the squared distance alone, which is linear in the monomials of the centre about
    the points' mean. Moving the sums to each point is linear: see :func:`harmonics`.
    """
    clusters, points, _ = features.point.shape
    local, radius2 = near_nodes(graph, features)
    left, right = (graph.index(index) for index in QUADRATIC)
    pair = (graph.node("Gather", local, index, axis=2) for index in (left, right))
    monomials = graph.node("Concat", local, graph.node("Mul", *pair), axis=2)  # [P, C, 9, K]
    point = centred_points(features)
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
        rows = monomials if degree == 2 else local
        sums = graph.node("MatMul", weight, graph.node("Transpose", rows, perm=[0, 1, 3, 2]))
        bands += [graph.total(weight, 3, keep=True), sums]
    every = graph.node("Concat", *bands, axis=3) if len(bands) > 1 else bands[0]
    return graph.reshape(every, [-1, clusters, points * RAW[features.order]])


def centred_points(features: Occluders) -> FloatArray:
    """Each cluster's reference points about their mean, (C, M, 3)."""
    point = features.point.astype(np.float64)
    return point - point.mean(axis=1, keepdims=True)


def harmonics(point: FloatArray, order: int) -> FloatArray:
    """(…, RAW, order²): what :func:`occluder_nodes` gives of points (…, 3), to their features."""
    moved = np.zeros((*point.shape[:-1], RAW[order], order**2))
    moved[..., 0, 0] = 1.0
    if order > 1:
        moved[..., 1, 1:4] = -point
        moved[..., 2:5, 1:4] = np.eye(3)
    if order > 2:
        moved[..., 5:, 4:] = recentred(point)
    return moved @ band_map(order)


def monomials(point: FloatArray) -> FloatArray:
    """(…, 10): 1; x, y, z; x², xy, xz, y², yz, z² of points (…, 3)."""
    left, right = QUADRATIC
    ones = np.ones_like(point[..., :1])
    return np.concatenate([ones, point, point[..., left] * point[..., right]], axis=-1)


def harmonic_nodes(graph: GraphBuilder, features: Occluders) -> str:
    """(C, M, RAW, order²) :func:`harmonics`, which are linear in the points' monomials."""
    point, order = centred_points(features), features.order
    probes = np.concatenate([np.zeros((1, 3)), sh.fibonacci_sphere(20), 2 * np.eye(3)])
    exact = harmonics(probes, order).reshape(len(probes), -1)
    table = np.linalg.lstsq(monomials(probes), exact, rcond=None)[0]  # [10, RAW · order²]
    flat = graph.constant(monomials(point).reshape(-1, len(table)))
    value = graph.node("MatMul", flat, graph.constant(table))
    return graph.reshape(value, [*point.shape[:2], RAW[order], order**2])


def feature_nodes(graph: GraphBuilder, features: Features, pose_size: int) -> str:
    """(P, 1 or C, F) values, morph weights last; those of Occluders lack :func:`harmonics`."""
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


def linear_nodes(
    graph: GraphBuilder, model: VisibilityModel, value: str, after: Stored | UnitBox,
    bias: FloatArray,
) -> str:  # fmt: skip
    """(P, 1 or C, 1, N): features through the input PCA, what comes after it, and a bias.

    Args:
        graph: with the features.
        model: of the PCA.
        value: the features.
        after: one more matrix (1 or C, K, N), or what makes units of the box.
        bias: (1 or C, 1, N).
    """
    size = model.input_mean.shape[1]
    mean: FloatArray = model.input_mean.astype(np.float64)[:, None]
    basis = model.stored("input_basis")
    if isinstance(after, Stored) and len(mean) < len(after.values):  # for all clusters: once
        value = graph.reshape(value, [-1, 1, 1, size])
        centred = graph.node("Sub", value, graph.constant(mean[0]))
        reduced = graph.node("MatMul", centred, graph.stored(basis))
        value = graph.node("MatMul", reduced, matrix_nodes(graph, after))
        return graph.node("Add", value, graph.constant(bias))
    # Everything linear in a cluster's features is one matrix, everything constant its bias.
    product = first_matrix(graph, model.features, basis, after)
    bias = bias - mean @ through(basis.array().astype(np.float64), after)
    if isinstance(model.features, Occluders):
        order, points = model.features.order, model.features.point.shape[1]
        size += points * (RAW[order] - order**2)
    value = graph.reshape(value, [-1, len(mean), 1, size])
    return graph.node("Add", graph.node("MatMul", value, product), graph.constant(bias))


def through(matrix: FloatArray, after: Stored | UnitBox) -> FloatArray:
    """A matrix (1 or C, F, K) and what comes after it as one, (1 or C, F, N)."""
    return after.units(matrix) if isinstance(after, UnitBox) else matrix @ after.array()


def through_nodes(graph: GraphBuilder, matrix: str, after: Stored | UnitBox) -> str:
    """The same as nodes."""
    if isinstance(after, UnitBox):
        return after.unit_nodes(graph, matrix)
    return graph.node("MatMul", matrix, matrix_nodes(graph, after))


def first_matrix(
    graph: GraphBuilder, features: Features, basis: Stored, after: Stored | UnitBox
) -> str:
    """(1 or C, F, N): from :func:`feature_nodes` through the PCA and what comes after it."""
    exact = basis.values.dtype == np.float32  # multiplied here, in double precision
    every = basis.values.astype(np.float64) if exact else None
    if not isinstance(features, Occluders):
        if every is not None:
            return graph.constant(through(every, after))
        return through_nodes(graph, matrix_nodes(graph, basis), after)
    clusters, points, _ = features.point.shape
    shape = (clusters, points, features.order**2, basis.values.shape[-1])
    caps = points * features.order**2
    if every is not None:
        to_features = harmonics(centred_points(features), features.order)
        moved = (to_features @ every[:, :caps].reshape(shape)).reshape(clusters, -1, shape[-1])
        return graph.constant(through(np.concatenate([moved, every[:, caps:]], axis=1), after))
    stored = matrix_nodes(graph, basis)
    own = graph.reshape(graph.slice(stored, 0, caps, 1), shape)
    own = graph.node("MatMul", harmonic_nodes(graph, features), own)
    own = graph.reshape(own, [clusters, -1, shape[-1]])
    if basis.values.shape[1] > caps:
        morphs = graph.slice(stored, caps, basis.values.shape[1], 1)
        own = graph.node("Concat", own, morphs, axis=1)
    return through_nodes(graph, own, after)


def first_layer(model: VisibilityModel) -> tuple[Stored, FloatArray] | None:
    """Matrix (1 or C, K, N) and bias (1 or C, 1, N) of what :func:`bend_nodes` takes, if anything.

    A quadratic regressor multiplies the reduced inputs as they are.
    """
    regressor = model.regressor
    if regressor.hidden_bias is not None:
        return model.stored("regressor.hidden_weight"), regressor.hidden_bias[:, None]
    if regressor.pairs is None:
        return None
    inputs = model.input_basis.shape[2]
    same = np.eye(inputs, dtype=np.float32)[None]
    return Stored(same, np.ones((1, 1, 1), dtype=np.float32)), np.zeros((1, 1, inputs))


def bend_nodes(graph: GraphBuilder, regressor: Regressor, value: str) -> str:
    """What the last layer sees, (P, 1 or C, 1, N): tanh, or inputs with their products behind."""
    if regressor.pairs is None:
        return graph.node("Tanh", value)
    pair = (graph.node("Gather", value, graph.index(k), axis=3) for k in regressor.pairs)
    return graph.node("Concat", value, graph.node("Mul", *pair), axis=3)


def latent_nodes(graph: GraphBuilder, model: VisibilityModel, layer: LatentLayer) -> str:
    """(P, C · M) every cluster's latents, of the pose; what is one does not fade."""
    clamped = model.input_low is not None and model.input_high is not None
    last_bias = layer.bias if clamped else layer.bias + layer.ones
    weight, bias = first_layer(model) or (layer.weight, last_bias)
    value = feature_nodes(graph, model.features, model.pose_size)
    damping = None
    if model.input_low is None or model.input_high is None:
        value = linear_nodes(graph, model, value, weight, bias)
    else:
        box = unit_box(model.input_low, model.input_high)
        value = linear_nodes(graph, model, value, box, box.bias)
        value, damping = clamp_nodes(graph, box, value)
        value = graph.node("MatMul", value, from_unit_nodes(graph, box, weight, bias))
    if weight is not layer.weight:
        value = bend_nodes(graph, model.regressor, value)
        last = matrix_nodes(graph, layer.weight, model.neurons)
        value = graph.node("MatMul", value, last)
        value = graph.node("Add", value, graph.constant(last_bias))
    if damping is not None:
        value = graph.node("Add", graph.node("Div", value, damping), graph.constant(layer.ones))
    return graph.reshape(value, [-1, layer.bias.size])


def all_latent_nodes(graph: GraphBuilder, model: VisibilityModel) -> tuple[str, Places]:
    """Flat latents (P, …) of the clusters that have any, and where in them those of groups are."""
    clusters = awake_clusters(model)
    own = awake(model, clusters)
    layer = latent_layer(own)
    first = np.zeros(len(model.latents), dtype=np.int64)
    first.reshape(-1, model.parts)[clusters] = layer.first.reshape(-1, model.parts)
    return latent_nodes(graph, own, layer), Places(first, layer.one)


def build_onnx(model: VisibilityModel) -> onnx.ModelProto:
    """The model as a checked graph: ``pose`` (poses, D) in, ``visibility`` (poses, V, n²) out."""
    graph = GraphBuilder()
    prior = None
    if model.prior is not None:

        def stored(name: str) -> Stored:
            return model.stored(f"prior.{name}")

        prior = prior_nodes(graph, model.prior, stored, model.pose_size)
    if model.latents.sum() > 0:
        visibility_nodes(graph, model, *all_latent_nodes(graph, model), prior)
    else:
        mean_nodes(graph, model, prior)
    shape = [model.receiver_count, model.order**2]
    return graph.model(
        model.pose_size, "visibility", shape, {"prtnet": "visibility", "kind": model.kind}
    )


def build_latent_onnx(model: VisibilityModel, scale: FloatArray) -> onnx.ModelProto:
    """A checked graph of the latents alone: ``pose`` (poses, D) in, ``latents`` (poses, Σ) out.

    Args:
        model: with at least one latent.
        scale: each latent is multiplied by it, (Σ latents,).
    """
    graph = GraphBuilder()
    flat, places = all_latent_nodes(graph, model)
    own = [first + np.arange(n) for first, n in zip(places.first, model.latents, strict=True)]
    value = graph.node("Gather", flat, graph.index(np.concatenate(own)), axis=1)
    graph.node("Mul", value, graph.constant(scale), output="latents")
    return graph.model(
        model.pose_size, "latents", [len(scale)], {"prtnet": "latents", "kind": model.kind}
    )


def export_onnx(model: VisibilityModel, path: str | Path) -> None:
    """Write :func:`build_onnx` to a file, whole or not at all."""
    write_graph(build_onnx(model), path)


def export_latent_onnx(model: VisibilityModel, scale: FloatArray, path: str | Path) -> None:
    """Write :func:`build_latent_onnx` to a file, whole or not at all."""
    write_graph(build_latent_onnx(model, scale), path)


def write_graph(proto: onnx.ModelProto, path: str | Path) -> None:
    """Write a graph to a file, whole or not at all."""
    with writing(path) as partial:
        onnx.save(proto, partial)
