"""Fits the prior of hybrid and shared models, and takes its part out of the visibility."""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import in_threads, one_thread
from prtnet.dataset import Dataset
from prtnet.prior import MapPrior, NetworkPrior, Prior
from prtnet.surroundings import Surroundings
from training.config import TrainConfig
from training.monitor import Monitor
from training.patch_fit import fit_patches
from training.prior_samples import draw_samples
from training.ridge_maps import fit_maps
from training.shared_network import NetworkConfig, fit_network
from training.skin_fit import fit_skin

__all__ = ["fit_prior", "subtract"]


def fit_surroundings(
    dataset: Dataset, poses: FloatArray, slots: IntArray, config: TrainConfig
) -> Surroundings:
    """What receivers of the dataset's scene see, as configured."""
    if dataset.joint_weights is None:
        return fit_patches(
            dataset.faces, dataset.receiver_of_vertex, dataset.rest_pose.reshape(-1, 3),
            dataset.rest_tangents, dataset.two_sided, order=config.prior_order,
        )  # fmt: skip
    return fit_skin(
        dataset, poses, slots, spheres=config.spheres, near_spheres=config.near_spheres,
        patches=config.patches, near_patches=config.near_patches, order=config.prior_order,
        seed=config.seed,
    )  # fmt: skip


def fit_prior(
    dataset: Dataset,
    poses: FloatArray,
    visibility: FloatArray,
    slots: IntArray,
    config: TrainConfig,
    watch: Monitor,
) -> Prior:
    """The prior of a hybrid or a shared model.

    Args:
        dataset: for the scene.
        poses: of training, (P, D).
        visibility: in them, (P, V, n²).
        slots: receivers of each cluster, (C, R), −1 for empty.
        config: of the model.
        watch: told of progress.
    """
    watch.stage("what receivers see")
    with one_thread():
        surroundings = fit_surroundings(dataset, poses, slots, config)
    mean = visibility.mean(axis=0, dtype=np.float64).astype(np.float32)
    samples = draw_samples(
        surroundings, poses, visibility, mean, config.samples, config.seed,
        lambda done, total: watch.progress(done, total, 0.0),
    )  # fmt: skip
    low, high = samples.features.min(axis=0), samples.features.max(axis=0)
    if config.kind == "hybrid":
        watch.stage("ridge maps")
        cluster = np.zeros(len(mean), dtype=np.int32)
        for index, own in enumerate(slots):
            cluster[own[own >= 0]] = index
        maps = fit_maps(samples, cluster, len(slots), len(mean))
        return MapPrior(surroundings, low, high, cluster, maps)
    watch.stage("shared network")

    def on_step(done: int, total: int, loss: float) -> None:
        watch.progress(done, total, loss)
        watch.scalar("shared_network/loss", loss, done)

    size = NetworkConfig(
        width=config.width, depth=config.depth, codes=config.codes, steps=config.steps,
        seed=config.seed,
    )  # fmt: skip
    fitted = fit_network(samples, mean, size, config.device, on_step)
    return NetworkPrior(surroundings, low, high, fitted.code, fitted.weights, fitted.biases)


def subtract(prior: Prior, poses: FloatArray, visibility: FloatArray, watch: Monitor) -> None:
    """Take the prior's part out of visibility (P, V, n²), in place, a pose a thread."""
    watch.stage("what the prior leaves")

    def work(row: int) -> None:
        visibility[row] -= prior(poses[row : row + 1])[0]

    with in_threads() as each:
        for done, _ in enumerate(each(work, range(len(poses))), start=1):
            watch.progress(done, len(poses), 0.0)
