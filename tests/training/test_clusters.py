from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from training.clusters import (
    assign_balanced,
    balanced_clusters,
    cluster_coordinates,
    squared_distances,
)


@given(st.integers(1, 60), st.integers(1, 12), st.integers(0, 5))
def test_every_receiver_has_one_slot_and_clusters_are_equal(receivers, clusters, seed):
    points = np.random.default_rng(seed).normal(size=(receivers, 3))
    slots = balanced_clusters(points, clusters, seed)
    filled = np.sort(slots[slots >= 0])
    assert np.array_equal(filled, np.arange(receivers))
    assert slots.shape[1] == -(-receivers // min(clusters, receivers))


def test_separate_groups_are_found():
    centres = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10.0]])
    points = np.repeat(centres, 25, axis=0) + np.random.default_rng(0).normal(size=(100, 3)) * 0.1
    slots = balanced_clusters(points, 4)
    for own in slots:
        assert len(set(own // 25)) == 1


def test_assignment_is_stable():
    """No point and cluster would both rather have each other."""
    rng = np.random.default_rng(1)
    points, centres = rng.normal(size=(60, 2)), rng.normal(size=(5, 2))
    distance = squared_distances(points, centres)
    choice = assign_balanced(distance, 12)
    assert np.bincount(choice, minlength=5).max() <= 12
    own = distance[np.arange(60), choice]
    for cluster in range(5):
        members = choice == cluster
        wish = distance[:, cluster] < own
        if members.sum() == 12:
            assert not (wish & (distance[:, cluster] < own[members].max())).any()
        else:
            assert not wish.any()


def test_duplicates_of_one_place():
    slots = balanced_clusters(np.zeros((10, 3)), 3)
    assert np.array_equal(np.sort(slots[slots >= 0]), np.arange(10))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_coordinates_do_not_depend_on_scale_or_place(scale):
    rng = np.random.default_rng(2)
    positions, weights = rng.normal(size=(30, 3)), rng.dirichlet(np.ones(4), 30)
    here = cluster_coordinates(positions, weights)
    there = cluster_coordinates(scale * positions + 50.0 * scale, weights)
    assert np.allclose(here, there, atol=1e-6)
    assert cluster_coordinates(positions, None).shape == (30, 3)
    assert np.isfinite(cluster_coordinates(np.zeros((4, 3)), None)).all()
