from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet import sh
from prtnet.errors import PrtnetError
from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from prtnet.metrics import relative_rms
from prtnet.modelled_scene import ModelledScene
from prtnet.output_space import OutputSpace
from tests.models import random_model
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.export import export_folder
from training.train import train


def test_global_coefficients_are_the_same_function_seen_from_the_scene():
    data = memory_dataset()
    rows = np.arange(19)  # more than two blocks
    local, world = data.read("visibility", rows), OutputSpace("global").read(data, rows)
    assert np.allclose(np.linalg.norm(local, axis=-1), np.linalg.norm(world, axis=-1), rtol=1e-5)
    normals, tangents = data.read("normals", rows), data.read("tangents", rows)
    directions = sh.fibonacci_sphere(40).astype(np.float64)
    for pose, receiver in ((0, 3), (18, 59), (9, 20)):
        t, n = tangents[pose, receiver], normals[pose, receiver]
        frame = np.stack([t, np.cross(n, t), n], axis=1)
        here = sh.evaluate(directions @ frame, 2) @ local[pose, receiver]  # frameᵀ d
        there = sh.evaluate(directions, 2) @ world[pose, receiver]
        assert np.allclose(here, there, atol=1e-5)
    assert not np.allclose(local, world, atol=0.1)


def test_cosine_weighted_coefficients_integrate_with_the_cosine():
    """Over many directions, for light of the same order."""
    data = memory_dataset()
    rows = np.array([4])
    plain, weighted = (OutputSpace(target=t).read(data, rows)[0, 7] for t in
                       ("visibility", "cosine"))  # fmt: skip
    directions = sh.fibonacci_sphere(20_000).astype(np.float64)
    basis = sh.evaluate(directions, 2)
    product = (basis @ plain) * np.maximum(directions[:, 2], 0.0)
    expected = 4 * np.pi * (basis * product[:, None]).mean(axis=0)
    assert np.allclose(weighted, expected, atol=1e-3)


def test_the_plain_space_is_the_dataset_itself():
    data = memory_dataset()
    assert OutputSpace().plain
    assert np.array_equal(OutputSpace().read(data, np.arange(3)), data.read("visibility")[:3])
    assert OutputSpace.of({}).plain
    assert OutputSpace.of({"config": {"frame": "global"}}) == OutputSpace("global")


@pytest.mark.parametrize("frame", ["local", "global"])
@pytest.mark.parametrize("target", ["visibility", "cosine"])
def test_models_of_every_space_are_held_against_their_own_truth(frame, target):
    data = memory_dataset()
    model = train(data, dataclasses.replace(SMALL, frame=frame, target=target))
    space = OutputSpace(frame, target)
    rows = data.held_out_poses()
    truth = space.read(data, rows)
    error = relative_rms(model(data.read("pose", rows)), truth)
    assert model.metadata["held_out_error"]["rms"] == pytest.approx(error)
    result = evaluate(
        model, model, dataset_truth(model, data, data.clip_names), NearestPose(data, space)
    )
    assert result["rms"] == pytest.approx(error)
    own = NearestPose(data, space)(data.read("pose", data.training_poses()[:3]))
    assert np.array_equal(own, space.read(data, data.training_poses()[:3]))


@pytest.mark.parametrize("config", [{"frame": "global"}, {"target": "cosine"}])
def test_other_spaces_are_neither_exported_nor_put_on_a_scene(config, tmp_path):
    model = random_model()
    model.metadata["config"] = config
    with pytest.raises(PrtnetError, match="to export it, train with --frame local"):
        export_folder(model, tmp_path / "out")
    with pytest.raises(PrtnetError, match="to use it on a scene, train with --frame local"):
        ModelledScene(model, None)
    assert not (tmp_path / "out").exists()
