from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from prtnet.components import coding
from tests.training.data import memory_dataset
from training.config import TrainConfig
from training.monitor import Silent
from training.train import prepared, training_rows
from training.worth import (
    Allocation,
    Prices,
    Unseen,
    allocated,
    allocations,
    bought,
    by_bands,
    chosen_regressor,
    expected,
    unseen,
)

SMALL = TrainConfig(
    clusters=4, neurons=6, latents=12, parts=2, step=1, spheres=12, points=2, near=6,
    iterations=40, output_variance=1.0,
)  # fmt: skip
NUMBERS = (2, 6)


def fitted(kind="neural"):
    """Models of two numbers of neurons, poses they have not seen, and those poses' visibility."""
    data = memory_dataset()
    config = dataclasses.replace(SMALL, kind=kind)
    fitting = prepared(data, training_rows(data), config, Silent())
    models = [fitting.model(number, 1e-2, Silent()) for number in NUMBERS]
    held = data.held_out_poses()
    return models, data.read("pose", held), data.read("visibility", held)


def squared_error(model, poses, truth):
    return float(np.sum((model(poses).astype(np.float64) - truth) ** 2))


def free(models):
    """Prices that do not count rounding."""
    body = models[0]
    shape = (2, len(body.latents), int(body.latents.max()))
    return Prices(body.receivers.shape[1], body.parts, np.array(NUMBERS), 10, 3, np.zeros(shape))


