from __future__ import annotations

import numpy as np
import pytest
import torch
from sklearn.linear_model import Ridge

from training.regression import (
    average,
    fit_linear,
    fit_neural,
    projected_objective,
    ridge,
    target_scale,
)


def problem(clusters=3, poses=60, inputs=4, latents=2, seed=0, dtype=torch.float64):
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(clusters, poses, inputs, generator=generator, dtype=torch.float64)
    mix = torch.randn(clusters, inputs, latents, generator=generator, dtype=torch.float64)
    return x.to(dtype), torch.tanh(2.0 * x @ mix).to(dtype)


def test_ridge_equals_scikit_learn():
    x, t = problem()
    solution = ridge(x, t, alpha=0.1)
    for cluster in range(len(x)):
        peer = Ridge(alpha=0.1 * x.shape[1]).fit(x[cluster], t[cluster])
        assert np.allclose(solution[cluster, :-1], peer.coef_.T, atol=1e-10)
        assert np.allclose(solution[cluster, -1], peer.intercept_, atol=1e-10)


def test_gradient_of_the_projected_objective():
    x, t = problem(clusters=2, poses=15)
    objective = projected_objective(x, t, neurons=3, alpha=0.02)
    flat = torch.randn(2, 15, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    everyone = torch.arange(2)
    _, gradient = objective(flat, everyone)
    for k in range(flat.shape[1]):
        step = torch.zeros_like(flat)
        step[:, k] = 1e-6
        central = (objective(flat + step, everyone)[0] - objective(flat - step, everyone)[0]) / 2e-6
        assert torch.allclose(gradient[:, k], central, rtol=1e-5, atol=1e-7)


def test_subset_of_problems_is_evaluated_alike():
    x, t = problem()
    objective = projected_objective(x, t, neurons=3, alpha=0.02)
    flat = torch.randn(3, 15, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    full = objective(flat, torch.arange(3))
    part = objective(flat[[2]], torch.tensor([2]))
    assert torch.allclose(full[0][2], part[0][0])
    assert torch.allclose(full[1][2], part[1][0])


def test_network_learns_what_a_line_cannot():
    x, t = problem(poses=400)
    linear, neural = fit_linear(x, t, 1e-4), fit_neural(x, t, 8, 1e-6, iterations=200)
    signal = (t - t.mean(1, keepdim=True)).square().mean()
    assert (neural(x) - t).square().mean() < 0.01 * signal
    assert (linear(x) - t).square().mean() > 0.05 * signal
    fresh, truth = problem(poses=400, seed=0)
    assert torch.equal(neural(fresh), neural(x))
    assert truth.shape == t.shape


def test_loss_is_the_objective_of_the_returned_weights():
    x, t = problem()
    scaled = t / target_scale(t)
    fitted = fit_neural(x, t, 5, 0.01, iterations=30)
    residual = (fitted(x) / target_scale(t) - scaled).square().sum(-1).mean(-1)
    weights = (fitted.weight / target_scale(t)).square().sum((1, 2))
    value = residual + 0.01 * (weights + fitted.hidden_weight.square().sum((1, 2)))
    assert torch.allclose(value, fitted.loss, rtol=1e-6)


def test_single_precision_reaches_the_same_objective():
    x, t = problem(clusters=4, poses=200, inputs=10, latents=4)
    double = fit_neural(x, t, 16, 1e-3, iterations=80)
    single = fit_neural(x.float(), t.float(), 16, 1e-3, iterations=80)
    assert torch.allclose(single.loss.double(), double.loss, rtol=0.05)


def test_average_of_networks_is_one_network():
    x, t = problem()
    fits = [fit_neural(x, t, 4, 1e-3, iterations=20, seed=seed) for seed in range(3)]
    mean = torch.stack([f(x) for f in fits]).mean(0)
    joined = average(fits)
    assert joined.weight.shape[1] == 12
    assert torch.allclose(joined(x), mean, atol=1e-10)
    with pytest.raises(ValueError, match="only networks"):
        average([fit_linear(x, t, 0.1)] * 2)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("poses", [6, 60])
def test_no_weight_decay_and_dependent_columns(dtype, poses):
    """More inputs than poses, or inputs twice over: of many solutions a sane one is found."""
    x, t = problem(poses=poses, inputs=5, dtype=dtype)
    x = torch.cat([x, x, x[..., :1] + x[..., 1:2]], dim=-1)
    linear = fit_linear(x, t, 0.0)
    assert linear.weight.abs().max() < 100.0
    signal = (t - t.mean(1, keepdim=True)).square().sum()
    if poses == 6:  # enough freedom to pass through all of them
        assert (linear(x) - t).square().sum() < 1e-3 * signal
    else:
        assert (linear(x) - t).square().sum() < 0.9 * signal
    neural = fit_neural(x, t, 8, 0.0, iterations=30)
    assert torch.isfinite(neural(x)).all()
    assert (neural(x) - t).square().sum() < 0.9 * signal
