"""Searches with nothing to find: each ends in a model or in one line."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tests.hard_cases.measured import below, close, finite
from tests.models import random_poses
from tests.training.data import memory_dataset
from tests.training.test_search import FEW, SMALL, by_size
from training import search as module
from training.budget import Budget
from training.onnx_export import build_onnx
from training.search import search


@pytest.fixture(autouse=True)
def two_families(monkeypatch):
    own = {n: {**module.FAMILIES[n], **FEW} for n in ("linear", "neural")}
    monkeypatch.setattr(module, "FAMILIES", own)


@pytest.mark.parametrize("level", [0.0, 3.5449])
@pytest.mark.parametrize("limits", [{}, {"max_mb": 1.0}, {"max_error": 0.05}])
def test_always_lit_or_always_dark(level, limits, device):
    """A mean and nothing else, at no error."""
    data = memory_dataset(clips=4)
    data.read("visibility")[:] = level
    kind = "neural" if limits else "auto"
    model = search(
        data, dataclasses.replace(SMALL, kind=kind, device=device), Budget(**limits), by_size
    )
    assert model.latents.sum() == 0
    below(model.metadata["search"]["chosen"]["error"], 2e-3)
    everywhere = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    close(model(everywhere), level, atol=0.01 * 3.6)
    build_onnx(model)


def test_noise_that_no_pose_explains():
    """Components do harm on what was left out: the mean alone is kept, or little more."""
    data = memory_dataset(clips=4, per_clip=12)
    noise = np.random.default_rng(0).normal(size=data.read("visibility").shape)
    data.read("visibility")[:] = 3.0 + noise
    model = search(data, SMALL, Budget(max_mb=10.0), by_size)
    plain = dataclasses.replace(model, latents=0 * model.latents, basis=model.basis[:0])
    held = data.held_out_poses()
    errors = [
        np.linalg.norm(m(data.read("pose", held)) - data.read("visibility", held))
        for m in (model, dataclasses.replace(plain, coding=None))
    ]
    below(errors[0], 1.1 * errors[1])


def test_equal_poses_and_a_single_joint_that_moves():
    data = memory_dataset(clips=4, per_clip=8)
    poses = data.read("pose")
    poses[:, 12:] = poses[:1, 12:]
    poses[8:16] = poses[8]
    model = search(data, SMALL, Budget(max_mb=10.0), by_size)
    finite(model(np.concatenate([poses, random_poses(5, 4, seed=9)])))
