"""A small builder of ONNX graphs from portable operators, opset 15.

Engines lag behind: Unity's Inference Engine and Unreal's NNE take opset 15 and no control flow,
and onnxruntime-web lacks Min and Max. Only the operators in ``PORTABLE`` are let in.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from prtnet.arrays import FloatArray, IntArray

__all__ = ["OPSET", "PORTABLE", "GraphBuilder"]

OPSET = 15
PORTABLE = frozenset(
    (
        *("Add", "Clip", "Concat", "Div", "Gather", "MatMul", "Mul", "ReduceSum", "Relu"),
        *("Reshape", "Slice", "Sqrt", "Sub", "Tanh", "Transpose"),
    )
)


class GraphBuilder:
    """Nodes and constants of one graph; values are known by their names."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, array: FloatArray | IntArray | float) -> str:
        """A float32 or int64 initializer."""
        value = np.asarray(array)
        dtype = np.int64 if np.issubdtype(value.dtype, np.integer) else np.float32
        name = f"constant_{len(self.constants)}"
        value = np.ascontiguousarray(value.astype(dtype)).reshape(value.shape)
        self.constants.append(numpy_helper.from_array(value, name))
        return name

    def node(
        self, operator: str, *inputs: str, output: str | None = None, **attributes: Any
    ) -> str:
        """Append an operator with one output; returns the output's name."""
        if operator not in PORTABLE:
            raise ValueError(f"{operator} is not portable")
        name = output or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], **attributes))
        return name

    def reshape(self, value: str, shape: Sequence[int], output: str | None = None) -> str:
        """Reshape; −1 is inferred."""
        return self.node("Reshape", value, self.constant(np.array(shape)), output=output)

    def slice(self, value: str, start: int, stop: int, axis: int) -> str:
        """``value[start:stop]`` along one axis."""
        bounds = (self.constant(np.array([k])) for k in (start, stop, axis))
        return self.node("Slice", value, *bounds)

    def total(self, value: str, axis: int, keep: bool = False) -> str:
        """Sum along one axis."""
        return self.node("ReduceSum", value, self.constant(np.array([axis])), keepdims=int(keep))

    def clip(self, value: str, low: float, high: float | None = None) -> str:
        """Clamp to [low, high]."""
        bounds = [self.constant(low)]
        if high is not None:
            bounds.append(self.constant(high))
        return self.node("Clip", value, *bounds)

    def model(
        self, input_size: int, output_shape: Sequence[int], description: dict[str, str]
    ) -> onnx.ModelProto:
        """The checked model: input ``pose`` (poses, D), output ``visibility`` (poses, V, n²)."""
        pose = helper.make_tensor_value_info("pose", TensorProto.FLOAT, ["poses", input_size])
        visibility = helper.make_tensor_value_info(
            "visibility", TensorProto.FLOAT, ["poses", *output_shape]
        )
        graph = helper.make_graph(self.nodes, "prtnet", [pose], [visibility], self.constants)
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=8,  # of opset 15: older runtimes refuse newer files
            producer_name="prtnet",
        )
        helper.set_model_props(model, description)
        onnx.checker.check_model(model, full_check=True)
        return model
