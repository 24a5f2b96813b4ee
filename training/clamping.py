"""The training range in a graph: inputs are clamped to it, latents fade beyond it.

Mirrors ``prtnet.novelty`` in few nodes: ``Clip`` takes scalar bounds only, so reduced inputs are
measured from the middle of their box, in half extents, by the matrix that makes them. One more
input, always two, is clamped to one: what carries biases through the next matrix, and the one in
1 + d².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.novelty import FADE_SCALE, box_size
from prtnet.storage import Stored
from training.onnx_components import matrix_nodes
from training.onnx_graph import GraphBuilder

__all__ = ["UnitBox", "clamp_nodes", "from_unit_nodes", "unit_box"]

THINNEST = 1e-6  # half extent of a box in an input, over half its diagonal: units stay finite


@dataclass(frozen=True, eq=False)
class UnitBox:
    """From reduced inputs to the box [−1, 1] and back; every array is (1 or C, …).

    Attributes:
        middle, half: (1, K) and (K, 1), the box's middle, and its extent on either side.
        inverse, bias: (1, K) and (1, K + 1), to units of the box and the one input more.
        square: (K + 1, 1), from squared distances to the box, in its units, to 1 + d².
    """

    middle: FloatArray
    half: FloatArray
    inverse: FloatArray
    bias: FloatArray
    square: FloatArray

    def units(self, matrix: FloatArray) -> FloatArray:
        """A matrix (1 or C, F, K) to inputs, as one (1 or C, F, K + 1) to units."""
        return np.pad(matrix * self.inverse, ((0, 0), (0, 0), (0, 1)))

    def unit_nodes(self, graph: GraphBuilder, matrix: str) -> str:
        """The same as nodes."""
        scaled = graph.node("Mul", matrix, graph.constant(self.inverse))
        nothing = graph.node("Mul", graph.slice(matrix, 0, 1, 2), graph.constant(0.0))
        return graph.node("Concat", scaled, nothing, axis=2)


def unit_box(low: FloatArray, high: FloatArray) -> UnitBox:
    """Of the training poses' range (1 or C, K)."""
    low, high = low.astype(np.float64), high.astype(np.float64)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    size = box_size(low, high)[:, None]
    unit = np.maximum(half, THINNEST * size)
    bias = np.pad(-middle / unit, ((0, 0), (0, 1)), constant_values=2.0)[:, None]
    square = np.pad(np.square(unit / (FADE_SCALE * size)), ((0, 0), (0, 1)), constant_values=1.0)
    return UnitBox(middle[:, None], half[..., None], 1.0 / unit[:, None], bias, square[..., None])


def clamp_nodes(graph: GraphBuilder, box: UnitBox, value: str) -> tuple[str, str]:
    """Units (P, 1 or C, 1, K + 1) clamped, and 1 + d² of each box (P, 1 or C, 1, 1)."""
    known = graph.clip(value, -1.0, 1.0)
    beyond = graph.node("Sub", value, known)
    beyond = graph.node("Mul", beyond, beyond)
    return known, graph.node("MatMul", beyond, graph.constant(box.square))


def from_unit_nodes(graph: GraphBuilder, box: UnitBox, weight: Stored, bias: FloatArray) -> str:
    """(C, K + 1, N) from clamped units through a layer (C, K, N) and its bias (C, 1, N)."""
    if weight.values.dtype == np.float32:
        last = box.middle @ weight.values.astype(np.float64) + bias
        whole = np.concatenate([box.half * weight.values, last], axis=1).astype(np.float32)
        return matrix_nodes(graph, Stored(whole, np.ones((1, 1, 1), dtype=np.float32)))
    layer = matrix_nodes(graph, weight)
    scaled = graph.node("Mul", graph.constant(box.half), layer)
    last = graph.node("MatMul", graph.constant(box.middle), layer)
    last = graph.node("Add", last, graph.constant(bias))
    return graph.node("Concat", scaled, last, axis=1)
