"""Lobes of receivers as nodes: from the numbers that stand for them to visibility.

Mirrors ``prtnet.lobe_numbers``. Receivers are the last axis, so that every node runs over
neighbouring numbers.
"""

from __future__ import annotations

import numpy as np

from prtnet.lobe_numbers import TILT, LobeNumbers
from prtnet.sh import bands, components
from training.onnx_expression import Value, unit
from training.onnx_graph import GraphBuilder

__all__ = ["lobe_nodes"]


def lobe_nodes(
    graph: GraphBuilder, numbers: LobeNumbers, value: str, receivers: int,
    output: str | None = None,
) -> str:  # fmt: skip
    """(P, V, n²) of numbers (P, V, N), under a name of its own if given."""
    rows = graph.node("Transpose", value, perm=[0, 2, 1])  # [P, N, V]
    first = graph.slice(rows, 0, 1, 1)
    if numbers.order == 1:
        return graph.node("Transpose", first, output=output, perm=[0, 2, 1])
    ends = 1 + 3 * numbers.count
    axes = graph.reshape(graph.slice(rows, 1, ends, 1), [-1, numbers.count, 3, receivers])
    pointing = Value(graph, axes) + np.array([0.0, 0.0, TILT])[:, None]
    axis = unit(pointing, TILT**2, axis=2)
    x, y, z = (Value(graph, graph.slice(axis.name, k, k + 1, 2)) for k in range(3))
    basis = [row.name for row in components(x, y, z, numbers.order)[1:]]  # type: ignore[type-var]
    size = [-1, numbers.count, numbers.order - 1, receivers]
    g = Value(graph, graph.reshape(graph.slice(rows, ends, numbers.size, 1), size))
    g = g * (1.0 / numbers.unit[1:, None])
    own = g.take(bands(numbers.order)[1:] - 1, axis=2)
    lobes = Value(graph, graph.node("Concat", *basis, axis=2)) * own  # [P, c, n² − 1, V]
    rest = graph.total(lobes.name, 1)
    every = graph.node("Concat", first, rest, axis=1)
    return graph.node("Transpose", every, output=output, perm=[0, 2, 1])
