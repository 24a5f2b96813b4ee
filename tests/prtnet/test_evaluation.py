from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.evaluation import NearestPose, TruthBlock, dataset_truth, evaluate
from prtnet.metrics import relative_rms
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.train import train


@pytest.fixture(scope="module")
def data():
    return memory_dataset()


@pytest.fixture(scope="module")
def model(data):
    return train(data, SMALL)


def test_yardsticks_are_what_they_say(data, model):
    blocks = dataset_truth(model, data, data.clip_names, 3)
    result = evaluate(model, model, blocks, NearestPose(data))
    rows = data.held_out_poses()
    truth = data.read("visibility", rows)
    mean = data.read("visibility", data.training_poses()).mean(axis=0)
    assert result["rms"] == pytest.approx(relative_rms(model(data.read("pose", rows)), truth))
    assert result["signal"] == pytest.approx(
        relative_rms(np.broadcast_to(mean, truth.shape), truth), rel=1e-5
    )
    best = model.decode(model.encode(truth))
    assert result["pca_floor"] == pytest.approx(relative_rms(best, truth), rel=1e-6)
    assert result["pca_floor"] <= result["rms"]
    assert [clip["held_out"] for clip in result["clips"].values()] == [False, False, True]
    assert result["clips"]["clip2"]["rms"] == pytest.approx(result["rms"])


def test_nearest_pose_of_a_training_pose_is_itself(data):
    nearest = NearestPose(data)
    rows = data.training_poses()[[3, 0, 5]]
    assert np.array_equal(nearest(data.read("pose", rows)), data.read("visibility", rows))


def test_nearest_pose_ignores_where_the_body_stands(data):
    nearest = NearestPose(data)
    rows = data.training_poses()[:4]
    moved = data.read("pose", rows).copy()
    moved.reshape(4, -1, 3, 4)[..., 3] += 50.0
    assert np.array_equal(nearest(moved), data.read("visibility", rows))


def test_all_clips_count_where_none_is_held_out(data, model):
    poses, truth = data.read("pose", slice(4)), data.read("visibility", slice(4))
    blocks = [
        TruthBlock("a", False, poses[:2], truth[:2]),
        TruthBlock("b", False, poses[2:], truth[2:]),
    ]
    result = evaluate(model, model, blocks)
    assert result["rms"] == pytest.approx(relative_rms(model(poses), truth))
    assert result["nearest"] is None
    assert result["nearest_distance"] is None
    assert result["poses"][0]["time"] is None


def test_poses_and_clips_tell_the_same(data, model):
    nearest = NearestPose(data)
    result = evaluate(model, model, dataset_truth(model, data, data.clip_names, 3), nearest)
    clips = [data.clip_names[k] for k in data.read("clip")]
    assert [pose["clip"] for pose in result["poses"]] == clips
    assert [pose["time"] for pose in result["poses"]] == data.read("time").tolist()
    truth, predicted = data.read("visibility"), model(data.read("pose"))
    for row, pose in enumerate(result["poses"]):
        assert pose["rms"] == pytest.approx(relative_rms(predicted[[row]], truth[[row]]))
    held = [pose for pose in result["poses"] if pose["clip"] == "clip2"]
    for name in ("distance", "nearest_distance"):
        values = [pose[name] for pose in held]
        assert result["clips"]["clip2"][name] == result[name]
        assert result[name] == pytest.approx({"mean": np.mean(values), "max": max(values)})
    step = np.diff((predicted - truth)[data.held_out_poses()], axis=0)
    motion = np.diff(truth[data.held_out_poses()], axis=0)
    expected = np.sqrt((step**2).sum() / (motion**2).sum())
    assert result["coherence"] == pytest.approx(expected, rel=1e-5)


def test_training_poses_are_at_no_distance(data, model):
    nearest = NearestPose(data)
    result = evaluate(model, model, dataset_truth(model, data, data.clip_names), nearest)
    for pose in result["poses"]:
        if pose["clip"] != "clip2":
            assert pose["distance"] < 1e-5
            assert pose["nearest_distance"] < 0.01


def test_distance_counts_in_the_spacing_of_training_poses(data):
    """Twice as far from the only neighbour as training poses are from theirs."""
    nearest = NearestPose(data)
    known = nearest.describe(data.read("pose", data.training_poses())).astype(float)
    every = np.linalg.norm(known[:, None] - known[None], axis=-1) + 1e9 * np.eye(len(known))
    assert nearest.spacing == pytest.approx(np.median(every.min(axis=1)), rel=1e-3)
    far = data.read("pose", data.held_out_poses())
    wanted = nearest.describe(far).astype(float)
    expected = np.linalg.norm(wanted[:, None] - known[None], axis=-1).min(axis=1)
    assert nearest.distance(far) == pytest.approx(expected / nearest.spacing, rel=1e-3)


def test_models_that_do_not_know_their_range_tell_no_distance(data, model):
    free = dataclasses.replace(model, input_low=None, input_high=None)
    result = evaluate(free, free, dataset_truth(free, data, ["clip2"]))
    assert result["distance"] is None
    assert result["poses"][0]["distance"] is None
