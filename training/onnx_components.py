"""Constants of a graph in few bytes: nodes at its head that runtimes fold when they load it.

Components in 4 bits are two in a byte; matrices that clusters do not fill are stored column by
column, without those that are zero.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from onnx import TensorProto

from prtnet.arrays import IntArray
from prtnet.components import Coded, blocks
from prtnet.storage import Stored
from training.onnx_graph import GraphBuilder

__all__ = ["component_nodes", "matrix_nodes"]


def component_nodes(graph: GraphBuilder, coded: Coded) -> tuple[str, IntArray]:
    """Components (K, R · n²) as one float32 value, and in which row of it each stands, (K,)."""
    size = len(coded.coding.profile)
    slots = coded.values.shape[1] // size
    parts, order_of_rows = [], []
    for bits, order, rows, data in blocks(coded):
        width = slots * order**2
        if bits == 4:
            value = pair_nodes(graph, data, width)
        else:
            value = graph.node("Cast", graph.initializer(data.view(np.int8)), to=TensorProto.FLOAT)
        value = graph.reshape(value, [len(rows), slots, order**2])
        spread = np.zeros((order**2, size), dtype=np.float32)
        np.fill_diagonal(spread, coded.coding.profile[: order**2])
        value = graph.node("MatMul", value, graph.constant(spread))
        value = graph.reshape(value, [len(rows), slots * size])
        parts.append(graph.node("Mul", value, graph.constant(coded.scale[rows])))
        order_of_rows.append(rows)
    position = np.empty(len(coded.coding), dtype=np.int64)
    position[np.concatenate(order_of_rows)] = np.arange(len(position))
    return (parts[0] if len(parts) == 1 else graph.node("Concat", *parts, axis=0)), position


def pair_nodes(graph: GraphBuilder, data: Any, width: int) -> str:
    """(B, width) of bytes that hold two integers each: Cast to int32 drops the lower one."""
    both = graph.node("Cast", graph.initializer(data), to=TensorProto.FLOAT)
    sixteenth = graph.node("Mul", both, graph.constant(1.0 / 16.0))
    high = graph.node("Cast", sixteenth, to=TensorProto.INT32)
    high = graph.node("Cast", high, to=TensorProto.FLOAT)
    low = graph.node("Sub", both, graph.node("Mul", high, graph.constant(16.0)))
    value = graph.node("Concat", low, high, axis=1)
    if 2 * data.shape[1] != width:
        value = graph.slice(value, 0, width, 1)
    return graph.node("Sub", value, graph.constant(8.0))


def matrix_nodes(graph: GraphBuilder, stored: Stored, heights: IntArray | None = None) -> str:
    """Matrices (C, N, M) of clusters, one scale a column or none.

    Args:
        graph: to add to.
        stored: the matrices.
        heights: rows of each cluster that are not zero, (C,); all when not given.
    """
    clusters, most, width = stored.values.shape
    heights = np.full(clusters, most) if heights is None else heights
    cluster, column = np.nonzero(stored.values.any(axis=1))
    tall = heights[cluster]
    number = stored.values.dtype.itemsize
    needed = number * int(tall.sum()) + 4 * clusters * width + 4 * most
    if needed >= number * stored.values.size or len(cluster) == 0:
        return graph.stored(stored)
    scale = np.broadcast_to(stored.scale, (clusters, 1, width))
    index = np.full((clusters, width), len(cluster))  # of a row of zeros
    parts, at = [], 0
    for height in np.unique(tall):
        own = np.flatnonzero(tall == height)
        place = cluster[own], column[own]
        rows = Stored(stored.values[place[0], :height, place[1]], scale[place[0], :, place[1]])
        value = graph.stored(rows)
        if height < most:
            nothing = graph.constant(np.zeros((1, most - height), dtype=np.float32))
            rest = graph.node("MatMul", graph.slice(value, 0, 1, 1), nothing)
            value = graph.node("Concat", value, rest, axis=1)
        parts.append(value)
        index[place] = at + np.arange(len(own))
        at += len(own)
    parts.append(graph.constant(np.zeros((1, most), dtype=np.float32)))
    every = graph.node("Concat", *parts, axis=0)
    value = graph.node("Gather", every, graph.index(index), axis=0)  # [C, M, N]
    return graph.node("Transpose", value, perm=[0, 2, 1])
