"""Values of a graph that compute like arrays: formulas written once serve NumPy and ONNX.

``sh.components`` and ``cap_integral_rows`` ask their argument for its array library; a
:class:`Value` answers with itself, and its arithmetic appends nodes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from training.onnx_graph import GraphBuilder

__all__ = ["Value", "cross", "dot", "unit"]


class Value:
    """A float32 value of a graph by its name."""

    __array_ufunc__ = None  # arrays leave arithmetic with values to the values

    def __init__(self, graph: GraphBuilder, name: str) -> None:
        self.graph, self.name = graph, name

    def __array_namespace__(self) -> type[Value]:
        """What stands in for NumPy: this class."""
        return Value

    @staticmethod
    def ones_like(value: Value) -> Value:
        """A one that broadcasts."""
        return Value(value.graph, value.graph.constant(1.0))

    def _named(self, other: Any) -> str:
        return (
            other.name
            if isinstance(other, Value)
            else self.graph.constant(np.asarray(other, dtype=np.float64))
        )

    def _binary(self, operator: str, first: Any, second: Any) -> Value:
        name = self.graph.node(operator, self._named(first), self._named(second))
        return Value(self.graph, name)

    def __add__(self, other: Any) -> Value:
        """Add."""
        return self._binary("Add", self, other)

    def __radd__(self, other: Any) -> Value:
        """Add."""
        return self._binary("Add", other, self)

    def __sub__(self, other: Any) -> Value:
        """Subtract."""
        return self._binary("Sub", self, other)

    def __rsub__(self, other: Any) -> Value:
        """Subtract from something else."""
        return self._binary("Sub", other, self)

    def __mul__(self, other: Any) -> Value:
        """Multiply."""
        return self._binary("Mul", self, other)

    def __rmul__(self, other: Any) -> Value:
        """Multiply."""
        return self._binary("Mul", other, self)

    def __truediv__(self, other: Any) -> Value:
        """Divide."""
        return self._binary("Div", self, other)

    def sqrt(self) -> Value:
        """Square root."""
        return Value(self.graph, self.graph.node("Sqrt", self.name))

    def relu(self) -> Value:
        """The positive part."""
        return Value(self.graph, self.graph.node("Relu", self.name))

    def magnitude(self) -> Value:
        """Absolute value, in portable operators."""
        return self.relu() * 2.0 - self

    def clip(self, low: float, high: float | None = None) -> Value:
        """Clamp to scalars."""
        return Value(self.graph, self.graph.clip(self.name, low, high))

    def total(self, axis: int) -> Value:
        """Sum along one axis, which stays."""
        return Value(self.graph, self.graph.total(self.name, axis, keep=True))

    def take(self, index: Any, axis: int) -> Value:
        """Elements along one axis."""
        table = self.graph.index(np.asarray(index))
        return Value(self.graph, self.graph.node("Gather", self.name, table, axis=axis))

    def reshaped(self, *shape: int) -> Value:
        """Another shape; −1 is inferred."""
        return Value(self.graph, self.graph.reshape(self.name, shape))


def dot(a: Value, b: Value, axis: int = 1) -> Value:
    """Scalar products of vectors along an axis, which stays."""
    return (a * b).total(axis)


def cross(a: Value, b: Value, axis: int = 1) -> Value:
    """Cross products of vectors along an axis."""
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return a.take(ahead, axis) * b.take(behind, axis) - a.take(behind, axis) * b.take(ahead, axis)


def unit(vectors: Value, smallest: float, axis: int = 1) -> Value:
    """Unit vectors along an axis; one whose squared length is below ``smallest`` stays short."""
    return vectors / dot(vectors, vectors, axis).clip(smallest).sqrt()
