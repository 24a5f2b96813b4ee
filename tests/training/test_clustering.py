from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.errors import PrtnetError
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.clustering import cluster_receivers
from training.train import train


def clustered(data, clustering, clusters=4):
    rows = data.training_poses()
    config = dataclasses.replace(SMALL, clustering=clustering, clusters=clusters)
    return cluster_receivers(data, rows, data.read("visibility", rows), config)


@pytest.mark.parametrize("clustering", ["position", "weights", "rigid", "signal"])
def test_every_clustering_gives_equal_clusters_of_all_receivers(clustering):
    for clusters in (1, 4, 7):
        slots = clustered(memory_dataset(), clustering, clusters)
        assert np.array_equal(np.sort(slots[slots >= 0]), np.arange(60))
        assert slots.shape == (clusters, -(-60 // clusters))


def test_segments_are_not_torn():
    """Receivers lie about at random: only skin weights, or how they turn, tell the joints apart."""
    data = memory_dataset()
    data.rest_positions = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32)
    owner = np.argmax(data.joint_weights, axis=1)
    for clustering in ("weights", "rigid"):
        for own in clustered(data, clustering):
            assert len(set(owner[own])) == 1
    assert any(len(set(owner[own])) > 1 for own in clustered(data, "signal"))


def test_a_point_cache_has_no_weights_to_cluster():
    data = memory_dataset()
    data.joint_weights = data.joint_parents = None
    with pytest.raises(PrtnetError, match="use rigid"):
        clustered(data, "weights")
    assert clustered(data, "rigid").shape == (4, 15)


@pytest.mark.parametrize("clustering", ["weights", "rigid", "signal"])
def test_models_of_every_clustering_beat_their_mean(clustering):
    data = memory_dataset()
    model = train(data, dataclasses.replace(SMALL, clustering=clustering, features="joint_angles"))
    rows = data.training_poses()
    truth = data.read("visibility", rows)
    error = ((model(data.read("pose", rows)) - truth) ** 2).sum()
    assert error < 0.5 * ((truth - truth.mean(axis=0)) ** 2).sum()
