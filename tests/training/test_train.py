from __future__ import annotations

import dataclasses

import numpy as np
import onnxruntime
import pytest

from prtnet.errors import PrtnetError
from prtnet.model import VisibilityModel
from runtime.onnx_model import OnnxModel
from tests.training.data import memory_dataset
from training.config import PRESETS, TrainConfig
from training.monitor import Silent
from training.onnx_export import build_onnx
from training.tensorboard import TensorBoard
from training.train import train

SMALL = TrainConfig(
    clusters=4, neurons=6, latents=4, spheres=12, points=2, near=6, iterations=40, seed=3
)


class Recorder(Silent):
    def __init__(self):
        self.stages, self.losses, self.scalars = [], [], {}

    def stage(self, text):
        self.stages.append(text)

    def progress(self, done, total, loss):
        self.losses.append((done, total, loss))

    def scalar(self, name, value, step):
        self.scalars.setdefault(name, []).append((step, value))


def test_a_model_beats_its_mean_and_is_reproducible():
    data = memory_dataset()
    watch = Recorder()
    model = train(data, dataclasses.replace(SMALL, features="joint_angles"), watch)
    rows = data.training_poses()
    truth = data.read("visibility", rows)
    error = ((model(data.read("pose", rows)) - truth) ** 2).sum()
    assert error < 0.5 * ((truth - truth.mean(axis=0)) ** 2).sum()
    again = train(data, dataclasses.replace(SMALL, features="joint_angles"))
    assert np.array_equal(again(data.read("pose")), model(data.read("pose")))
    assert watch.stages[0] == "clusters and components"
    assert watch.losses[-1][2] <= watch.losses[0][2]
    assert {"error/training", "error/held_out", "fit/objective_0"} <= set(watch.scalars)


def test_networks_are_averaged_into_one():
    config = dataclasses.replace(SMALL, networks=3, alpha=1e-2)
    model = train(memory_dataset(), config)
    assert model.regressor.hidden_bias.shape == (4, 18)


PRIOR = {"near_spheres": 5, "patches": 9, "near_patches": 5, "width": 8, "steps": 300, "codes": 4}


@pytest.mark.parametrize("kind", ["hybrid", "shared"])
@pytest.mark.parametrize("latents", [0, 4])
def test_priors_from_configuration_to_graph(kind, latents, tmp_path):
    data = memory_dataset(per_clip=12)
    config = dataclasses.replace(SMALL, kind=kind, latents=latents, alpha=1e-2, **PRIOR)
    model = train(data, config)
    model.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    poses = data.read("pose", data.training_poses())
    answer = model(poses)
    assert np.array_equal(again(poses), answer)
    truth = data.read("visibility", data.training_poses())
    signal = np.linalg.norm(truth - truth.mean(axis=0))
    # Each receiver has a law of its own here: what all share explains a part, latents the rest.
    assert np.linalg.norm(answer - truth) < (0.7 if latents else 0.95) * signal
    assert np.allclose(model.training_mean, truth.mean(axis=0), atol=1e-5)
    graph = OnnxModel(build_onnx(model).SerializeToString(), threads=1)
    assert np.linalg.norm(graph(poses) - answer) <= 1e-5 * np.linalg.norm(answer)
    assert np.array_equal(train(data, config)(poses), answer)


def test_priors_want_visibility_in_local_frames():
    with pytest.raises(PrtnetError, match="local frames only"):
        dataclasses.replace(SMALL, kind="hybrid", frame="global")


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
def test_parts_and_storage_from_configuration_to_file(kind, tmp_path):
    data = memory_dataset()
    config = dataclasses.replace(
        SMALL, kind=kind, parts=3, step=1, latents=6, storage="int8", alpha=3e-3
    )
    model = train(data, config)
    assert (model.parts, model.storage) == (3, "int8")
    assert model.receivers.shape == (12, 5)
    model.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    poses = data.read("pose", data.training_poses())
    assert np.array_equal(again(poses), model(poses))
    truth = data.read("visibility", data.training_poses())
    error = np.linalg.norm(model(poses) - truth) / np.linalg.norm(truth)
    assert model.metadata["training_error"]["rms"] == pytest.approx(error, rel=1e-5)
    if kind == "neural":
        assert error < 0.7 * np.linalg.norm(truth - truth.mean(axis=0)) / np.linalg.norm(truth)


