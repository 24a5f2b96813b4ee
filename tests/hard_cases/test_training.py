"""Data that starves or overfeeds a fit: each gives a finite answer or a clear error."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from prtnet.metrics import relative_rms
from tests.hard_cases.measured import above, at_most, below, close, finite, refuses
from tests.models import random_poses
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.train import train

KINDS = [
    *itertools.product(["linear", "neural"], ["joint_angles", "occluders"]),
    ("quadratic", "local_joints"),
]


def fitted(data, kind, features, **options):
    config = dataclasses.replace(SMALL, kind=kind, features=features, **options)
    model = train(data, config)
    everywhere = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    finite(model(everywhere))
    return model


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_one_pose(kind, features, device):
    data = memory_dataset(clips=1, per_clip=1)
    model = fitted(data, kind, features, device=device)
    close(model(data.read("pose")), data.read("visibility"), atol=1e-5)


@pytest.mark.parametrize("count", [2, 6])
@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_equal_poses(kind, features, count, device):
    """The same pose twice with different visibility: nothing can tell them apart."""
    poses = np.repeat(random_poses(1, 4), count, axis=0)
    data = memory_dataset(poses=poses, clips=count // 2)
    data.read("visibility")[::2] += 0.5
    model = fitted(data, kind, features, device=device)
    mean = data.read("visibility", data.training_poses()).mean(axis=0)
    close(model(poses[:1])[0], mean, atol=1e-4)


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_fewer_poses_than_components(kind, features, device):
    model = fitted(memory_dataset(clips=2, per_clip=3), kind, features, device=device, latents=50.0)
    at_most(model.latents.max(), 2)


@pytest.mark.parametrize("level", [0.0, 3.5449])
@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_always_lit_or_always_dark(level, kind, features, device):
    data = memory_dataset()
    data.read("visibility")[:] = level
    model = fitted(data, kind, features, device=device)
    close(model(data.read("pose")), level, atol=1e-6)
    assert model.latents.sum() == 0


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_one_constant_cluster_among_others(kind, features, device):
    data = memory_dataset()
    data.read("visibility")[:, :15] = 1.0
    model = fitted(data, kind, features, device=device)
    close(model(data.read("pose"))[:, :5], 1.0, atol=0.2)


@pytest.mark.parametrize(("kind", "features"), KINDS)
@pytest.mark.parametrize("poses", [1, 2, 8])
def test_no_weight_decay_at_all(kind, features, poses, device):
    """Also where there are fewer poses than weights, so that many fits are perfect."""
    fitted(memory_dataset(clips=2, per_clip=poses), kind, features, device=device, alpha=0.0)


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_a_joint_that_never_moves(kind, features, device):
    data = memory_dataset()
    poses = data.read("pose").reshape(-1, 4, 3, 4)
    poses[:, 2, :, :3] = poses[:, 1, :, :3]  # at rest on its parent, in every clip
    model = fitted(data, kind, features, device=device)
    if features == "joint_angles":
        assert model.metadata["dropped_joints"] == ["joint2"]
    rows = data.training_poses()
    truth = data.read("visibility", rows)
    mean = np.broadcast_to(truth.mean(axis=0), truth.shape)
    below(relative_rms(model(data.read("pose", rows)), truth), relative_rms(mean, truth))


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_far_from_the_training_poses(kind, features, device):
    """Joints a hundred times farther apart than ever seen."""
    data = memory_dataset()
    model = fitted(data, kind, features, device=device)
    far = data.read("pose", slice(3)).copy()
    far.reshape(3, 4, 3, 4)[..., 3] *= 100.0
    finite(model(far))


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_far_outside_the_training_range_is_hardly_worse_than_the_mean(kind, features, device):
    """Inputs ten times as far out as any seen: the answer fades to the mean."""
    data = memory_dataset()
    model = fitted(data, kind, features, device=device, alpha=1e-4)
    rows = data.training_poses()
    truth = data.read("visibility", rows)
    middle = (model.input_low + model.input_high) / 2
    wild = middle + 10.0 * (model.reduced(data.read("pose", rows)) - middle)

    def error(model):
        return relative_rms(model.decode(model.latent(data.read("pose", rows))), truth)

    usual = relative_rms(np.broadcast_to(truth.mean(axis=0), truth.shape), truth)
    object.__setattr__(model, "reduced", lambda _: wild.astype(np.float32))
    at_most(error(model), 1.05 * usual)
    free = dataclasses.replace(model, input_low=None, input_high=None)
    object.__setattr__(free, "reduced", lambda _: wild.astype(np.float32))
    if kind == "linear":
        above(error(free), 2.0 * usual)  # what an extrapolation says


def test_training_range_holds_the_training_poses(device):
    data = memory_dataset()
    model = fitted(data, "linear", "occluders", device=device)
    below(model.novelty(data.read("pose", data.training_poses())).max(), 1e-5)
    above(model.novelty(data.read("pose", data.held_out_poses())).max(), 1e-3)


@pytest.mark.parametrize("clustering", ["weights", "rigid", "signal"])
def test_clusterings_of_next_to_nothing(clustering, device):
    """One pose, visibility that never changes, joints that never move, clusters without number."""
    constant = memory_dataset()
    constant.read("visibility")[:] = 1.0
    still = memory_dataset(poses=np.repeat(random_poses(1, 4), 6, axis=0), clips=2)
    for data in (memory_dataset(clips=1, per_clip=1), constant, still):
        for clusters in (4, 500):
            options = {"clustering": clustering, "clusters": clusters, "device": device}
            fitted(data, "linear", "joint_angles", **options)


def test_more_clusters_than_receivers(device):
    model = fitted(memory_dataset(), "linear", "joint_angles", device=device, clusters=500)
    assert len(model.latents) == 60


def test_poses_that_are_not_finite_are_refused(device):
    data = memory_dataset()
    model = fitted(data, "linear", "occluders", device=device)
    broken = data.read("pose", slice(1)).copy()
    broken[0, 7] = np.inf
    with refuses(match="not finite"):
        model(broken)


@pytest.mark.parametrize("array", ["pose", "visibility"])
def test_datasets_that_are_not_finite_are_refused(array):
    data = memory_dataset()
    data.read(array)[1].flat[3] = np.nan
    with refuses(match="not finite"):
        train(data, SMALL)
