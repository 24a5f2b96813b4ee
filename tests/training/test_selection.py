from __future__ import annotations

import numpy as np
import pytest
import torch

from training.regression import Fit, fit_linear
from training.selection import (
    ALPHAS,
    NEURONS,
    choose_alpha,
    choose_neurons,
    folds_over_clips,
    folds_over_moments,
    folds_over_time,
    refined,
    validation_loss,
)


def sources(*rows):
    return np.array(rows, dtype=bool)


def test_a_fold_never_sees_its_clip_nor_poses_mixed_from_it():
    table = sources(*[[1, 0, 0]] * 6, *[[0, 1, 0]] * 5, *[[0, 0, 1]] * 5, *[[1, 1, 0]] * 4)
    folds = folds_over_clips(table)
    assert len(folds) == 3
    for fold in folds:
        assert not (fold.train & fold.validate).any()
        seen, asked = table[fold.train].any(axis=0), table[fold.validate].any(axis=0)
        assert not (seen & asked).any()
    assert sum(fold.validate.sum() for fold in folds) == 16  # mixed poses validate nothing


def test_many_clips_are_grouped_evenly():
    table = np.repeat(np.eye(9, dtype=bool), [5, 9, 7, 5, 6, 8, 5, 5, 10], axis=0)
    folds = folds_over_clips(table, most=4)
    assert len(folds) == 4
    sizes = [int(fold.validate.sum()) for fold in folds]
    assert max(sizes) - min(sizes) <= 5


def test_one_clip_has_no_folds():
    assert folds_over_clips(sources([1, 0], [1, 0])) == []


def test_folds_over_time_leave_quarters_and_their_guards_out():
    rng = np.random.default_rng(0)
    time = rng.permutation(np.concatenate([np.arange(40) / 10.0, np.zeros(5)]))
    direct = np.ones(45, dtype=bool)
    direct[np.flatnonzero(time == 0.0)[:5]] = False  # sampled
    folds = folds_over_time(time, direct)
    assert len(folds) == 4
    validated = np.stack([fold.validate for fold in folds])
    np.testing.assert_array_equal(validated.sum(axis=0), direct.astype(int))
    for fold in folds:
        assert np.ptp(time[fold.validate]) <= 0.9 + 1e-9
        assert not fold.train[~direct].any()
        gaps = np.abs(time[fold.train][:, None] - time[fold.validate]).min(axis=1)
        assert gaps.min() > 0.5
        assert fold.train.sum() >= 40 - 10 - 2 * 5


def test_a_short_clip_has_no_folds_over_time():
    assert folds_over_time(np.arange(6) / 30.0, np.ones(6, dtype=bool)) == []


def test_best_alpha_is_between_too_stiff_and_too_loose():
    """More inputs than poses and noisy targets: the least α overfits, the largest says nothing."""
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(3, 60, 50, generator=generator, dtype=torch.float64)
    mix = torch.randn(3, 50, 2, generator=generator, dtype=torch.float64)
    mix[:, 3:] = 0.0
    noise = torch.randn(3, 60, 2, generator=generator, dtype=torch.float64)
    folds = folds_over_clips(np.repeat(np.eye(3, dtype=bool), 20, axis=0))
    tried = []
    alpha, errors = choose_alpha(
        fit_linear, x, x @ mix + 0.7 * noise, folds, on_candidate=lambda a, _: tried.append(a)
    )
    best = min(errors, key=errors.get)
    assert best not in (ALPHAS[0], ALPHAS[-1])
    assert sorted(errors) == sorted(tried)
    y = x @ mix + 0.7 * noise
    lost = [sum(validation_loss(fit_linear, x, y, fold, a) for fold in folds) for a in ALPHAS]
    assert ALPHAS[int(np.argmin(lost))] == best
    assert alpha == refined(ALPHAS, errors, best, folds)
    # What suits a fold suits all poses: there α · share is as strong.
    between = alpha / (2 / 3)
    assert ALPHAS[int(np.argmin(lost)) - 1] < between < ALPHAS[int(np.argmin(lost)) + 1]
    assert sum(validation_loss(fit_linear, x, y, fold, between) for fold in folds) <= min(lost)


