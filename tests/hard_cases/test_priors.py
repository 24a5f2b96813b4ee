"""Models that look around every receiver, where there is too little to see or too far to go."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.metrics import relative_rms
from prtnet.storage import STORAGES
from runtime.onnx_model import OnnxModel
from tests.hard_cases.measured import at_least, at_most, below, close, finite, refuses
from tests.models import random_model, random_poses
from tests.priors import beside_prior, random_prior, sheet_with_prior
from tests.runtime.shader import shaded
from tests.skin import random_skin
from tests.training.data import memory_dataset
from tests.training.test_train import PRIOR, SMALL
from training.onnx_export import build_onnx
from training.train import train

KINDS = ["hybrid", "shared"]
HALF = float(np.finfo(np.float16).max)


def fitted(data, kind, **options):
    config = dataclasses.replace(SMALL, kind=kind, **{"samples": 2000, **PRIOR, **options})
    return train(data, config)


def usual(data):
    """The mean's error on its own training poses."""
    truth = data.read("visibility", data.training_poses())
    return relative_rms(np.broadcast_to(truth.mean(axis=0), truth.shape), truth)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("storage", ["float32", "int4"])
def test_far_poses_stay_within_what_training_saw(kind, storage, device):
    data = memory_dataset(per_clip=12)
    model = fitted(data, kind, device=device, latents=4, alpha=1e-2, storage=storage)
    rows = data.training_poses()
    poses, truth = data.read("pose", rows), data.read("visibility", rows)
    middle = poses.mean(axis=0)
    for times in (1.0, 10.0, 100.0):
        far = (middle + times * (poses - middle)).astype(np.float32)
        value = model(far)
        low, high = truth.min(axis=(0, 1)), truth.max(axis=(0, 1))
        at_least(value, low - 1e-6)
        at_most(value, high + 1e-6)
        below(relative_rms(value, truth), 0.5)  # of values that lie between 2.5 and 4.5
    graph = OnnxModel(build_onnx(model).SerializeToString(), threads=1)
    at_most(np.abs(graph(far) - value).max(), 1e-4 * np.abs(value).max())
    free = dataclasses.replace(model, bounds=None)
    at_least(relative_rms(free(far), truth), relative_rms(value, truth) - 1e-6)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("poses", [1, 2])
def test_one_pose_and_two_equal_ones(kind, poses, device):
    pose = np.repeat(random_poses(1, 4), poses, axis=0)
    data = memory_dataset(poses=pose, clips=1)
    model = fitted(data, kind, device=device)
    mean = data.read("visibility").mean(axis=0)
    below(np.abs(model(pose[:1])[0] - mean).max(), 0.05 * np.abs(mean).max())
    finite(model(random_poses(5, 4, seed=9)))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("level", [0.0, 3.5449])
