"""What a graph computes for one pose, counted.

Shaders that do what a graph does need the same arithmetic, spread over their vertices.
"""

from __future__ import annotations

import math

import onnx
from onnx import shape_inference

__all__ = ["operations"]

MOVES = frozenset(("Cast", "Concat", "Gather", "Reshape", "Slice", "Transpose"))


def operations(proto: onnx.ModelProto) -> int:
    """Additions, multiplications, divisions, roots, comparisons and tanh of one pose.

    A multiply-add is two. What depends on constants alone is folded, and free; so is what only
    moves numbers.

    Args:
        proto: of ``GraphBuilder``.

    Raises:
        ValueError: a shape is not told.
    """
    one = onnx.ModelProto()
    one.CopyFrom(proto)
    for value in (*one.graph.input, *one.graph.output):
        value.type.tensor_type.shape.dim[0].dim_value = 1
    inferred = shape_inference.infer_shapes(one, strict_mode=True, data_prop=True).graph
    shapes = {tensor.name: list(tensor.dims) for tensor in inferred.initializer}
    for value in (*inferred.value_info, *inferred.input, *inferred.output):
        shapes[value.name] = [d.dim_value for d in value.type.tensor_type.shape.dim]
    constant = {tensor.name for tensor in inferred.initializer} | {""}  # what is left out
    total = 0
    for node in inferred.node:
        if constant.issuperset(node.input):
            constant.update(node.output)
        elif node.op_type == "MatMul":
            total += 2 * size(shapes, node.output[0]) * shapes[node.input[0]][-1]
        elif node.op_type == "ReduceSum":
            total += size(shapes, node.input[0])
        elif node.op_type not in MOVES:
            total += size(shapes, node.output[0])
    return total


def size(shapes: dict[str, list[int]], name: str) -> int:
    """How many numbers a value has."""
    shape = shapes.get(name)
    if shape is None or any(length <= 0 for length in shape):
        raise ValueError(f"the shape of {name} is not known")
    return math.prod(shape)
