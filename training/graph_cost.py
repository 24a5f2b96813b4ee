"""What a graph computes for one pose, counted: operations and bytes that no engine can leave out.

Shaders that do what a graph does need the same arithmetic, spread over their vertices.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import onnx
from onnx import shape_inference

__all__ = ["GraphCost", "graph_cost"]

MOVES = frozenset(("Cast", "Concat", "Gather", "Reshape", "Slice", "Transpose"))


@dataclass(frozen=True)
class GraphCost:
    """Of one pose.

    Attributes:
        operations: additions, multiplications, divisions, square roots, comparisons and tanh; a
            multiply-add is two.
        constant_bytes: of float32 constants that they read, once each.
    """

    operations: int
    constant_bytes: int


def graph_cost(proto: onnx.ModelProto) -> GraphCost:
    """Count a graph of ``GraphBuilder``; what depends on constants alone is folded, and free.

    Raises:
        ValueError: an operator is not known, or a shape not told.
    """
    one = onnx.ModelProto()
    one.CopyFrom(proto)
    for value in (*one.graph.input, *one.graph.output):
        value.type.tensor_type.shape.dim[0].dim_value = 1
    inferred = shape_inference.infer_shapes(one, strict_mode=True, data_prop=True).graph
    shapes = {tensor.name: list(tensor.dims) for tensor in inferred.initializer}
    for value in (*inferred.value_info, *inferred.input, *inferred.output):
        shapes[value.name] = [d.dim_value for d in value.type.tensor_type.shape.dim]
    constant = {tensor.name for tensor in inferred.initializer}
    operations, read = 0, set()
    for node in inferred.node:
        if constant.issuperset(node.input):
            constant.update(node.output)
            continue
        out = math.prod(known(shapes, node.output[0]))
        if node.op_type == "MatMul":
            operations += 2 * out * known(shapes, node.input[0])[-1]
        elif node.op_type == "ReduceSum":
            operations += math.prod(known(shapes, node.input[0]))
        elif node.op_type not in MOVES:
            operations += out
        if node.op_type not in MOVES:
            read.update(constant.intersection(node.input))
    numbers = sum(math.prod(known(shapes, name)) for name in read)
    return GraphCost(operations, 4 * numbers)


def known(shapes: dict[str, list[int]], name: str) -> list[int]:
    """A shape without unknown sizes."""
    shape = shapes.get(name)
    if shape is None or any(size <= 0 for size in shape):
        raise ValueError(f"the shape of {name} is not known")
    return shape
