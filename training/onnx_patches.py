"""Surroundings of a point cache's receivers as ONNX nodes: ``prtnet.patches``, line for line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from prtnet import sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.patches import SMALLEST, PatchSurroundings, flipped
from prtnet.surroundings import SOFTEST
from training.onnx_expression import Value, cross, dot, unit
from training.onnx_graph import GraphBuilder

__all__ = ["Sheet", "padded_rows", "patch_nodes", "patch_table_nodes", "sheet_nodes"]

SQUARES = np.triu_indices(3)  # x², xy, xz, y², yz, z²
CUBES = ((0, 0, 0, 0, 0, 0, 1, 1, 1, 2), (0, 1, 2, 3, 4, 5, 3, 4, 5, 5))  # one of x, y, z; a square


def padded_rows(matrix: scipy.sparse.csr_array) -> tuple[IntArray, FloatArray]:
    """Columns and values (N, A) of each row, filled up with zeros."""
    rows = scipy.sparse.csr_array(matrix, copy=True)
    rows.sum_duplicates()
    row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
    slot = np.arange(rows.nnz) - rows.indptr[row]
    shape = (rows.shape[0], int(slot.max(initial=0)) + 1)
    columns, values = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=np.float32)
    columns[row, slot], values[row, slot] = rows.indices, rows.data
    return columns, values


def sparse_nodes(graph: GraphBuilder, matrix: scipy.sparse.csr_array, values: str) -> str:
    """A sparse matrix (M, N) times vectors (P, N, 3): (P, M, 3)."""
    columns, weights = padded_rows(matrix)
    gathered = graph.node("Gather", values, graph.index(columns), axis=1)
    weighed = graph.node("Mul", gathered, graph.constant(weights[..., None]))
    return graph.total(weighed, 2)


def offset_nodes(graph: GraphBuilder, points: str, index: IntArray, here: str) -> str:
    """Vectors (P, R, 3, K) from ``here`` (P, R, 3, 1) to points ``index`` (R, K).

    The difference comes first: two points near each other have one without rounding.
    """
    there = graph.node("Gather", points, graph.index(index), axis=1)
    return graph.node("Sub", graph.node("Transpose", there, perm=[0, 1, 3, 2]), here)


def axes_nodes(
    graph: GraphBuilder, surroundings: PatchSurroundings, carried: str, crosses: str
) -> str:
    """Frames (P, R, 3, 3) of the front receivers, *rows* tangent, bitangent, normal."""
    tangent = Value(graph, carried)
    normal = Value(graph, sparse_nodes(graph, surroundings.around, crosses))
    normal = unit(normal, SMALLEST, 2)
    tangent = unit(tangent - normal * dot(tangent, normal, 2), SMALLEST, 2)
    rows = (tangent, cross(normal, tangent, 2), normal)  # [P, R, 3] each
    shape = (-1, len(surroundings.vertex), 1, 3)
    return graph.node("Concat", *(row.reshaped(*shape).name for row in rows), axis=2)


def patch_table_nodes(
    graph: GraphBuilder, surroundings: PatchSurroundings, points: str, crosses: str
) -> str:
    """Centroids and vector areas (P, S + 1, 6) of all patches; the last one is empty.

    The finest patches are sums over vertices and faces, the others over the finest.
    """
    finest = int(surroundings.patch[-1].min())
    centring, facing = surroundings.centring, surroundings.facing
    centres, areas = (
        sparse_nodes(graph, matrix[finest:], values)
        for matrix, values in ((centring, points), (facing, crosses))
    )
    fine = surroundings.patch[-1] - finest
    first = np.unique(fine, return_index=True)[1]
    above = np.zeros((finest + 1, len(first)))  # whether a patch holds a finest one
    for level in surroundings.patch[:-1]:
        above[level[first], np.arange(len(first))] = 1.0
    weight = np.bincount(fine, surroundings.area.astype(np.float64))
    shares = above * weight / np.maximum((above * weight).sum(axis=1, keepdims=True), 1e-300)
    parts = []
    for values, matrix in ((centres, shares), (areas, above)):
        coarse = graph.node("MatMul", graph.constant(matrix), values)
        coarse, empty = (
            graph.slice(coarse, 0, finest, 1),
            graph.slice(coarse, finest, finest + 1, 1),
        )
        parts.append(graph.node("Concat", coarse, values, empty, axis=1))
    return graph.node("Concat", *parts, axis=2)


def band_maps(order: int) -> list[FloatArray]:
    """For each band, from the monomials of its degree to 2π y_lm on the sphere."""
    points = sh.fibonacci_sphere(60).astype(np.float64)
    left, right = SQUARES
    squares = points[:, left] * points[:, right]
    one, square = CUBES
    monomials = [np.ones((60, 1)), points, squares, points[:, one] * squares[:, square]]
    exact = 2.0 * math.pi * sh.evaluate(points, order)
    return [
        np.linalg.lstsq(monomials[band], exact[:, band**2 : (band + 1) ** 2], rcond=None)[0]
        for band in range(order)
    ]


def cap_nodes(graph: GraphBuilder, surroundings: PatchSurroundings, local: str, seen: str,
              distance2: str) -> tuple[str, str]:  # fmt: skip
    """Sums (P, R, n²) over patches above the front's horizon, and over all.

    With s = sin² θ and c = cos θ of a cap, its integrals are I₀ = s/(1 + c), I₁ = s/2,
    I₂ = sc/2, I₃ = s(5c² − 1)/8: no difference of nearly equal numbers.

    Args:
        graph: the graph.
        surroundings: what is seen.
        local: directions to the patches in the receivers' frames, (P, R, 3, K).
        seen: the patches' areas as seen, (P, R, 1, K).
        distance2: squared distances, (P, R, 1, K).
    """
    one, half = graph.constant(1.0), graph.constant(0.5)
    disc = graph.node("Mul", distance2, graph.constant(math.pi))
    sine2 = graph.node("Div", seen, graph.node("Add", disc, seen))
    cosine2 = graph.node("Sub", one, sine2)
    cosine = graph.node("Sqrt", cosine2)
    softness = graph.clip(graph.node("Sqrt", sine2), SOFTEST)
    slope = graph.node("Div", graph.slice(local, 2, 3, 2), softness)
    above = graph.node("Add", graph.node("Mul", slope, half), half)
    above = graph.clip(above, 0.0, 1.0)
    halved = graph.node("Mul", sine2, half)
    left, right = (graph.constant(index) for index in SQUARES)
    squares = [graph.node("Gather", local, index, axis=2) for index in (left, right)]
    squared = graph.node("Mul", *squares) if surroundings.order > 2 else ""
    bands = []
    for band, to_basis in enumerate(band_maps(surroundings.order)):
        if band == 0:
            integral = graph.node("Div", sine2, graph.node("Add", one, cosine))
        elif band == 1:
            integral, rows = halved, local
        elif band == 2:
            integral, rows = graph.node("Mul", halved, cosine), squared
        else:
            shape = graph.node("Mul", cosine2, graph.constant(5.0 / 4.0))
            shape = graph.node("Sub", shape, graph.constant(1.0 / 4.0))
            integral = graph.node("Mul", halved, shape)
            single, double = (graph.constant(np.array(index)) for index in CUBES)
            rows = graph.node(
                "Mul",
                graph.node("Gather", local, single, axis=2),
                graph.node("Gather", squared, double, axis=2),
            )
        weights = graph.node("Concat", graph.node("Mul", integral, above), integral, axis=2)
        if band == 0:
            sums = graph.total(weights, 3, keep=True)  # [P, R, 2, 1]
        else:
            sums = graph.node(
                "MatMul", weights, graph.node("Transpose", rows, perm=[0, 1, 3, 2])
            )  # [P, R, 2, monomials]
        bands.append(graph.node("MatMul", sums, graph.constant(to_basis)))
    every = graph.node("Concat", *bands, axis=3) if len(bands) > 1 else bands[0]
    size = [-1, len(surroundings.vertex), surroundings.order**2]
    front, total = (graph.reshape(graph.slice(every, k, k + 1, 2), size) for k in (0, 1))
    return front, total


@dataclass(frozen=True)
class Sheet:
    """Values of a pose that all of a sheet's receivers share.

    Attributes:
        points: vertices (P, vertices, 3), as they are given.
        crosses: of the faces' edges, in units of the sheet's size, (P, T, 3).
        here: places of the front receivers, as they are given, (P, R, 3, 1).
        axes: their frames, *rows* tangent, bitangent, normal, (P, R, 3, 3).
    """

    points: str
    crosses: str
    here: str
    axes: str


def sheet_nodes(graph: GraphBuilder, surroundings: PatchSurroundings, pose_size: int) -> Sheet:
    """The sheet of ``pose``."""
    receivers, size = len(surroundings.vertex), surroundings.size
    points = graph.reshape("pose", [-1, pose_size // 3, 3])
    corner = [graph.constant(surroundings.faces[:, k]) for k in range(3)]
    a, b, c = (graph.node("Gather", points, index, axis=1) for index in corner)
    scale = graph.constant(1.0 / size)
    left, right = (
        Value(graph, graph.node("Mul", graph.node("Sub", end, a), scale)) for end in (b, c)
    )
    crosses = cross(left, right, 2).name
    here = graph.node("Gather", points, graph.index(surroundings.vertex), axis=1)
    here = graph.reshape(here, [-1, receivers, 3, 1])
    carried = offset_nodes(graph, points, surroundings.carry_vertex, here)
    weight = surroundings.carry_weight[:, None] / size
    carried = graph.total(graph.node("Mul", carried, graph.constant(weight)), 3)
    return Sheet(points, crosses, here, axes_nodes(graph, surroundings, carried, crosses))


def patch_nodes(graph: GraphBuilder, surroundings: PatchSurroundings, pose_size: int) -> str:
    """Features (P, V, F) of ``pose``."""
    receivers, size = len(surroundings.vertex), surroundings.size
    sheet = sheet_nodes(graph, surroundings, pose_size)
    points, here, axes = sheet.points, sheet.here, sheet.axes
    scale = graph.constant(1.0 / size)
    control = offset_nodes(graph, points, surroundings.control, here)
    control = graph.node("MatMul", axes, control)  # [P, R, 3, M]
    control = graph.node("Mul", control, graph.constant(1.0 / (size * surroundings.radius)))
    control = graph.reshape(control, [-1, receivers, 3 * len(surroundings.radius)])

    table = patch_table_nodes(graph, surroundings, points, sheet.crosses)
    near = surroundings.near
    index = graph.index(np.where(near >= 0, near, int(surroundings.patch.max()) + 1))
    seen = graph.node("Gather", table, index, axis=1)  # [P, R, K, 6]
    seen = graph.node("Transpose", seen, perm=[0, 1, 3, 2])
    centres, areas = graph.slice(seen, 0, 3, 2), graph.slice(seen, 3, 6, 2)
    away = Value(graph, graph.node("Mul", graph.node("Sub", centres, here), scale))
    distance2 = dot(away, away, 2).clip(SMALLEST)
    toward = away / distance2.sqrt()
    facing = dot(Value(graph, areas), toward, 2).magnitude()
    local = graph.node("MatMul", axes, toward.name)
    front, total = cap_nodes(graph, surroundings, local, facing.name, distance2.name)
    sides = [graph.node("Concat", control, front, axis=2)]
    if surroundings.two_sided:
        turn = np.repeat([1.0, -1.0, -1.0], len(surroundings.radius))
        back = graph.node("Sub", total, front)
        sign = np.concatenate([turn, flipped(surroundings.order)])
        both = graph.node("Concat", control, back, axis=2)
        sides.append(graph.node("Mul", both, graph.constant(sign)))
    return graph.node("Concat", *sides, axis=1) if len(sides) > 1 else sides[0]