@pytest.mark.parametrize("kind", ["linear", "neural"])
def test_what_is_left_is_what_models_of_any_size_leave(kind):
    models, poses, truth = fitted(kind)
    body = models[0]
    known = unseen(models, [(poses[:3], truth[:3]), (poses[3:], truth[3:])])
    energy = np.sum(truth.astype(np.float64) ** 2)
    assert known.energy.tolist() == pytest.approx([energy], rel=1e-6)
    rng = np.random.default_rng(0)
    for turn in range(5):
        counts = rng.integers(0, body.latents + 1) if turn else 0 * body.latents
        orders = rng.integers(1, body.order + 1, len(counts))
        number = rng.integers(0, len(models), len(counts) // body.parts)
        bits = np.full((len(counts), int(body.latents.max())), 8)
        found = Allocation(number, counts, orders, bits)
        cut = allocated(models, found)
        regressor, _ = chosen_regressor(models, found, body.parts)
        plain = dataclasses.replace(  # as it would be without rounding
            body, regressor=regressor, latents=counts, basis=short(body, counts, orders)
        )
        own = expected(known, free(models), found)[0] ** 2 * energy
        assert squared_error(plain, poses, truth) == pytest.approx(own, rel=1e-4)
        assert cut.latents.tolist() == counts.tolist()
        if kind == "neural":
            assert cut.neurons.tolist() == [NUMBERS[k] for k in number]


def short(body, counts, orders):
    """Components of an allocation, not rounded."""
    rows = []
    for start, count, order in zip(body.first_component, counts, orders,
                                   strict=True):  # fmt: skip
        shape = (count, body.receivers.shape[1], body.order**2)
        own = body.basis[start : start + count].reshape(shape).copy()
        own[..., order**2 :] = 0.0
        rows.append(own.reshape(count, body.basis.shape[1]))
    return np.concatenate(rows)


def test_rounding_costs_what_is_expected():
    models, poses, truth = fitted()
    body = models[0]
    most = int(body.latents.max())
    used = np.arange(most) < body.latents[:, None]
    rounding = np.zeros((2, len(body.latents), most))
    for row, bits in enumerate((4, 8)):
        how = coding(body.basis, body.order**2, np.full(len(body.basis), bits))
        lost = np.square(how.encode(body.basis).array() - body.basis).sum(axis=1)
        rounding[row][used] = lost
    prices = dataclasses.replace(free(models), rounding=rounding)
    known = unseen(models, [(poses, truth)])
    number = np.ones(len(body.latents) // body.parts, dtype=int)
    full = np.full(len(body.latents), body.order)
    errors = {}
    for bits in (4, 8):
        found = Allocation(number, body.latents, full, np.full(used.shape, bits))
        added = expected(known, prices, found) ** 2 - expected(known, free(models), found) ** 2
        errors[bits] = added[0] * known.energy[0]
        latent = models[1].latent(poses)
        change = allocated(models, found).basis - body.basis
        cut = dataclasses.replace(models[1], basis=change, mean=0 * body.mean)
        exact = float(np.sum(cut.decode(latent).astype(np.float64) ** 2))
        assert errors[bits] == pytest.approx(exact, rel=0.3)  # roundings are nearly independent
    assert errors[4] > 50 * errors[8]


def some_known(rng, sets=2, numbers=2, groups=2, latents=2, order=2):
    left = rng.uniform(0.0, 1.0, (sets, numbers, groups, latents + 1, order))
    left[:, :, :, 0] = 1.0  # whatever the neurons
    return Unseen(np.full(sets, 10.0), left, rng.uniform(0.1, 1.0, (*left.shape[:3], latents)))


@pytest.mark.parametrize("seed", range(8))
def test_what_is_bought_is_the_best_of_all_there_is(seed):
    rng = np.random.default_rng(seed)
    known = some_known(rng)
    prices = Prices(3, 2, np.array([1, 4]), 5, 7, rng.uniform(0.0, 0.1, (2, 2, 2)))
    price = 10.0 ** rng.uniform(-5, -2)
    votes = np.mean(known.left / 10.0, axis=0)
    energy = np.mean(known.latent / 10.0, axis=0)
    error = by_bands(votes)

    def cost(number, counts, orders, bits):
        total = 0.0
        for group, (count, order) in enumerate(zip(counts, orders, strict=True)):
            total += error[number, group, count, order - 1]
            for k in range(count):
                row = 0 if bits[group][k] == 4 else 1
                total += energy[number, group, k] * prices.rounding[row, group, k]
                size = 3 * order**2 * bits[group][k] / 8
                total += price * (size + 16 + prices.widths[number])
        if sum(counts):
            total += price * (5 + 7 * prices.widths[number])
        return total

    found = bought(price, error, energy, prices, np.ones((2, 3), dtype=bool))
    number = max(0, int(found.neurons[0]))
    got = cost(number, found.counts, found.orders, found.bits)
    every = [
        cost(number, counts, orders, bits)
        for number in range(2)
        for counts in itertools.product(range(3), repeat=2)
        for orders in itertools.product((1, 2), repeat=2)
        for bits in itertools.product(itertools.product((4, 8), repeat=2), repeat=2)
    ]
    assert got == pytest.approx(min(every), rel=1e-12)


def test_models_grow_from_nothing_to_all_that_brings_anything():
    models, poses, truth = fitted()
    known = unseen(models, [(poses, truth)])
    prices = free(models)
    sizes = allocations(known, prices, models[0].latents, 1)
    totals = [int(size.counts.sum()) for size in sizes]
    assert totals[0] == 0
    assert (sizes[0].neurons == -1).all()
    assert len(sizes) > 5
    errors = [float(expected(known, prices, size)[0]) for size in sizes]
    assert errors == sorted(errors, reverse=True)
    most = by_bands(known.left[0].astype(np.float64)).min(axis=(2, 3))  # [A, G]
    clusters = len(models[0].latents) // models[0].parts
    least = most.reshape(len(NUMBERS), clusters, -1).sum(axis=2).min(axis=0).sum()
    assert errors[-1] ** 2 * known.energy[0] == pytest.approx(least, rel=1e-3)


def test_groups_have_multiples_of_a_step_or_all_they_can():
    rng = np.random.default_rng(0)
    known = some_known(rng, groups=4, latents=7)
    prices = Prices(3, 2, np.array([1, 4]), 5, 7, np.zeros((2, 4, 7)))
    latents = np.array([7, 5, 0, 7])
    for size in allocations(known, prices, latents, 3):
        assert all(n % 3 == 0 or n == most for n, most in zip(size.counts, latents, strict=True))
        assert (size.counts <= latents).all()


def test_what_brings_nothing_is_left_out_at_any_price():
    left = np.ones((1, 1, 2, 4, 1))
    left[0, 0, 0, :, 0] = [1.0, 1.2, 0.4, 0.9]  # the first component alone does harm
    known = Unseen(np.ones(1), left, np.ones((1, 1, 2, 3)))
    prices = Prices(3, 1, np.array([4]), 5, 7, np.zeros((2, 2, 3)))
    sizes = allocations(known, prices, np.array([3, 3]), 1)
    assert sizes[-1].counts.tolist() == [2, 0]
    assert sizes[-1].neurons.tolist() == [0, -1]
    nothing = Unseen(np.ones(1), np.ones((1, 1, 2, 1, 1)), np.ones((1, 1, 2, 0)))
    bare = dataclasses.replace(prices, rounding=np.zeros((2, 2, 0)))
    assert len(allocations(nothing, bare, np.array([0, 0]), 1)) == 1


def test_sets_are_joined_and_a_component_that_one_lacks_brings_nothing():
    rng = np.random.default_rng(0)
    one, two = some_known(rng, sets=1, latents=1), some_known(rng, sets=1, latents=3)
    assert np.array_equal(Unseen.joined([two], 1).left, two.left[:, :, :, :2])
    both = Unseen.joined([one, two], 4)
    assert both.left.shape == (2, 2, 2, 5, 2)
    assert np.array_equal(both.left[0, :, :, 4], one.left[0, :, :, 1])
    assert np.array_equal(both.left[1, :, :, :4], two.left[0])
    assert not both.latent[0, :, :, 1:].any()
