"""Graphs of priors against the NumPy reference."""

from __future__ import annotations

import numpy as np
import onnxruntime
import pytest

from prtnet.storage import Packing, quantise
from tests.cloth import folding_sheet, surroundings_of
from tests.models import random_poses
from tests.priors import random_prior
from training.onnx_graph import GraphBuilder
from training.onnx_prior import prior_nodes

RELATIVE = 1e-5


def run(prior, poses, receivers=40):
    graph = GraphBuilder()
    matrices = prior.matrices()

    def stored(name):
        return quantise(matrices[name], Packing("float32"))

    answer = prior_nodes(graph, prior, stored, poses.shape[1])
    graph.node("Add", answer, graph.constant(0.0), output="visibility")
    model = graph.model(poses.shape[1], "visibility", [receivers, 9], {})
    session = onnxruntime.InferenceSession(model.SerializeToString())
    return session.run(None, {"pose": poses})[0]


@pytest.mark.parametrize("kind", ["maps", "network"])
@pytest.mark.parametrize("morphs", [0, 2])
@pytest.mark.parametrize("poses", [1, 3])
def test_graph_equals_the_reference(kind, morphs, poses):
    prior, given = random_prior(kind), random_poses(poses, 5, morphs)
    expected = prior(given)
    assert np.abs(run(prior, given) - expected).max() <= RELATIVE * np.abs(expected).max()
    assert np.ptp(run(prior, random_poses(2, 5, morphs)), axis=0).max() > 0.1


@pytest.mark.parametrize("kind", ["maps", "network"])
@pytest.mark.parametrize("two_sided", [False, True])
def test_graph_of_a_sheet_equals_the_reference(kind, two_sided):
    scene = folding_sheet(9, 8)
    poses = scene.frames.reshape(len(scene.frames), -1)
    seen, _, _ = surroundings_of(scene, two_sided)
    prior = random_prior(kind, receivers=seen.receiver_count, surroundings=seen, poses=poses)
    expected = prior(poses)
    answer = run(prior, poses, seen.receiver_count)
    assert np.abs(answer - expected).max() <= RELATIVE * np.abs(expected).max()


def test_graph_knows_its_place_far_away():
    prior, given = random_prior("maps"), random_poses(2, 5).astype(np.float64)
    far = given.reshape(2, 5, 3, 4).copy()
    far[..., 3] = np.float32(far[..., 3] + 1024.0)  # as much as float32 keeps of the pose itself
    far = far.reshape(2, -1).astype(np.float32)
    expected = prior(far)
    assert np.abs(run(prior, far) - expected).max() <= 2 * RELATIVE * np.abs(expected).max()
