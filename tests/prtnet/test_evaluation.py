from __future__ import annotations

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
