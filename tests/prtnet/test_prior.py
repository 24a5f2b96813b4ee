"""Priors against their definition, at the border of what they know, and through their arrays."""

from __future__ import annotations

import numpy as np
import pytest

from prtnet.prior import MapPrior, NetworkPrior, prior_from_arrays, saturated
from tests.models import random_poses
from tests.priors import random_prior


@pytest.mark.parametrize("kind", ["maps", "network"])
def test_equals_the_definition(kind):
    prior, poses = random_prior(kind), random_poses(2, 5)
    seen = prior.surroundings(poses)
    answer = prior(poses)
    for pose in range(2):
        for receiver in (0, 11, 39):
            f = np.clip(seen[pose, receiver], prior.low, prior.high).astype(float)
            if isinstance(prior, MapPrior):
                both = np.concatenate([f, [v / (1 + abs(v) / 2) for v in f]])
                expected = both @ prior.maps[prior.cluster[receiver]]
            else:
                assert isinstance(prior, NetworkPrior)
                value = np.concatenate([f, prior.code[receiver]]) @ prior.weights[0]
                value = np.tanh(value + prior.biases[0]) @ prior.weights[1]
                expected = np.tanh(value + prior.biases[1]) @ prior.weights[2] + prior.biases[2]
            assert np.allclose(answer[pose, receiver], expected, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("kind", ["maps", "network"])
def test_goes_on_as_at_the_border(kind):
    prior = random_prior(kind)
    receivers = np.arange(5)
    outside = np.tile(prior.high + 100 * (prior.high - prior.low), (5, 1))
    border = np.tile(prior.high, (5, 1))
    at_border = prior.of_features(border, receivers)
    assert np.array_equal(prior.of_features(outside, receivers), at_border)
    assert not np.array_equal(prior.of_features(border * 0.9, receivers), at_border)


@pytest.mark.parametrize("kind", ["maps", "network"])
def test_arrays_round_trip(kind):
    prior, poses = random_prior(kind), random_poses(2, 5)
    again = prior_from_arrays(prior.kind, prior.surroundings.kind, prior.arrays())
    assert type(again) is type(prior)
    assert np.array_equal(again(poses), prior(poses))


def test_arrays_that_do_not_fit_are_refused():
    arrays = random_prior("network").arrays()
    for name in ("weight1", "bias0", "low"):
        damaged = {**arrays, name: arrays[name][:-1]}
        with pytest.raises(ValueError, match="fit"):
            prior_from_arrays("network", "skin", damaged)
    with pytest.raises(KeyError):
        prior_from_arrays("oracle", "skin", arrays)


def test_saturation_is_odd_and_bounded():
    f = np.linspace(-1e4, 1e4, 101)
    assert np.allclose(saturated(f), -saturated(-f))
    assert np.abs(saturated(f)).max() < 2
    assert np.allclose(saturated(1e-6 * f), 1e-6 * f, rtol=1e-2)
