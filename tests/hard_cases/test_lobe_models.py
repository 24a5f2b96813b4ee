"""Lobes that cannot be told from each other, have no axis, or are all alike."""

from __future__ import annotations

import dataclasses

import numpy as np
import onnxruntime
import pytest

from prtnet.sh import lower_hemisphere
from prtnet.zh import Lobes
from tests.hard_cases.measured import at_most, below, close, finite
from tests.models import random_poses
from tests.training.data import memory_dataset
from tests.training.test_lobe_targets import two_lobes, with_visibility
from tests.training.test_train import SMALL
from training.onnx_export import build_onnx
from training.train import train

OPEN = np.eye(1, 16, dtype=np.float32)[0] * np.sqrt(4 * np.pi, dtype=np.float32)
DARK = lower_hemisphere(4).astype(np.float32)


def fitted(data, **options):
    """A model that is finite everywhere, in NumPy and as a graph, with unit axes."""
    config = dataclasses.replace(SMALL, kind="lobes", alpha=1e-3, **options)
    model = train(data, config)
    everywhere = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    answer = model(everywhere)
    finite(answer)
    lobes = model.lobes_of(everywhere)
    close(np.linalg.norm(lobes.axes, axis=-1), 1.0, atol=1e-5)
    session = onnxruntime.InferenceSession(build_onnx(model).SerializeToString())
    got = session.run(None, {"pose": everywhere})[0]
    at_most(np.abs(got - answer).max(), 1e-5 * np.abs(answer).max() + 1e-6)
    return model


@pytest.mark.parametrize("lobes", [1, 2, 3])
@pytest.mark.parametrize("level", [OPEN, DARK, 0.0 * OPEN], ids=["open", "dark", "nothing"])
def test_always_lit_or_always_dark(lobes, level):
    data = with_visibility(memory_dataset(), np.broadcast_to(level, (24, 60, 16)).copy())
    model = fitted(data, lobes=lobes)
    assert model.latents.sum() == 0
    # Dark: one lobe about the normal holds it all, but for what the ridge takes off.
    close(model(data.read("pose")), np.broadcast_to(level, (24, 60, 16)), atol=0.02)


@pytest.mark.parametrize("regressor", ["linear", "neural"])
def test_open_receivers_among_others(regressor):
    data = two_lobes()
    data.read("visibility")[:, ::3] = OPEN
    model = fitted(data, regressor=regressor, latents=8)
    close(model(data.read("pose"))[:, ::3], np.broadcast_to(OPEN, (24, 20, 16)), atol=0.05)


@pytest.mark.parametrize("regressor", ["linear", "neural"])
def test_receivers_that_are_shadowed_in_one_pose_alone(regressor):
    """The axis means nothing in all the other poses, and they do not blur it."""
    data = two_lobes()
    truth = data.read("visibility")
    seen = truth[5].copy()
    truth[:, ::3] = OPEN
    truth[5, ::3] = seen[::3]
    model = fitted(data, regressor=regressor, latents=8)
    error = np.abs(model(data.read("pose", data.training_poses()))[:, ::3] - OPEN)
    below(np.median(error), 0.15)


@pytest.mark.parametrize("lobes", [1, 2])
def test_one_pose(lobes):
    data = with_visibility(
        memory_dataset(clips=1, per_clip=1), two_lobes(clips=1, per_clip=1).read("visibility")
    )
    model = fitted(data, lobes=lobes)
    assert model.latents.sum() == 0
    truth = data.read("visibility")
    error = np.linalg.norm(model(data.read("pose")) - truth) / np.linalg.norm(truth)
    below(error, 0.3 if lobes == 1 else 0.05)


def test_equal_poses():
    """The same pose again and again with different visibility."""
    data = memory_dataset(poses=np.repeat(random_poses(1, 4), 6, axis=0), clips=2)
    truth = two_lobes(clips=2, per_clip=3).read("visibility")
    model = fitted(with_visibility(data, truth))
    mean = truth[data.training_poses()].mean(axis=0)
    error = np.linalg.norm(model(data.read("pose")[:1])[0] - mean) / np.linalg.norm(mean)
    below(error, 0.1)


def test_two_lobes_that_merge_and_part():
    """They cross at the middle of the clip: which is which may change, coefficients stay small."""
    data = memory_dataset()
    angle = np.linspace(-1.0, 1.0, 24)[:, None]
    axes = np.zeros((24, 60, 2, 3))
    axes[..., 2] = 1.0
    axes[..., 0, 0], axes[..., 1, 0] = angle, -angle
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    g = np.broadcast_to([1.5, 0.6, 0.4, 0.2], (24, 60, 2, 4))
    truth = Lobes(axes, g).harmonics().astype(np.float32)
    model = fitted(with_visibility(data, truth), latents=8)
    lobes = model.lobes_of(data.read("pose"))
    below(np.abs(lobes.coefficients).max(), 10.0)


def test_a_single_lobe_seen_by_two():
    """A function that one lobe holds leaves the other nothing to do."""
    data = two_lobes()
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(60, 1, 3)) + 0.1 * rng.normal(size=(24, 60, 1, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    g = np.broadcast_to([3.0, 0.9, 0.5, 0.2], (24, 60, 1, 4))
    truth = Lobes(axes, g).harmonics().astype(np.float32)
    model = fitted(with_visibility(data, truth), latents=20)
    poses = data.read("pose", data.training_poses())
    mean = truth[data.training_poses()].mean(axis=0)
    below(np.linalg.norm(model.training_mean - mean), 1e-4 * np.linalg.norm(mean))
    below(
        np.linalg.norm(model(poses) - truth[data.training_poses()]),
        0.3 * np.linalg.norm(truth[data.training_poses()]),
    )
