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
from prtnet.storage import HALF_LIMIT, Stored

__all__ = ["OPSET", "PORTABLE", "GraphBuilder"]

OPSET = 15
WORTH = 1024  # numbers: smaller constants are not worth a node
PORTABLE = frozenset(
    (
        *("Add", "Cast", "Clip", "Concat", "Div", "Gather", "MatMul", "Mul", "ReduceSum"),
        *("Relu", "Reshape", "Slice", "Sqrt", "Sub", "Tanh", "Transpose"),
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
        return self.initializer(value.astype(dtype)) if dtype is np.int64 else self.real(value)

    def index(self, array: IntArray) -> str:
        """Indices for Gather: int32 initializer, half the bytes of what shapes are made of."""
        return self.initializer(np.asarray(array).astype(np.int32))

    def real(self, value: FloatArray) -> str:
        """A float32 constant; a large one whose numbers are halves is stored as halves."""
        whole = value.astype(np.float32)
        if whole.size >= WORTH and np.abs(whole).max() < HALF_LIMIT:
            half = whole.astype(np.float16)
            if np.array_equal(half, whole):
                return self.node("Cast", self.initializer(half), to=TensorProto.FLOAT)
        return self.initializer(whole)

    def initializer(self, array: Any) -> str:
        """An initializer of the array's own type."""
        name = f"constant_{len(self.constants)}"
        value = np.ascontiguousarray(array).reshape(array.shape)
        self.constants.append(numpy_helper.from_array(value, name))
        return name

    def stored(self, stored: Stored) -> str:
        """The float32 array of a stored one: a few nodes on constants, for runtimes to fold."""
        if stored.values.dtype == np.float32:
            return self.constant(stored.values)
        shape, period = stored.values.shape, stored.scale.shape[-1]
        value = self.node("Cast", self.initializer(stored.values), to=TensorProto.FLOAT)
        if period > 1:
            value = self.reshape(value, [*shape[:-1], shape[-1] // period, period])
        scale = stored.scale[..., None, :] if period > 1 else stored.scale
        value = self.node("Mul", value, self.constant(scale))
        if stored.offset is not None:
            value = self.node("Add", value, self.constant(stored.offset))
        return self.reshape(value, shape) if period > 1 else value

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
        self, input_size: int, output: str, shape: Sequence[int], description: dict[str, str]
    ) -> onnx.ModelProto:
        """The checked model: input ``pose`` (poses, D), output (poses, …)."""
        pose = helper.make_tensor_value_info("pose", TensorProto.FLOAT, ["poses", input_size])
        result = helper.make_tensor_value_info(output, TensorProto.FLOAT, ["poses", *shape])
        graph = helper.make_graph(self.nodes, "prtnet", [pose], [result], self.constants)
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=8,  # of opset 15: older runtimes refuse newer files
            producer_name="prtnet",
        )
        helper.set_model_props(model, description)
        onnx.checker.check_model(model, full_check=True)
        return model
