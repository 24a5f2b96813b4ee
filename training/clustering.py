"""Which receivers a model predicts together: the choice of `--clustering`."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.errors import PrtnetError
from training.clusters import balanced_clusters, cluster_coordinates
from training.config import TrainConfig
from training.segments import mean_shift, rotation_sequences
from training.signal_clusters import signal_clusters

__all__ = ["cluster_receivers"]

SEGMENT_WEIGHT = 2.0  # segments are further apart than the ends of the scene
WEIGHTS_BANDWIDTH = 0.5  # of skin weights; two joints' own vertices are √2 apart
TURN_BANDWIDTH = 0.15  # of rotation sequences: turns that differ by 17 degrees
TURNED_POSES = 16  # that rotation sequences are made of
MOST_COMPONENTS = 16.0  # of a cluster's subspace, when clusters follow the signal


def cluster_receivers(
    dataset: Dataset, rows: IntArray, visibility: FloatArray, config: TrainConfig
) -> IntArray:
    """Slots (C, R) of equally large clusters, whatever they are made of; an empty slot holds −1.

    Segments (`weights`, `rigid`) say which receivers are near each other; the clusters cut them
    into equal parts and cross their seams only where their sizes ask for it.

    Args:
        dataset: of the receivers.
        rows: its training poses, (P,).
        visibility: of these, (P, V, n²).
        config: clustering, clusters, seed, and latents.

    Raises:
        PrtnetError: skin weights are asked for and there is no skin.
    """
    positions, weights = dataset.rest_positions, dataset.joint_weights
    if config.clustering in ("weights", "rigid"):
        if config.clustering == "rigid":
            segment = mean_shift(turns(dataset, rows), TURN_BANDWIDTH, seed=config.seed)
        elif weights is None:
            raise PrtnetError(
                "--clustering", "weights are a skin's, and a point cache has none; use rigid"
            )
        else:
            segment = mean_shift(weights, WEIGHTS_BANDWIDTH, seed=config.seed)
        coordinates = cluster_coordinates(
            positions, np.eye(segment.max() + 1)[segment], SEGMENT_WEIGHT
        )
        return balanced_clusters(coordinates, config.clusters, config.seed)
    coordinates = cluster_coordinates(positions, weights)
    slots = balanced_clusters(coordinates, config.clusters, config.seed)
    if config.clustering == "signal":
        components = max(1.0, min(config.latents, MOST_COMPONENTS))
        return signal_clusters(visibility, slots, components)
    return slots


def turns(dataset: Dataset, rows: IntArray) -> FloatArray:
    """Rotation sequences (V, S · 9) over some training poses."""
    some = rows[np.unique(np.linspace(0, len(rows) - 1, TURNED_POSES).astype(int))]
    normals, tangents = dataset.read("normals", some), dataset.read("tangents", some)
    return rotation_sequences(dataset.rest_normals, dataset.rest_tangents, normals, tangents)
