from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from runtime.onnx_model import OnnxModel
from tests.cloth import folding_sheet, surroundings_of
from training.onnx_graph import GraphBuilder
from training.onnx_patches import patch_nodes

SCENE = folding_sheet(15, 12)
POSES = SCENE.frames.reshape(len(SCENE.frames), -1)


def by_graph(seen, poses):
    graph = GraphBuilder()
    value = patch_nodes(graph, seen, poses.shape[1])
    graph.node("Mul", value, graph.constant(1.0), output="visibility")
    shape = [seen.receiver_count, seen.feature_count]
    model = graph.model(poses.shape[1], "visibility", shape, {"prtnet": "features"})
    return OnnxModel(model.SerializeToString(), threads=1)(poses)


@pytest.mark.parametrize("two_sided", [False, True])
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_the_graph_sees_what_the_reference_sees(order, two_sided):
    seen, _, _ = surroundings_of(SCENE, two_sided, order=order)
    wanted = seen(POSES)
    np.testing.assert_allclose(by_graph(seen, POSES), wanted, atol=1e-5 * np.abs(wanted).max())


def test_one_level_of_patches():
    seen, _, _ = surroundings_of(SCENE, levels=(20,))
    wanted = seen(POSES)
    np.testing.assert_allclose(by_graph(seen, POSES), wanted, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_units_do_not_matter(scale):
    plain, _, _ = surroundings_of(SCENE)
    seen = dataclasses.replace(plain, size=scale * plain.size)
    wanted = plain(POSES)
    tolerance = 1e-4 * np.abs(wanted).max()  # the points themselves are rounded anew
    np.testing.assert_allclose(by_graph(seen, POSES * np.float32(scale)), wanted, atol=tolerance)
