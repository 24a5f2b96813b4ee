from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from prtnet.cores import one_by_one
from prtnet.prior import NetworkPrior
from training import shared_network
from training.prior_samples import Samples
from training.shared_network import Network, NetworkConfig, batches, fit_network

RECEIVERS, COEFFICIENTS = 12, 4


pytestmark = pytest.mark.usefixtures("torch_threads")


def problem(count: int = 400, features: int = 5) -> tuple[Samples, np.ndarray]:
    rng = np.random.default_rng(3)
    seen = rng.normal(size=(count, features)).astype(np.float32)
    seen[:, 1] = 2.5  # one that does not vary
    deviation = np.tanh(seen @ rng.normal(size=(features, COEFFICIENTS))).astype(np.float32)
    receiver = rng.integers(0, RECEIVERS, count).astype(np.int32)
    mean = rng.normal(size=(RECEIVERS, COEFFICIENTS)).astype(np.float32)
    return Samples(seen, deviation, receiver), mean


def network(depth: int = 2) -> Network:
    config = NetworkConfig(width=7, depth=depth, codes=3, seed=2)
    made = Network(*problem(), config, "cpu")
    last = made.layers[-1][0]  # begins with zeros, which hide the gradients of the others
    last.normal_(generator=torch.Generator().manual_seed(5))
    return made


def loss_of(made: Network, rows: torch.Tensor) -> torch.Tensor:
    seen = (made.features[rows] - made.shift) * made.scale
    value = torch.cat([seen, made.code[made.receiver[rows]]], dim=1)
    for index, (weight, bias) in enumerate(made.layers):
        value = torch.nn.functional.linear(torch.tanh(value) if index else value, weight, bias)
    return (value - made.target[rows]).square().sum(1).mean()


@pytest.mark.parametrize("depth", [0, 1, 2, 3])
@pytest.mark.parametrize("part", [1, 30, 90, 1000])
def test_the_gradient_is_that_of_autograd(depth: int, part: int) -> None:
    made = network(depth)
    rows = torch.randint(0, 400, (90,), generator=torch.Generator().manual_seed(depth))
    found = made.gradient(rows, 0.7, one_by_one, part)
    gradients = [p.grad for p in (*made.inner, made.code)]
    leaves = [p.requires_grad_() for p in (*made.inner, made.code)]
    wanted = loss_of(made, rows) / 0.7
    assert_allclose(found, wanted.detach(), rtol=1e-5)
    for one, other in zip(gradients, torch.autograd.grad(wanted, leaves), strict=True):
        assert_allclose(one, other, rtol=1e-4, atol=1e-6 * float(other.abs().max()))


def fitted(threads: int) -> shared_network.Layers:
    torch.set_num_threads(threads)
    size = NetworkConfig(width=48, codes=8, steps=6, batch=6000, seed=2)
    found = fit_network(*problem(6000, 40), size)
    assert torch.get_num_threads() == threads
    return found


def test_the_number_of_threads_changes_no_byte() -> None:
    """Of layers that torch would divide by itself."""
    one, other = fitted(1), fitted(3)
    assert_array_equal(one.code, other.code)
    for name in ("weights", "biases"):
        for a, b in zip(getattr(one, name), getattr(other, name), strict=True):
            assert_array_equal(a, b)
    assert one.loss == other.loss


def test_it_learns_and_has_the_scale_of_inputs_in_its_first_layer() -> None:
    samples, mean = problem()
    found = fit_network(samples, mean, NetworkConfig(width=16, codes=3, steps=1500, batch=128))
    assert found.loss < 0.02
    low, high = samples.features.min(0), samples.features.max(0)
    prior = NetworkPrior(None, low, high, found.code, found.weights, found.biases)  # type: ignore[arg-type]
    left = prior.of_features(samples.features, samples.receiver) - samples.deviation
    assert np.square(left).mean() < 0.02 * np.square(samples.deviation).mean()


@pytest.mark.parametrize(("batch", "sizes"), [(90, [90] * 4), (400, [400]), (1000, [400])])
def test_a_round_has_no_sample_twice(batch: int, sizes: list[int]) -> None:
    made, config = network(), NetworkConfig(batch=batch)
    drawn = batches(made, config)
    for _ in range(2):
        rows = [next(drawn) for _ in sizes]
        assert [len(own) for own in rows] == sizes
        assert len(torch.cat(rows).unique()) == sum(sizes)
