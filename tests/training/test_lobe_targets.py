from __future__ import annotations

import dataclasses

import numpy as np
import onnxruntime
import pytest

from prtnet import lobe_numbers
from prtnet.errors import PrtnetError
from prtnet.evaluation import dataset_truth, evaluate
from prtnet.lobe_numbers import LobeNumbers
from prtnet.model import VisibilityModel
from prtnet.zh import Lobes
from tests.models import random_poses
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL, Recorder
from training.config import TrainConfig
from training.lobe_targets import lobe_targets
from training.onnx_export import build_onnx
from training.train import train


def two_lobes(clips=3, per_clip=8, receivers=60, seed=0):
    """A dataset whose visibility is two lobes of each receiver that move with the pose."""
    data = memory_dataset(clips=clips, per_clip=per_clip)
    rng = np.random.default_rng(seed)
    pose = data.read("pose")
    count = len(pose)
    drive = (pose - pose.mean(axis=0)) @ rng.normal(size=(pose.shape[1], 6)) / 3.0
    axes = rng.normal(size=(receivers, 2, 3))
    axes[:, 1] -= axes[:, 0] * (axes[:, 0] * axes[:, 1]).sum(-1, keepdims=True)
    axes = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    axes = axes + 0.2 * np.tanh(drive).reshape(count, 1, 2, 3)
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    g = np.array([[3.0, 0.9, 0.6, 0.3], [1.0, -0.5, -0.5, -0.4]])
    g = g * (1.0 + 0.1 * np.tanh(drive[:, :2]))[:, None, :, None]
    truth = Lobes(axes, np.broadcast_to(g, (count, receivers, 2, 4))).harmonics()
    return with_visibility(data, truth.astype(np.float32))


def with_visibility(data, truth):
    """The dataset with another visibility, of order 4."""
    read = data.read
    data.order = 4

    def other(name, rows=slice(None)):
        return truth[rows] if name == "visibility" else read(name, rows)

    data.read = other
    return data


def test_targets_are_fits_of_poses_by_themselves():
    """Whatever other poses there are, but for the mean that all start from."""
    truth = two_lobes().read("visibility")
    watch = Recorder()
    numbers = lobe_targets(truth, 2, watch)
    assert watch.stages == ["fits of lobes"]
    assert [done for done, *_ in watch.losses] == [4, 8, 12, 16, 20, 24]
    coding = LobeNumbers(2, 4)
    assert numbers.shape == (24, 60, coding.size)
    fitted = coding.harmonics(numbers)
    assert np.linalg.norm(fitted - truth) < 0.05 * np.linalg.norm(truth)
    backwards = lobe_targets(truth[::-1], 2, Recorder())[::-1]
    assert np.allclose(backwards, numbers, atol=1e-4)


@pytest.mark.parametrize("regressor", ["linear", "quadratic", "neural"])
@pytest.mark.parametrize("parts", [1, 3])
def test_lobes_from_configuration_to_graph(regressor, parts, tmp_path):
    data = two_lobes()
    config = dataclasses.replace(
        SMALL, kind="lobes", regressor=regressor, parts=parts, step=1, latents=8, alpha=1e-3
    )
    model = train(data, config)
    assert (model.kind, model.lobes) == ("lobes", 2)
    assert (model.regressor.hidden_weight is not None) == (regressor == "neural")
    assert (model.regressor.pairs is not None) == (regressor == "quadratic")
    rows = data.training_poses()
    poses, truth = data.read("pose", rows), data.read("visibility", rows)
    signal = np.linalg.norm(truth - truth.mean(axis=0))
    assert np.linalg.norm(model(poses) - truth) < 0.6 * signal
    assert np.allclose(model.training_mean, truth.mean(axis=0), atol=1e-5)
    model.save(tmp_path / "m.safetensors")
    assert np.array_equal(VisibilityModel.load(tmp_path / "m.safetensors")(poses), model(poses))
    session = onnxruntime.InferenceSession(build_onnx(model).SerializeToString())
    got = session.run(None, {"pose": poses})[0]
    assert np.abs(got - model(poses)).max() <= 1e-5 * np.abs(model(poses)).max()
    assert np.array_equal(train(data, config)(poses), model(poses))


