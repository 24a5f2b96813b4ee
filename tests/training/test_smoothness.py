from __future__ import annotations

import dataclasses

import numpy as np
import torch

from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.regression import fit_linear, ridge
from training.smoothness import change_covariance, consecutive
from training.train import train


def test_steps_follow_time_inside_one_clip():
    clip = np.array([1, 0, 1, 0, 2, 2, 1])
    time = np.array([0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0])
    assert consecutive(clip, time).T.tolist() == [[1, 3], [2, 0], [0, 6], [4, 5]]
    assert consecutive(clip, time, without=2).T.tolist() == [[1, 3], [2, 0], [0, 6]]


def test_a_gap_in_time_is_no_step():
    """Where part of a clip is held out, what is before and after it do not follow each other."""
    time = np.array([0.0, 0.1, 0.2, 2.2, 2.3])
    assert consecutive(np.zeros(5), time).T.tolist() == [[0, 1], [1, 2], [3, 4]]
    assert consecutive(np.arange(3), np.zeros(3)).shape == (2, 0)


def test_the_prior_is_the_mean_squared_step_of_the_prediction():
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(2, 9, 4, generator=generator, dtype=torch.float64)
    weight = torch.randn(2, 4, 3, generator=generator, dtype=torch.float64)
    steps = consecutive(np.array([0] * 5 + [1] * 4), np.arange(9.0))
    total = torch.zeros(2, dtype=torch.float64)
    for a, b in steps.T:
        moved = ((x[:, b] - x[:, a])[:, None] @ weight)[:, 0]
        total += moved.square().sum(-1) / steps.shape[1]
    form = (weight * (change_covariance(x, steps) @ weight)).sum((1, 2))
    assert torch.allclose(form, total)


def test_ridge_with_a_prior_is_at_its_minimum():
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(1, 30, 4, generator=generator, dtype=torch.float64)
    t = torch.randn(1, 30, 2, generator=generator, dtype=torch.float64)
    root = torch.randn(1, 4, 4, generator=generator, dtype=torch.float64)
    prior = root @ root.mT

    def objective(solution):
        weight = solution[:, :-1]
        residual = x @ weight + solution[:, -1:] - t
        value = residual.square().sum(-1).mean() + 0.1 * weight.square().sum()
        return value + (weight * (prior @ weight)).sum()

    best = ridge(x, t, 0.1, prior)
    for row in range(5):
        for sign in (-1e-3, 1e-3):
            moved = best.clone()
            moved[0, row, 0] += sign
            assert objective(moved) > objective(best)
    fitted = fit_linear(x, t, 0.1, prior)
    scale = (t - t.mean(1, keepdim=True)).square().mean(1).sum()
    assert torch.allclose(fitted.loss, objective(best) / scale)
    assert torch.allclose(fitted(x), x @ best[:, :-1] + best[:, -1:])


def test_every_cluster_keeps_its_own_prior_where_others_do_not_vary():
    generator = torch.Generator().manual_seed(2)
    x = torch.randn(3, 30, 4, generator=generator, dtype=torch.float64)
    t = torch.randn(3, 30, 2, generator=generator, dtype=torch.float64)
    t[0] = 2.0
    root = torch.randn(3, 4, 4, generator=generator, dtype=torch.float64)
    prior = root @ root.mT
    fitted = fit_linear(x, t, 0.1, prior)
    assert torch.equal(fitted(x)[0], t[0])
    for cluster in (1, 2):
        own = slice(cluster, cluster + 1)
        alone = ridge(x[own], t[own], 0.1, prior[own])[0]
        assert torch.allclose(fitted.weight[cluster], alone[:-1])


def test_a_smoother_model_moves_less_from_pose_to_pose():
    data = memory_dataset()
    rows = data.training_poses()
    poses = data.read("pose", rows)
    steps = {}
    for smoothness in (0.0, 30.0):
        config = dataclasses.replace(SMALL, kind="linear", features="joint_angles", alpha=1e-3)
        model = train(data, dataclasses.replace(config, smoothness=smoothness))
        steps[smoothness] = np.square(np.diff(model(poses)[:8], axis=0)).sum()
    assert 0 < steps[30.0] < 0.5 * steps[0.0]