@pytest.mark.parametrize("clustering", ["weights", "signal"])
@pytest.mark.parametrize("features", ["joint_angles", "local_joints"])
def test_options_of_all_sorts_together(clustering, features):
    """Squares, smoothness, clusterings, groups and 8 bits in one model and its graph."""
    data = memory_dataset()
    config = dataclasses.replace(
        SMALL, kind="quadratic", features=features, smoothness=0.1, clustering=clustering,
        parts=3, step=1, latents=6, storage="int8", alpha=1e-3, leading=3,
    )  # fmt: skip
    model = train(data, config)
    assert model.receivers.shape == (12, 5)
    assert model.input_low is not None
    rows = data.training_poses()
    poses, truth = data.read("pose", rows), data.read("visibility", rows)
    expected = model(poses)
    assert ((expected - truth) ** 2).sum() < 0.9 * ((truth - truth.mean(axis=0)) ** 2).sum()
    session = onnxruntime.InferenceSession(
        build_onnx(model).SerializeToString(), providers=["CPUExecutionProvider"]
    )
    got = session.run(None, {"pose": poses})[0]
    assert np.abs(got - expected).max() <= 1e-5 * np.abs(expected).max()


def test_the_number_of_neurons_can_be_left_open():
    data = memory_dataset()
    config = dataclasses.replace(SMALL, features="joint_angles", neurons="auto", iterations=10)
    model = train(data, config)
    assert model.regressor.weight.shape[1] in (8, 16, 32, 64)
    tried = model.metadata["cross_validation"]
    best = min(tried, key=tried.get)
    assert best.startswith(f"{model.regressor.weight.shape[1]} neurons, ")
    # It is refined between its neighbours, and for all poses.
    assert 0.1 < model.metadata["alpha"] / float(best.partition(", ")[2]) < 2.0
    fixed = train(data, dataclasses.replace(config, alpha=0.02))
    assert fixed.metadata["alpha"] == 0.02
    assert {name.partition(", ")[2] for name in fixed.metadata["cross_validation"]} == {"0.02"}


def test_constant_kind_predicts_the_training_mean():
    data = memory_dataset()
    model = train(data, dataclasses.replace(SMALL, kind="constant"))
    mean = data.read("visibility", data.training_poses()).mean(axis=0)
    assert np.allclose(model(data.read("pose", slice(2))), mean, atol=1e-5)
    assert model.basis.shape[0] == 0


def test_metadata_tells_how_it_was_made(tmp_path):
    data = memory_dataset()
    data.read("pose").reshape(-1, 4, 12)[:, 2] = 1.0  # of a joint that never moves
    model = train(data, dataclasses.replace(SMALL, features="joint_angles"))
    model.save(tmp_path / "m.safetensors")
    header = VisibilityModel.load(tmp_path / "m.safetensors").metadata
    assert header["config"]["neurons"] == 6
    assert len(header["cross_validation"]) >= 2
    assert header["held_out"] == ["clip2"]
    assert 0 < header["training_error"]["rms"] < header["held_out_error"]["rms"]
    assert sum(header["fit_status"].values()) == 4
    (convergence,) = header["fits"]
    counts = {text: len(clusters) for text, clusters in convergence["clusters"].items()}
    assert counts == header["fit_status"]
    listed = [c for clusters in convergence["clusters"].values() for c in clusters]
    assert sorted(listed) == [0, 1, 2, 3]
    assert len(convergence["iterations"]) == 4
    assert 0 < max(convergence["iterations"]) <= 40
    assert len(convergence["objective"]) == 4
    assert all(0 < loss < 1 for loss in convergence["objective"])  # 1 is the mean's
    assert set(model.metadata["seconds"]) == {"fit", "total"}
    assert "seconds" not in header


def test_a_single_clip_is_cross_validated_over_time():
    model = train(memory_dataset(clips=1, per_clip=24), dataclasses.replace(SMALL, kind="linear"))
    assert len(model.metadata["cross_validation"]) >= 2


