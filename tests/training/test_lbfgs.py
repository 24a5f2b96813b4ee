from __future__ import annotations

import pytest
import torch

from training.lbfgs import minimise


def rosenbrock(scale):
    def objective(x, index):
        x = x.detach().requires_grad_()
        a, b = x[:, 0], x[:, 1]
        value = scale[index] * ((1 - a) ** 2 + 100 * (b - a**2) ** 2)
        (gradient,) = torch.autograd.grad(value.sum(), x)
        return value.detach(), gradient

    return objective


def test_each_problem_reaches_its_own_minimum():
    """Scales that differ by 1e8: one shared step length could not serve them all."""
    scale = torch.tensor([1e-4, 1.0, 1e4], dtype=torch.float64)
    start = torch.tensor([[-1.2, 1.0], [0.0, 3.0], [2.0, -2.0]], dtype=torch.float64)
    result = minimise(rosenbrock(scale), start, iterations=300, tolerance=1e-12)
    assert torch.allclose(result.x, torch.ones(3, 2, dtype=torch.float64), atol=1e-4)
    assert result.status == ["converged"] * 3


def test_a_batch_is_no_different_from_one_at_a_time():
    scale = torch.tensor([1.0, 7.0], dtype=torch.float64)
    start = torch.tensor([[-1.2, 1.0], [0.5, 2.0]], dtype=torch.float64)
    both = minimise(rosenbrock(scale), start, iterations=17)
    for k in range(2):
        alone = minimise(rosenbrock(scale[k : k + 1]), start[k : k + 1], iterations=17)
        assert torch.allclose(alone.x[0], both.x[k], rtol=1e-12, atol=1e-12)


def test_quadratic_takes_few_iterations():
    torch.manual_seed(0)
    root = torch.randn(4, 10, 10, dtype=torch.float64)
    matrix = root @ root.mT + torch.eye(10, dtype=torch.float64)
    target = torch.randn(4, 10, dtype=torch.float64)

    def objective(x, index):
        g = (matrix[index] @ (x - target[index])[..., None])[..., 0]
        return 0.5 * ((x - target[index]) * g).sum(1), g

    result = minimise(objective, torch.zeros(4, 10, dtype=torch.float64), iterations=100)
    assert torch.allclose(result.x, target, atol=1e-2)
    assert int(result.iterations.max()) < 60


def test_values_that_overflow_are_steps_too_long():
    """exp(x) − x from far away: the first steps overflow, the minimum is at 0."""

    def objective(x, index):
        return (torch.exp(x * 50) - 50 * x).sum(1), 50 * torch.exp(x * 50) - 50

    start = torch.tensor([[-30.0], [1.0]], dtype=torch.float64)
    result = minimise(objective, start, iterations=200)
    assert torch.isfinite(result.x).all()
    assert torch.allclose(result.x, torch.zeros_like(start), atol=1e-2)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_problem_that_is_never_finite_is_reported_and_harms_no_other(bad):
    def objective(x, index):
        value = (x**2).sum(1)
        return torch.where(index == 0, bad, value), 2 * x

    result = minimise(objective, torch.ones(2, 3), iterations=20)
    assert result.status == ["not finite", "converged"]
    assert torch.equal(result.x[0], torch.ones(3))
    assert result.x[1].abs().max() < 1e-3


def test_never_worse_than_the_start_and_says_why_it_stopped():
    def objective(x, index):  # a gradient that points the wrong way
        return (x**2).sum(1), -2 * x

    start = torch.ones(1, 2)
    result = minimise(objective, start, iterations=10)
    assert torch.equal(result.x, start)
    assert result.status == ["stalled"]
    limited = minimise(rosenbrock(torch.ones(1)), torch.tensor([[-1.2, 1.0]]), iterations=2)
    assert limited.status == ["iteration limit"]


def test_start_at_the_minimum():
    result = minimise(lambda x, _: ((x**2).sum(1), 2 * x), torch.zeros(2, 3), iterations=5)
    assert result.status == ["converged"] * 2