def test_always_lit_or_always_dark(kind, level, device):
    data = memory_dataset()
    data.read("visibility")[:] = level
    model = fitted(data, kind, device=device)
    everywhere = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    close(model(everywhere), level, 0.0, 1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_fewer_poses_than_anything(kind, device):
    data = memory_dataset(clips=2, per_clip=3)
    model = fitted(data, kind, device=device, latents=50.0, samples=50)
    value = model(random_poses(20, 4, seed=9))
    truth = data.read("visibility", data.training_poses())
    finite(value)
    at_most(np.abs(value).max(), np.abs(truth).max() + 1e-6)
    below(usual(data), 0.5)


def at_rest(skin):
    """Joints that leave everything where it is: what is equal at rest is equal in float32, too."""
    still = np.tile(np.eye(4)[:3], (skin.joints, 1, 1)).astype(np.float32)
    skin = dataclasses.replace(skin, size=1.0, rest_inverse=still)
    return skin, still.reshape(1, -1)


def shader_error(skin, poses, kind="maps"):
    """Of the vertex shader, relative to the largest coefficient."""
    prior = random_prior(kind, receivers=40, surroundings=skin)
    model = beside_prior(random_model(receivers=40), prior)
    expected = model(poses)
    finite(expected)
    return np.abs(shaded(model, poses) - expected).max() / np.abs(expected).max()


@pytest.mark.gl
@pytest.mark.parametrize("times", [1.0, 0.5, 1.0001, 0.0])
def test_a_shader_knows_receivers_in_and_on_spheres(times):
    """Each receiver is so many radii away from the centre of a sphere."""
    skin, pose = at_rest(random_skin())
    spheres = skin.near_spheres[skin.cluster, 0]
    toward = np.array([0.0, 0.6, 0.8], dtype=np.float32)
    away = np.float32(times) * skin.sphere_radius[spheres, None] * toward
    skin = dataclasses.replace(skin, position=skin.sphere_centre[spheres] + away)
    # One joint each: weights that blend equal matrices would round where the receiver is.
    one = np.eye(3, dtype=np.float32)[np.zeros(40, dtype=int)]
    skin = dataclasses.replace(skin, skin_weight=one)
    at_most(shader_error(skin, pose), 3e-6)


@pytest.mark.gl
@pytest.mark.parametrize(
    "nothing",
    [
        {"near_spheres": np.zeros((6, 0), dtype=np.int32)},
        {"near_patches": np.zeros((6, 0), dtype=np.int32)},
        {"sphere_joint": np.full(11, 2, dtype=np.int32), "own_joint": np.full(6, 2, np.int32)},
        {"sphere_joint": np.full(11, 2, dtype=np.int32), "own_joint": np.full(6, 1, np.int32)},
        {"sphere_radius": np.zeros(11, dtype=np.float32)},
        {"patch_area": np.zeros((13, 3), dtype=np.float32)},
    ],
    ids=["no sphere", "no patch", "own spheres only", "foreign only", "points", "flat patches"],
)
@pytest.mark.parametrize("kind", ["maps", "network"])
def test_a_shader_with_nothing_to_see(nothing, kind):
    skin = dataclasses.replace(random_skin(), **nothing)
    at_most(shader_error(skin, random_poses(2, 5), kind), 3e-6)


@pytest.mark.gl
@pytest.mark.parametrize("kind", ["maps", "network"])
def test_a_shader_stays_within_the_range_of_training(kind):
    """Limbs in each other and gone far away: features outside on both sides."""
    skin = random_skin()
    poses = random_poses(4, 5, seed=8).reshape(4, 5, 3, 4)
    poses[:2, :, :, 3] *= 0.01
    poses[2:, 1:, :, 3] *= 300.0
    poses = poses.reshape(4, -1)
    prior = random_prior(kind, receivers=40, surroundings=skin)
    seen = skin(poses)
    assert (seen > prior.high + 1.0).any()
    assert (seen < prior.low - 0.01).any()
    # At 300 m float32 knows places to 10 micrometres.
    at_most(shader_error(skin, poses, kind), 1e-4)


@pytest.mark.gl
def test_a_shader_with_joints_of_no_size():
    """Limbs scaled to nothing have neither normals nor spheres."""
    poses = random_poses(2, 5).reshape(2, 5, 3, 4)
    poses[:, 1:3, :, :3] = 0.0
    at_most(shader_error(random_skin(), poses.reshape(2, -1)), 3e-6)


@pytest.mark.gl
@pytest.mark.parametrize("kind", ["maps", "network"])
def test_a_shader_of_a_sheet_that_is_crumpled_flat_or_far_away(kind):
    model, poses = sheet_with_prior(kind)
    rng = np.random.default_rng(5)
    flat = poses[-1].reshape(-1, 3) * [1.0, 0.0, 1.0]
    hard = np.stack([flat.ravel(), rng.normal(size=poses.shape[1]), np.zeros(poses.shape[1]),
                     np.round((poses[-1] + 512.0) * 4096) / 4096]).astype(np.float32)  # fmt: skip
    expected = model(hard)
    at_most(np.abs(shaded(model, hard) - expected).max(), 3e-6 * np.abs(expected).max())


@pytest.mark.parametrize("kind", KINDS)
def test_no_weight_decay_at_all(kind, device):
    data = memory_dataset(clips=2, per_clip=3)
    model = fitted(data, kind, device=device, latents=4, alpha=0.0)
    truth = data.read("visibility", data.training_poses())
    value = model(np.concatenate([data.read("pose"), random_poses(9, 4, seed=9)]))
    at_least(value, truth.min() - 1e-6)
    at_most(value, truth.max() + 1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_joints_that_never_move_or_only_in_held_out_clips(kind, device):
    for everywhere in (True, False):
        data = memory_dataset()
        poses = data.read("pose").reshape(-1, 4, 3, 4)
        rows = slice(None) if everywhere else data.training_poses()
        poses[rows, 2, :, :3] = poses[rows, 1, :, :3]  # at rest on its parent
        model = fitted(data, kind, device=device, latents=4)
        held = data.held_out_poses()
        value, truth = model(data.read("pose", held)), data.read("visibility", held)
        below(relative_rms(value, truth), 0.5)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("extreme", [HALF, 6e-8])
def test_half_precision_extremes(kind, extreme, device):
    data = memory_dataset()
    data.read("visibility")[::2, 3] = extreme
    model = fitted(data, kind, device=device, latents=4)
    everywhere = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    for storage in STORAGES:
        finite(model.stored_as(storage)(everywhere))


def test_a_loss_that_is_not_finite_is_told(device):
    data = memory_dataset()
    data.read("visibility")[::2, 3] = 1e30
    with refuses(match="shared network's loss is not finite after"):
        fitted(data, "shared", device=device)