def test_held_out_clips_change_nothing_but_their_error():
    data, other = memory_dataset(), memory_dataset()
    other.read("visibility", other.held_out_poses())  # a copy: change the array itself
    other.read("visibility")[other.held_out_poses()] *= 7.0
    other.read("pose")[other.held_out_poses()] += 1.0
    model, again = train(data, SMALL), train(other, SMALL)
    poses = data.read("pose", slice(4))
    assert np.array_equal(model(poses), again(poses))
    errors = [m.metadata["held_out_error"]["rms"] for m in (model, again)]
    assert errors[1] > errors[0]


def test_tensorboard_holds_scalars_and_histograms(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    watch = Recorder()
    with TensorBoard(tmp_path / "log", watch) as board:
        train(memory_dataset(), SMALL, board)
    events = EventAccumulator(str(tmp_path / "log"))
    events.Reload()
    tags = events.Tags()
    assert {"error/held_out", "fit/objective_0"} <= set(tags["scalars"])
    assert {"error/held_out_by_receiver", "fit/iterations"} <= set(tags["histograms"])
    assert [e.step for e in events.Scalars("fit/iterations_0_by_cluster")] == [0, 1, 2, 3]
    assert [e.value for e in events.Scalars("fit/objective_0")] == pytest.approx(
        [value for _, value in watch.scalars["fit/objective_0"]], rel=1e-6
    )
    assert watch.stages


@pytest.mark.parametrize("kind", ["constant", "linear", "neural"])
def test_how_each_clusters_fit_ended_can_be_plotted(kind):
    """Also of the closed form; a cluster that never changes says so."""
    data = memory_dataset()
    data.read("visibility")[:, :15] = 1.0  # those of one joint, most of a cluster
    watch = Recorder()
    networks = 2 if kind == "neural" else 1
    config = dataclasses.replace(SMALL, kind=kind, clusters=12, networks=networks)
    header = train(data, config, watch).metadata
    assert len(header["fits"]) == config.networks
    assert kind == "constant" or len(header["fit_status"]) > 1
    for network, told in enumerate(header["fits"]):
        for text, clusters in told["clusters"].items():
            name = text.replace(" ", "_")
            assert (network, len(clusters)) in watch.scalars[f"fit/{name}"]
            each = watch.scalars[f"fit/{name}_{network}_by_cluster"]
            assert each == [(cluster, float(cluster in clusters)) for cluster in range(12)]
        for what in ("iterations", "objective"):
            plotted = watch.scalars[f"fit/{what}_{network}_by_cluster"]
            assert plotted == list(enumerate(told[what]))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"clusters": 0}, "--clusters: must be at least 1"),
        ({"restarts": 0}, "--restarts: must be at least 1"),
        ({"feature_order": 4}, "--feature-order: must be at most 3"),
        ({"output_variance": 1.5}, "--output-variance"),
        ({"alpha": -1.0}, "--alpha: must be a finite number"),
        ({"alpha": float("nan")}, "--alpha: must be a finite number"),
        ({"latents": float("nan")}, "--latents: must be at least 0"),
        ({"seed": -1}, "--seed: must be at least 0"),
    ],
)
def test_impossible_configurations_are_told(options, told):
    with pytest.raises(PrtnetError, match=told):
        dataclasses.replace(SMALL, **options)


def test_impossible_requests_are_told():
    with pytest.raises(PrtnetError, match="'no_such_device' cannot be used"):
        train(memory_dataset(), dataclasses.replace(SMALL, device="no_such_device"))
    cache = memory_dataset()
    cache.joint_weights = cache.joint_parents = None
    with pytest.raises(PrtnetError, match="use joint_angles"):
        train(cache, dataclasses.replace(SMALL, features="occluders"))
    empty = memory_dataset()
    empty.training_poses = lambda: np.array([], dtype=int)
    with pytest.raises(PrtnetError, match="no training poses"):
        train(empty, SMALL)


def test_presets_are_valid_and_differ():
    assert {"default", "small", "fast", "large", "best", "tiny", "paper"} == set(PRESETS)
    assert len({tuple(dataclasses.asdict(p).items()) for p in PRESETS.values()}) == len(PRESETS)
