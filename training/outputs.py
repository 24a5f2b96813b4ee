"""What a model predicts: the receivers it takes together, and their principal components.

None of it depends on the features or the regressor, so kinds of models can share it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.errors import PrtnetError
from prtnet.output_space import OutputSpace
from training.clustering import cluster_receivers
from training.clusters import cluster_coordinates, subdivide
from training.config import TrainConfig
from training.lobe_targets import lobe_targets
from training.monitor import Monitor
from training.prior_fit import fit_prior, subtract
from training.reduction import OutputReduction, reduce_output
from training.signal_groups import regroup

__all__ = ["AROUND", "Layout", "Outputs", "reduced_outputs"]

AROUND = ("hybrid", "shared")  # kinds with a prior at every receiver


@dataclass(frozen=True, eq=False)
class Layout:
    """Which receivers a model predicts together.

    Attributes:
        slots: receivers of each cluster, (C, R), −1 for empty.
        groups: of each group of a cluster, (C · parts, R'), likewise.
    """

    slots: IntArray
    groups: IntArray


@dataclass(frozen=True, eq=False)
class Outputs:
    """What there is to predict of some poses.

    Attributes:
        layout: receivers taken together.
        reduction: their principal components, and the poses' latents.
        around: a prior and what a model keeps beside it, or how many lobes it predicts and the
            mean visibility, by a model's attributes; mostly none.
    """

    layout: Layout
    reduction: OutputReduction
    around: dict[str, Any]


def reduced_outputs(
    dataset: Dataset,
    rows: IntArray,
    config: TrainConfig,
    watch: Monitor,
    layout: Layout | None = None,
) -> Outputs:
    """Clusters, groups and components of some poses.

    Args:
        dataset: of the poses.
        rows: which, (P,).
        config: how.
        watch: is told how it goes.
        layout: receivers taken together, where that is settled already.

    Raises:
        PrtnetError: as :func:`training.train.train`.
    """
    space = OutputSpace(config.frame, config.target)
    visibility, poses = space.read(dataset, rows), dataset.read("pose", rows)
    if not (np.isfinite(visibility).all() and np.isfinite(poses).all()):
        raise PrtnetError(dataset.path, "holds values that are not finite; generate it again")

    watch.stage("clusters and components")
    slots = cluster_receivers(dataset, rows, visibility, config) if layout is None else layout.slots
    around = surrounded(dataset, poses, visibility, slots, config, watch)
    if config.kind == "lobes":
        signal = visibility.mean(axis=0, dtype=np.float64).astype(np.float32)
        around = {"lobes": config.lobes, "signal": signal}
        visibility = lobe_targets(visibility, config.lobes, watch)
        watch.stage("components of lobes")
    latents = 0.0 if config.kind == "constant" else config.latents / config.parts
    groups = layout.groups if layout else grouped(dataset, visibility, slots, config, latents)
    reduction = reduce_output(visibility, groups, config.output_variance, latents, config.step)
    return Outputs(Layout(slots, groups), reduction, around)


def surrounded(
    dataset: Dataset, poses: FloatArray, visibility: FloatArray, slots: IntArray,
    config: TrainConfig, watch: Monitor,
) -> dict[str, Any]:  # fmt: skip
    """A prior and what the model keeps beside it; of ``visibility`` only what it leaves is left."""
    if config.kind not in AROUND:
        return {}
    signal = visibility.mean(axis=0, dtype=np.float64).astype(np.float32)
    bounds = np.stack([visibility.min(axis=(0, 1)), visibility.max(axis=(0, 1))])
    prior = fit_prior(dataset, poses, visibility, slots, config, watch)
    subtract(prior, poses, visibility, watch)
    watch.stage("components of what is left")
    return {"prior": prior, "signal": signal, "bounds": bounds}


def grouped(
    dataset: Dataset, visibility: FloatArray, slots: IntArray, config: TrainConfig, latents: float
) -> IntArray:
    """The groups of each cluster, (C · parts, R), for numbers (P, V, N) that are to be kept."""
    coordinates = cluster_coordinates(dataset.rest_positions, dataset.joint_weights)
    groups = subdivide(slots, coordinates, config.parts, config.seed)
    return regroup(visibility, groups, config.parts, round(min(latents, len(visibility))))
