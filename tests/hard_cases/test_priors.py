"""Models that look around every receiver, where there is too little to see or too far to go."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.metrics import relative_rms
from runtime.onnx_model import OnnxModel
from tests.models import random_poses
from tests.training.data import memory_dataset
from tests.training.test_train import PRIOR, SMALL
from training.onnx_export import build_onnx
from training.train import train

KINDS = ["hybrid", "shared"]


def fitted(data, kind, **options):
    config = dataclasses.replace(SMALL, kind=kind, **{"samples": 2000, **PRIOR, **options})
    return train(data, config)


def usual(data):
    """The mean's error on its own training poses."""
    truth = data.read("visibility", data.training_poses())
    return relative_rms(np.broadcast_to(truth.mean(axis=0), truth.shape), truth)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("storage", ["float32", "int4"])
def test_far_poses_stay_within_what_training_saw(kind, storage):
    data = memory_dataset(per_clip=12)
    model = fitted(data, kind, latents=4, alpha=1e-2, storage=storage)
    rows = data.training_poses()
    poses, truth = data.read("pose", rows), data.read("visibility", rows)
    middle = poses.mean(axis=0)
    for times in (1.0, 10.0, 100.0):
        far = (middle + times * (poses - middle)).astype(np.float32)
        value = model(far)
        low, high = truth.min(axis=(0, 1)), truth.max(axis=(0, 1))
        assert (value >= low - 1e-6).all()
        assert (value <= high + 1e-6).all()
        assert relative_rms(value, truth) < 0.5  # of values that lie between 2.5 and 4.5
    graph = OnnxModel(build_onnx(model).SerializeToString(), threads=1)
    assert np.abs(graph(far) - value).max() <= 1e-4 * np.abs(value).max()
    free = dataclasses.replace(model, bounds=None)
    assert relative_rms(free(far), truth) >= relative_rms(value, truth) - 1e-6


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("poses", [1, 2])
def test_one_pose_and_two_equal_ones(kind, poses):
    pose = np.repeat(random_poses(1, 4), poses, axis=0)
    data = memory_dataset(poses=pose, clips=1)
    model = fitted(data, kind)
    mean = data.read("visibility").mean(axis=0)
    assert np.abs(model(pose[:1])[0] - mean).max() < 0.05 * np.abs(mean).max()
    assert np.isfinite(model(random_poses(5, 4, seed=9))).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("level", [0.0, 3.5449])
def test_always_lit_or_always_dark(kind, level):
    data = memory_dataset()
    data.read("visibility")[:] = level
    model = fitted(data, kind)
    everywhere = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    assert model(everywhere) == pytest.approx(level, abs=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_fewer_poses_than_anything(kind):
    data = memory_dataset(clips=2, per_clip=3)
    model = fitted(data, kind, latents=50.0, samples=50)
    value = model(random_poses(20, 4, seed=9))
    truth = data.read("visibility", data.training_poses())
    assert np.isfinite(value).all()
    assert np.abs(value).max() <= np.abs(truth).max() + 1e-6
    assert usual(data) < 0.5