def test_alpha_is_the_bottom_of_a_parabola_times_the_share_of_poses():
    alphas = (1e-3, 1e-2, 1e-1, 1.0)
    folds = folds_over_clips(np.repeat(np.eye(4, dtype=bool), 5, axis=0))
    errors = {a: 0.5 + 0.1 * (np.log10(a) + 1.8) ** 2 for a in alphas}
    assert refined(alphas, errors, 1e-2, folds) == pytest.approx(0.75 * 10**-1.8)
    assert refined(alphas, {1e-2: 1.0}, 1e-2, folds) == pytest.approx(0.75e-2)
    assert refined(alphas, errors, 1.0, folds) == pytest.approx(0.75)
    assert refined(alphas, dict.fromkeys(alphas, 1.0), 1e-2, folds) == pytest.approx(0.75e-2)
    assert refined((0.2,), {0.2: 1.0}, 0.2, folds) == 0.2  # it was given, not chosen


def test_neurons_and_alpha_are_where_neither_change_helps():
    """A valley whose floor runs across both axes: descending once along each would miss it."""
    targets = torch.ones(1, 20, 1, dtype=torch.float64)
    folds = folds_over_clips(np.repeat(np.eye(2, dtype=bool), 10, axis=0))
    calls = []

    def fit(inputs, wanted, neurons, alpha):
        calls.append((neurons, alpha))
        row, column = NEURONS.index(neurons), ALPHAS.index(alpha)
        lost = 0.1 + 0.3 * (row + column - 5.2) ** 2 + 0.05 * (row - column) ** 2
        bias = torch.full((1, 1), 1.0 - lost, dtype=torch.float64)
        zero = torch.zeros(1, 2, 1, dtype=torch.float64)
        return Fit(zero, bias, None, None, bias, bias, [])

    inputs = torch.zeros(1, 20, 2, dtype=torch.float64)
    neurons, alpha, errors = choose_neurons(fit, inputs, targets, folds)
    chosen = min(errors, key=errors.get)
    assert neurons == chosen[0]
    own = {a: e for (n, a), e in errors.items() if n == neurons}
    assert alpha == refined(ALPHAS, own, chosen[1], folds)
    row, column = NEURONS.index(neurons), ALPHAS.index(chosen[1])
    for other in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
        if 0 <= other[0] < len(NEURONS) and 0 <= other[1] < len(ALPHAS):
            pair = NEURONS[other[0]], ALPHAS[other[1]]
            assert errors[pair] >= errors[chosen]
    assert len(calls) == len(folds) * len(errors) < len(folds) * len(NEURONS) * len(ALPHAS)


def test_folds_over_moments_leave_a_part_of_every_clip_out():
    clip = np.repeat([0, 1, 2], [40, 12, 9])
    time = np.concatenate([np.arange(40) / 8.0, np.arange(12) / 40.0, np.zeros(9)])
    folds = folds_over_moments(clip, time, sampled=2)
    assert len(folds) == 4
    assert (sum(fold.validate.astype(int) for fold in folds) == 1).all()
    for fold in folds:
        assert not (fold.train & fold.validate).any()
        for own, guard in ((0, 0.5), (1, 11 / 40 / 8)):
            left = time[fold.validate & (clip == own)]
            kept = time[fold.train & (clip == own)]
            assert len(left) > 0
            assert len(kept) > 0
            assert np.ptp(left) < 0.3 * np.ptp(time[clip == own])  # contiguous
            apart = np.maximum(left.min() - kept, kept - left.max())
            assert apart.min() > guard
        assert 2 <= (fold.validate & (clip == 2)).sum() <= 3
        assert (fold.train | fold.validate)[clip == 2].all()  # sampled poses have no guard


def test_moments_that_cannot_be_told_apart_are_split_all_the_same():
    folds = folds_over_moments(np.zeros(20, dtype=int), np.full(20, 3.0), None)
    assert [int(fold.validate.sum()) for fold in folds] == [5, 5, 5, 5]
    assert all((fold.train ^ fold.validate).all() for fold in folds)


def test_few_poses_have_no_folds_over_moments():
    assert folds_over_moments(np.zeros(3, dtype=int), np.arange(3.0), None) == []
