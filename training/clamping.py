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
from training.onnx_graph import GraphBuilder

__all__ = ["UnitBox", "clamp_nodes", "from_unit_nodes", "unit_box"]

THINNEST = 1e-6  # half extent of a box in an input, over half its diagonal: units stay finite


@dataclass(frozen=True, eq=False)
class UnitBox:
    """From reduced inputs to the box [−1, 1] and back; every array is (1 or C, …).

    Attributes:
        matrix, bias: (K, K + 1) and (1, K + 1), to units of the box and the one input more.
        back: (K + 1, K + 1), from clamped units to clamped inputs and a one.
        square: (K + 1, 1), from squared distances to the box, in its units, to 1 + d².
    """

    matrix: Stored
    bias: FloatArray
    back: FloatArray
    square: FloatArray


def unit_box(low: FloatArray, high: FloatArray) -> UnitBox:
    """Of the training poses' range (1 or C, K)."""
    low, high = low.astype(np.float64), high.astype(np.float64)
    boxes, inputs = low.shape
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    size = box_size(low, high)[:, None]
    unit = np.maximum(half, THINNEST * size)
    every = np.arange(inputs)
    matrix, bias = np.zeros((boxes, inputs, inputs + 1)), np.full((boxes, 1, inputs + 1), 2.0)
    matrix[:, every, every] = 1.0 / unit
    bias[:, 0, :-1] = -middle / unit
    back, square = np.zeros((boxes, inputs + 1, inputs + 1)), np.ones((boxes, inputs + 1, 1))
    back[:, every, every], back[:, -1, :-1], back[:, -1, -1] = half, middle, 1.0
    square[:, :-1, 0] = np.square(unit / (FADE_SCALE * size))
    scale = np.ones((1, 1, 1), dtype=np.float32)
    return UnitBox(Stored(matrix.astype(np.float32), scale), bias, back, square)


def clamp_nodes(graph: GraphBuilder, box: UnitBox, value: str) -> tuple[str, str]:
    """Units (P, 1 or C, 1, K + 1) clamped, and 1 + d² of each box (P, 1 or C, 1, 1)."""
    known = graph.clip(value, -1.0, 1.0)
    beyond = graph.node("Sub", value, known)
    beyond = graph.node("Mul", beyond, beyond)
    return known, graph.node("MatMul", beyond, graph.constant(box.square))


def from_unit_nodes(graph: GraphBuilder, box: UnitBox, weight: Stored, bias: FloatArray) -> str:
    """(C, K + 1, N) from clamped units through a layer (C, K, N) and its bias (C, 1, N)."""
    if weight.values.dtype == np.float32:
        return graph.constant(box.back @ np.concatenate([weight.values, bias], axis=1))
    layer = graph.node("Concat", graph.stored(weight), graph.constant(bias), axis=1)
    return graph.node("MatMul", graph.constant(box.back), layer)
