"""Receivers whose neighbours belong to another cluster, or to another group of their own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.seams import JumpSum, cluster_of_receiver
from prtnet.storage import STORAGES
from tests.hard_cases.measured import above, below
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.train import train

RECEIVERS = 60
EDGES = np.stack([np.arange(RECEIVERS - 1), np.arange(1, RECEIVERS)], axis=1)


def strip():
    """Receivers in a row, whose visibility changes smoothly along it and with the pose."""
    place = np.arange(RECEIVERS) / RECEIVERS
    mood = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2))  # what moves the poses, too
    slow = np.stack([np.sin(2.0 * np.pi * place), np.cos(3.0 * np.pi * place)])
    wave = np.tanh(mood @ slow)[..., None] * np.array([1.0, 0.6, -0.4, 0.3])
    fine = 0.1 * np.sin(np.arange(RECEIVERS))[:, None] * np.ones(4)
    data = memory_dataset(visibility=3.5 + wave + fine, clips=5, per_clip=12)
    data.rest_positions = np.stack([place, 0 * place, 0 * place], axis=1).astype(np.float32)
    return data


@pytest.mark.parametrize("kind", ["linear", "quadratic", "neural"])
@pytest.mark.parametrize("parts", [1, 3])
def test_the_error_jumps_less_than_visibility_varies_inside_clusters(kind, parts):
    """On held-out poses, however it is stored: at borders of clusters, and of their groups."""
    data = strip()
    config = dataclasses.replace(
        SMALL, kind=kind, features="joint_angles", latents=6, alpha=1e-3, parts=parts
    )
    model = train(data, config)
    held = data.held_out_poses()
    truth = data.read("visibility", held)
    owner = cluster_of_receiver(model.receivers)
    assert len(np.unique(owner)) == 4 * parts
    truths = JumpSum(EDGES)
    truths.add(truth)
    for storage in STORAGES:
        errors = JumpSum(EDGES)
        errors.add(model.stored_as(storage)(data.read("pose", held)) - truth)
        above(errors.rms(owner)[0], 0.0)
        below(errors.rms(owner)[0], truths.rms(owner)[1])
