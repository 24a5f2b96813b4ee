from __future__ import annotations

import itertools

import numpy as np

from training.signal_clusters import (
    assign_by_regret,
    leading_courses,
    lost_energy,
    signal_clusters,
)


def moods(receivers=48, groups=3, poses=20, seed=0, noise=0.0):
    """Visibility of groups that each follow two courses of their own, and the groups."""
    rng = np.random.default_rng(seed)
    group = rng.permutation(np.arange(receivers) % groups)
    courses = rng.normal(size=(groups, poses, 2))
    mix = rng.normal(size=(receivers, 2, 4)) * rng.uniform(0.1, 3.0, (receivers, 1, 1))
    visibility = 2.0 + np.einsum("vpk,vki->pvi", courses[group], mix)
    return (visibility + noise * rng.normal(size=visibility.shape)).astype(np.float32), group


def test_courses_keep_the_energy_of_deviations():
    visibility, _ = moods()
    course = leading_courses(visibility, 64)
    energy = np.square(visibility - visibility.mean(axis=0)).sum(axis=(0, 2))
    assert np.allclose(np.square(course).sum(axis=(0, 2)), energy, rtol=1e-4)


def test_lost_energy_is_what_a_projection_leaves():
    visibility, group = moods(groups=2, noise=0.3)
    course = leading_courses(visibility, 64)
    lost = lost_energy(course, group, 2, 2.0)
    counts = []
    for cluster in range(2):
        own = course[:, group == cluster].reshape(len(course), -1)
        left, values, _ = np.linalg.svd(own.astype(np.float64))
        counts.append(values)
        for count in range(5):
            rest = course - np.tensordot(left[:, :count] @ left[:, :count].T, course, 1)
            if np.allclose(np.square(rest).sum(axis=(0, 2)), lost[:, cluster], rtol=1e-3):
                break
        else:
            raise AssertionError("no projection leaves this")
        counts[-1] = count
    assert sum(counts) == 4


def test_groups_are_found_again_from_a_bad_start():
    visibility, group = moods()
    start = np.arange(48, dtype=np.int32).reshape(3, 16)
    slots = signal_clusters(visibility, start, 2.0, rounds=30)
    purity = [np.bincount(group[own]).max() / len(own) for own in slots]
    assert np.mean([np.bincount(group[own]).max() / len(own) for own in start]) < 0.6
    assert np.mean(purity) > 0.85


def test_clusters_never_lose_more_than_where_they_started():
    visibility, _ = moods(receivers=50, noise=0.5, seed=4)
    start = np.concatenate([np.arange(50), [-1]]).reshape(3, 17).astype(np.int32)
    slots = signal_clusters(visibility, start, 2.0)
    assert slots.shape == start.shape
    assert np.array_equal(np.sort(slots[slots >= 0]), np.arange(50))
    course = leading_courses(visibility, 64)

    def total(table):
        label = np.empty(50, dtype=int)
        for cluster, own in enumerate(table):
            label[own[own >= 0]] = cluster
        return lost_energy(course, label, 3, 2.0)[np.arange(50), label].sum()

    assert total(slots) < total(start)


def test_assignment_is_near_the_cheapest():
    """Beside trying all: six points, three clusters of two."""
    for seed in range(8):
        cost = np.random.default_rng(seed).uniform(size=(6, 3)) ** 3
        every = (
            c for c in itertools.product(range(3), repeat=6) if sorted(c) == [0, 0, 1, 1, 2, 2]
        )
        best = min(cost[np.arange(6), list(choice)].sum() for choice in every)
        choice = assign_by_regret(cost, 2)
        assert np.bincount(choice, minlength=3).max() <= 2
        assert cost[np.arange(6), choice].sum() <= best + 0.25
    assert assign_by_regret(np.ones((3, 1)), 3).tolist() == [0, 0, 0]
