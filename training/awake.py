"""What a graph has to compute: a cluster whose groups keep their means alone costs it nothing."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from prtnet.arrays import IntArray
from prtnet.model import VisibilityModel

__all__ = ["awake", "awake_clusters"]

OF_CLUSTERS = ("input_mean", "input_basis", "input_low", "input_high", "neurons")
OF_GROUPS = ("latents", "receivers", "mean")


def awake_clusters(model: VisibilityModel) -> IntArray:
    """The clusters that have any latents, (A,)."""
    counts = model.latents.reshape(-1, model.parts).sum(axis=1)
    found = np.flatnonzero(counts)
    # Two at least: a linear model of one could not be told from one of shared inputs.
    return found if len(found) > 1 else np.arange(len(counts))


def awake(model: VisibilityModel, clusters: IntArray) -> VisibilityModel:
    """A model that has the latents of some clusters, (A,), alone; its components stay as they are.

    Inputs that all clusters share stay so, too.
    """
    count = len(model.latents) // model.parts
    if len(clusters) == count:
        return model
    groups = (clusters[:, None] * model.parts + np.arange(model.parts)).ravel()
    layers: dict[str, Any] = {
        name: array[groups if name in ("weight", "bias") else clusters]
        for name, array in model.regressor.arrays().items()
        if name != "pairs"
    }
    arrays = {name: getattr(model, name) for name in OF_CLUSTERS}
    own = {n: a[clusters] for n, a in arrays.items() if a is not None and len(a) == count}
    shared = len(model.input_basis) < count
    return dataclasses.replace(
        model,
        features=model.features if shared else model.features.of_clusters(clusters),
        regressor=dataclasses.replace(model.regressor, **layers),
        **own,
        **{name: getattr(model, name)[groups] for name in OF_GROUPS},
    )