def test_their_regressor_is_cross_validated_as_any():
    config = dataclasses.replace(
        SMALL, kind="lobes", regressor="neural", neurons="auto", iterations=5
    )
    model = train(two_lobes(), config)
    assert "neurons" in next(iter(model.metadata["cross_validation"]))
    linear = train(two_lobes(), dataclasses.replace(SMALL, kind="lobes"))
    assert "neurons" not in next(iter(linear.metadata["cross_validation"]))


def test_yardsticks_of_lobes():
    """In order: the components' floor, the model, the mean; the floor above the fits' error."""
    data = two_lobes(per_clip=24)
    config = dataclasses.replace(SMALL, kind="lobes", latents=6, alpha=3e-3)
    model = train(data, config)
    results = evaluate(model, model, dataset_truth(model, data, data.clip_names))
    rows = data.held_out_poses()
    truth = data.read("visibility", rows)
    coding = model.lobe_numbers
    missed = coding.harmonics(coding.fitted(truth, model.mean_lobes)) - truth
    fit = np.linalg.norm(missed) / np.linalg.norm(truth)
    assert 0.0 < fit < results["pca_floor"] < results["rms"] < results["signal"]


def test_a_strong_ridge_is_why_lobes_can_be_predicted(monkeypatch):
    """Lobes that nearly meet: the usual ridge lets their coefficients run away."""
    rng = np.random.default_rng(0)
    centre = rng.normal(size=(60, 1, 3))
    axes = centre + 0.15 * rng.normal(size=(24, 60, 2, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    g = np.broadcast_to([1.5, 0.5, 0.3, 0.15], (24, 60, 2, 4))
    truth = Lobes(axes, g).harmonics().astype(np.float32)
    spread = []
    for ridge in (1e-2, 1e-6):
        monkeypatch.setattr(lobe_numbers, "LOBE_RIDGE", ridge)
        numbers = lobe_targets(truth, 2, Recorder())
        spread.append(float(np.linalg.norm(numbers.std(axis=0))))
    assert spread[0] < 0.7 * spread[1]


def test_one_kind_of_lobes_has_one_regressor():
    assert TrainConfig(kind="lobes").regression == "linear"
    assert TrainConfig(kind="lobes", regressor="neural").regression == "neural"
    assert TrainConfig(kind="quadratic").regression == "quadratic"
    for options, told in (
        ({"kind": "linear", "regressor": "linear"}, "--regressor: is that of --kind lobes"),
        ({"kind": "lobes", "storage": "int4"}, "--storage: int4 is made for"),
        ({"kind": "lobes", "frame": "global"}, "--frame: lobes are fitted in local frames"),
        ({"kind": "lobes", "lobes": 0}, "--lobes: must be at least 1"),
    ):
        with pytest.raises(PrtnetError, match=told):
            TrainConfig(**options)


def test_cosine_weighted_lobes_are_held_against_cosine_weighted_truth():
    data = two_lobes()
    config = dataclasses.replace(SMALL, kind="lobes", latents=8, alpha=1e-3, target="cosine")
    model = train(data, config)
    assert model.metadata["held_out_error"]["rms"] < 0.3


def test_poses_far_away_give_finite_lobes():
    model = train(two_lobes(), dataclasses.replace(SMALL, kind="lobes", alpha=1e-3))
    lobes = model.lobes_of(random_poses(6, 4, seed=5))
    assert np.isfinite(lobes.coefficients).all()
    assert np.allclose(np.linalg.norm(lobes.axes, axis=-1), 1.0, atol=1e-5)
