from __future__ import annotations

import numpy as np
import pytest

from tests.models import random_model
from training.graph_cost import operations
from training.onnx_export import build_onnx
from training.onnx_graph import GraphBuilder


def test_a_small_graph_is_counted_by_hand():
    graph = GraphBuilder()
    weight = graph.node("Mul", graph.constant(np.ones((3, 4))), graph.constant(2.0))  # folded
    value = graph.node("MatMul", "pose", weight)  # 2 · 3 · 4
    value = graph.node("Add", value, graph.constant(np.ones(4)))  # 4
    value = graph.node("Tanh", graph.reshape(value, [-1, 2, 2]))  # 4
    graph.node("Mul", graph.total(value, 2, keep=True), graph.constant(0.5), output="visibility")
    assert operations(graph.model(3, "visibility", [2, 1], {})) == 24 + 4 + 4 + 4 + 2


@pytest.mark.parametrize("storage", ["float32", "int8", "int4"])
def test_storage_changes_nothing(storage):
    model = random_model(receivers=900, parts=2)
    expected = operations(build_onnx(model))
    assert operations(build_onnx(model.stored_as(storage))) == expected
