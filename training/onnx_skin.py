"""What each receiver of a skinned mesh sees, as nodes: the twin of ``SkinSurroundings``.

Receivers stand in slots, cluster by cluster, (C, R): all of a cluster look at the same occluders,
which are gathered once for all of them.
"""

from __future__ import annotations

import math

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.surroundings import SMALLEST
from training.onnx_caps import cap_sum_nodes
from training.onnx_expression import Value, cross, dot, unit
from training.onnx_graph import GraphBuilder

__all__ = ["Carried", "carry_nodes", "cluster_slots", "skin_nodes"]

STEEP = 1e30  # what makes a sign of a number


def cluster_slots(cluster: IntArray) -> IntArray:
    """Receivers of each cluster, (C, R); the first of a cluster fills its empty slots."""
    count = np.bincount(cluster)
    order = np.argsort(cluster, kind="stable")
    starts = np.cumsum(count) - count
    rank = np.arange(count.max())[None]
    return order[starts[:, None] + np.where(rank < count[:, None], rank, 0)]


class Carried:
    """Points carried by joints: columns of their blended matrices, (P, 3, N) each."""

    def __init__(self, carry: Value, joint: IntArray, weight: FloatArray | None = None) -> None:
        matrices = carry.take(joint[:, 0] if joint.ndim > 1 else joint, 1)  # [P, N, 12]
        if weight is not None:
            matrices = matrices * weight[:, :1]
            for slot in range(1, joint.shape[1]):
                matrices = matrices + carry.take(joint[:, slot], 1) * weight[:, slot : slot + 1]
        graph = carry.graph
        self.rows = Value(graph, graph.node("Transpose", matrices.name, perm=[0, 2, 1]))
        self.a, self.b, self.c, self.offset = (
            self.rows.take([column, column + 4, column + 8], 1) for column in range(4)
        )

    def point(self, at: FloatArray) -> Value:
        """Places (P, 3, N) of points (N, 3)."""
        return self.vector(at) + self.offset

    def vector(self, along: FloatArray) -> Value:
        """Vectors (P, 3, N) of vectors (N, 3)."""
        x, y, z = along.T
        return self.a * x + self.b * y + self.c * z

    def area(self, along: FloatArray) -> Value:
        """Vector areas (P, 3, N) of vector areas (N, 3), by the cofactor matrix."""
        x, y, z = along.T
        a, b, c = self.a, self.b, self.c
        return cross(b, c) * x + cross(c, a) * y + cross(a, b) * z

    def scale2(self) -> Value:
        """Mean squared scale (P, 1, N)."""
        linear = self.rows.take([0, 1, 2, 4, 5, 6, 8, 9, 10], 1)
        return dot(linear, linear) * (1.0 / 3.0)


def carry_nodes(graph: GraphBuilder, sees: SkinSurroundings) -> Value:
    """(P, J, 12) matrices that carry points from rest, about joint 0."""
    head = graph.slice("pose", 0, 12 * sees.joints, 1)
    matrices = graph.reshape(head, [-1, sees.joints, 3, 4])
    linear, offset = graph.slice(matrices, 0, 3, 3), Value(graph, graph.slice(matrices, 3, 4, 3))
    offset = (offset - offset.take([0], 1)) * (1.0 / sees.size)
    inverse = sees.rest_inverse
    turned = graph.node("MatMul", linear, graph.constant(inverse[..., :3]))
    moved = Value(graph, graph.node("MatMul", linear, graph.constant(inverse[..., 3:]))) + offset
    whole = graph.node("Concat", turned, moved.name, axis=3)
    return Value(graph, graph.reshape(whole, [-1, sees.joints, 12]))


def skin_nodes(graph: GraphBuilder, sees: SkinSurroundings) -> str:
    """Features (P, C, R, F) of the receivers in :func:`cluster_slots`."""
    carry = carry_nodes(graph, sees)
    slots = cluster_slots(sees.cluster)
    shape = (-1, 3, *slots.shape, 1)
    own = slots.ravel()
    receivers = Carried(carry, sees.skin_joint[own], sees.skin_weight[own])
    normal = unit(receivers.area(sees.normal[own]), SMALLEST)
    tangent = receivers.vector(sees.tangent[own])
    tangent = unit(tangent - dot(tangent, normal) * normal, SMALLEST)
    axes = [v.reshaped(*shape) for v in (tangent, cross(normal, tangent), normal)]
    place = receivers.point(sees.position[own]).reshaped(*shape)

    def steps(centre: Value, near: IntArray) -> Value:
        """(P, 3, C, R, K) from receivers to the occluders near their cluster."""
        clusters, count = near.shape
        return centre.take(near, 2).reshaped(-1, 3, clusters, 1, count) - place

    def flat(value: Value, near: IntArray) -> Value:
        """(P, C, R or 1, K) of (P, 1, C, R or 1, K)."""
        return value.reshaped(-1, near.shape[0], slots.shape[1], near.shape[1])

    def local(step: Value, distance: Value, near: IntArray) -> list[Value]:
        return [flat(dot(step, axis), near) / distance for axis in axes]

    near = sees.near_spheres
    spheres = Carried(carry, sees.sphere_joint)
    step = steps(spheres.point(sees.sphere_centre), near)
    distance2 = flat(dot(step, step), near).clip(SMALLEST)
    radius2 = spheres.scale2() * (sees.sphere_radius.astype(np.float64) ** 2)
    radius2 = radius2.take(near, 2).reshaped(-1, near.shape[0], 1, near.shape[1])
    sine2 = (radius2 / distance2).clip(0.0, 1.0)
    home = sees.own_sphere[:, None]
    sums = cap_sum_nodes(local(step, distance2.sqrt(), near), sine2, (1.0 - home, home), sees.order)

    near = sees.near_patches
    patches = Carried(carry, sees.patch_joint, sees.patch_weight)
    step = steps(patches.point(sees.patch_centre), near)
    distance2 = flat(dot(step, step), near).clip(SMALLEST)
    distance = distance2.sqrt()
    area = patches.area(sees.patch_area).take(near, 2)
    area = area.reshaped(-1, 3, near.shape[0], 1, near.shape[1])
    facing = flat(dot(area, step), near) / distance * -1.0
    seen = facing.magnitude()
    sine2 = seen / (distance2 * math.pi + seen)
    # One where the outside is seen, zero where the inside is.
    outside = (facing * STEEP).clip(0.0, 1.0)
    sums += cap_sum_nodes(local(step, distance, near), sine2, (outside, 1.0 - outside), sees.order)
    return graph.node("Concat", *(value.name for value in sums), axis=3)
