from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.training.data import memory_dataset
from training.config import TrainConfig
from training.train import train
from training.worth import Marginal, front, marginal, truncated

SMALL = TrainConfig(
    clusters=4, neurons=6, latents=12, parts=2, step=1, spheres=12, points=2, near=6,
    iterations=40, alpha=1e-2, output_variance=1.0,
)  # fmt: skip


def squared_error(model, poses, truth):
    return float(np.sum((model(poses).astype(np.float64) - truth) ** 2))


@pytest.mark.parametrize("kind", ["linear", "neural"])
def test_marginal_errors_are_what_truncation_does(kind):
    data = memory_dataset()
    model = train(data, dataclasses.replace(SMALL, kind=kind))
    held = data.held_out_poses()
    poses, truth = data.read("pose", held), data.read("visibility", held)
    result = marginal(model, [(poses[:3], truth[:3]), (poses[3:], truth[3:])])
    energy = np.sum(truth.astype(np.float64) ** 2)
    assert result.energy.tolist() == pytest.approx([energy], rel=1e-6)
    rng = np.random.default_rng(0)
    for counts in (0 * model.latents, model.latents, rng.integers(0, model.latents + 1)):
        kept = np.arange(result.gain.shape[2]) < counts[:, None]
        expected = result.errors(result.gain[:, kept].sum(axis=1))[0] ** 2 * energy
        cut = truncated(model, counts)
        assert squared_error(cut, poses, truth) == pytest.approx(expected, rel=1e-4)
        assert cut.latents.tolist() == counts.tolist()


def test_sets_are_joined_and_each_has_a_vote():
    one = Marginal(np.array([4.0]), np.array([2.0]), np.array([[[1.0, 0.5]]]))
    two = Marginal(np.array([600.0]), np.array([100.0]), np.array([[[25.0]]]))
    both = Marginal.joined([one, two])
    assert both.gain.tolist() == [[[1.0, 0.5]], [[25.0, 0.0]]]
    assert both.votes() == pytest.approx(np.array([[(1 / 4 + 25 / 600) / 2, 1 / 16]]))
    errors = both.errors(np.array([[0.0, 0.0], [1.5, 25.0], [5.0, 5.0]]))
    expected = [[0.5**0.5, 0.1666667**0.5], [0.125**0.5, 0.125**0.5], [0.0, (95 / 600) ** 0.5]]
    assert errors == pytest.approx(np.array(expected), rel=1e-6)


@given(
    gain=st.lists(st.lists(st.integers(-3, 9), min_size=3, max_size=3), min_size=1, max_size=3).map(
        np.array
    ),
    step=st.integers(1, 3),
)
def test_front_is_the_best_there_is_at_every_size_it_names(gain, step):
    latents = np.full(len(gain), gain.shape[1])
    order = front(gain, latents, step)
    total = np.concatenate([np.zeros((len(gain), 1)), np.cumsum(gain, axis=1)], axis=1)
    allowed = [k for k in range(gain.shape[1] + 1) if k % step == 0 or k == gain.shape[1]]
    for steps in range(len(order) + 1):
        counts = order.counts(steps)
        assert set(counts.tolist()) <= set(allowed)
        brought = total[np.arange(len(gain)), counts].sum()
        assert brought == pytest.approx(order.brought(gain[None])[steps, 0])
        rivals = [
            total[np.arange(len(gain)), list(other)].sum()
            for other in itertools.product(allowed, repeat=len(gain))
            if sum(other) <= counts.sum()
        ]
        assert brought == pytest.approx(max(rivals))


def test_what_brings_nothing_is_left_out():
    gain = np.array([[-1.0, -1.0, 5.0, -2.0], [0.0, 0.0, 0.0, 0.0], [-1.0, -1.0, -1.0, -1.0]])
    order = front(gain, np.array([4, 4, 4]), 1)
    assert order.counts(len(order)).tolist() == [3, 0, 0]
    assert len(front(gain, np.array([0, 0, 0]), 1)) == 0
