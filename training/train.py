"""A dataset and a configuration in, a fitted model out. Reads from top to bottom."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from prtnet import __version__
from prtnet.arrays import FloatArray, IntArray
from prtnet.cores import divided, in_threads, thread_count
from prtnet.dataset import SAMPLED, Dataset, evenly, sampled_clip
from prtnet.errors import PrtnetError
from prtnet.features import Features
from prtnet.metrics import ErrorSum
from prtnet.model import FORMAT_VERSION, Regressor, VisibilityModel
from prtnet.output_space import OutputSpace
from prtnet.provenance import made_with
from training.config import TrainConfig
from training.inputs import fit_joint_angles, fit_local_joints, fit_occluders, interior_edges
from training.monitor import Monitor, Silent
from training.outputs import AROUND, Outputs, reduced_outputs
from training.quadratic import Products
from training.reduction import input_reduction
from training.regression import Fit, average, fit_linear, fit_neural, total_iterations
from training.selection import (
    ALPHAS,
    Fold,
    choose_alpha,
    choose_neurons,
    folds_over_clips,
    folds_over_time,
)
from training.smoothness import change_covariance, consecutive

__all__ = [
    "NEURAL",
    "Fitting",
    "cross_validation_folds",
    "fit_model",
    "prepared",
    "report_convergence",
    "report_errors",
    "select",
    "train",
    "training_rows",
    "with_training_range",
]

PACKAGES = ("numpy", "scikit-learn", "scipy", "torch")  # that decide the bytes of a model
DEFAULT_ALPHA = 3e-3  # where there is too little to cross-validate with
DEFAULT_NEURONS = 16  # likewise, where the number is to be chosen
NEURAL = ("neural", *AROUND)  # kinds whose clusters have a tanh layer
BLOCK = 4  # poses whose errors a thread works out at a time
JUDGED = 400  # training poses that the training error is of, at most
TRIAL_ITERATIONS = 60  # cross-validation compares, it need not converge


@dataclass(frozen=True, eq=False)
class Problem:
    """What the regressors are fitted to, as tensors.

    Attributes:
        inputs: reduced inputs, for a quadratic model with their products, (C, P, K).
        targets: (C, P, L).
        products: how the products were made; only for a quadratic model.
        smoothness: quadratic form of linear and quadratic models' weights, (C, K, K), if any.
    """

    inputs: Tensor
    targets: Tensor
    products: Products | None = None
    smoothness: Tensor | None = None


def train(dataset: Dataset, config: TrainConfig, monitor: Monitor | None = None) -> VisibilityModel:
    """Fit a clustered model to the training clips of a dataset.

    Raises:
        PrtnetError: the dataset has no training poses, values that are not finite, or no features
            of this kind; or the kind is ``auto``.
    """
    watch = monitor or Silent()
    started = time.perf_counter()
    if config.kind == "auto":
        raise PrtnetError("--kind", "auto is for prtnet train and training.search.search alone")
    rows = training_rows(dataset)
    with divided(thread_count()):
        model = fit_model(dataset, rows, config, cross_validation_folds(dataset, rows), watch)
        report_errors(model, dataset, watch)
    model.metadata["seconds"]["total"] = time.perf_counter() - started
    return model


def training_rows(dataset: Dataset) -> IntArray:
    """The training poses of a dataset; PrtnetError where there are none."""
    rows = dataset.training_poses()
    if len(rows) == 0:
        raise PrtnetError(dataset.path, "holds no training poses; hold out fewer clips")
    return rows


@dataclass(frozen=True, eq=False)
class Fitting:
    """A model but for its regressor, and what that is fitted to.

    Attributes:
        config: how.
        body: the model, of a regressor without neurons that gives no latents.
        outputs: what there is to predict.
        data: to fit a regressor to.
        features: of the training poses, (P, 1 or C, F).
    """

    config: TrainConfig
    body: VisibilityModel
    outputs: Outputs
    data: Problem
    features: FloatArray

    def model(self, neurons: int, alpha: float, watch: Monitor) -> VisibilityModel:
        """The float32 model of a regressor that is fitted now; it neither clamps nor fades."""
        watch.stage(f"{self.config.regression} fit, α = {alpha:g}")
        started = time.perf_counter()
        fits = fit(self.data, self.config, neurons, alpha, watch)
        seconds = {"seconds": {"fit": time.perf_counter() - started}}
        facts = fit_facts(fits)
        report_convergence(facts["fits"], watch)
        return dataclasses.replace(
            self.body,
            regressor=to_regressor(average(fits), self.data.products, self.config.parts),
            metadata=self.body.metadata | {"alpha": alpha} | facts | seconds,
        )


def fit_model(
    dataset: Dataset, rows: IntArray, config: TrainConfig, folds: list[Fold], watch: Monitor
) -> VisibilityModel:
    """A model of some poses of a dataset, without its errors.

    Args:
        dataset: of the poses.
        rows: what to fit, (P,).
        config: how.
        folds: of ``rows``, to choose weight decay and neurons with.
        watch: is told how it goes.

    Raises:
        PrtnetError: as :func:`train`.
    """
    fitting = prepared(dataset, rows, config, watch)
    neurons, alpha, trials = select(fitting.data, config, folds, watch)
    model = fitting.model(neurons, alpha, watch).stored_as(config.storage)
    model.metadata["cross_validation"] = trials
    return with_training_range(model, fitting.features)


def prepared(
    dataset: Dataset,
    rows: IntArray,
    config: TrainConfig,
    watch: Monitor,
    outputs: Outputs | None = None,
) -> Fitting:
    """All of a model of some poses but its regressor.

    Args:
        dataset: of the poses.
        rows: what to fit, (P,).
        config: how.
        watch: is told how it goes.
        outputs: what there is to predict of these poses, where that is known already.

    Raises:
        PrtnetError: as :func:`train`.
    """
    outputs = outputs or reduced_outputs(dataset, rows, config, watch)
    slots, output = outputs.layout.slots, outputs.reduction
    watch.stage("features")
    poses = dataset.read("pose", rows)
    features = fit_features(dataset, poses, slots, config)
    values = features(poses)
    mean, basis = input_reduction(values, config.input_variance, config.inputs)
    inputs = (np.swapaxes(values, 0, 1) - mean[:, None]) @ basis
    inputs = np.broadcast_to(inputs, (len(slots), *inputs.shape[1:]))
    data = to_device(inputs, side_by_side(output.targets, config.parts), config.device)
    none = np.zeros((len(output.latents), 0, output.targets.shape[2]), dtype=np.float32)
    body = VisibilityModel(
        kind=config.kind,
        order=dataset.order,
        features=features,
        input_mean=mean,
        input_basis=basis,
        regressor=Regressor(none, none.sum(axis=1)),
        latents=output.latents.astype(np.int32),
        receivers=outputs.layout.groups,
        mean=output.mean,
        basis=np.concatenate(output.basis),
        rest_tangents=dataset.rest_tangents,
        metadata=describe(dataset, config, features),
        **outputs.around,
    )
    data = with_products_and_smoothness(data, dataset, rows, config)
    return Fitting(config, body, outputs, data, values)


def with_training_range(model: VisibilityModel, features: FloatArray) -> VisibilityModel:
    """The model that clamps to the reduced inputs of features (P, 1 or C, F), as it stores them."""
    inputs = (np.swapaxes(features, 0, 1) - model.input_mean[:, None]) @ model.input_basis
    low, high = (extreme(axis=1).astype(np.float32) for extreme in (inputs.min, inputs.max))
    return dataclasses.replace(model, input_low=low, input_high=high)


def fit_features(
    dataset: Dataset, poses: FloatArray, slots: IntArray, config: TrainConfig
) -> Features:
    """The configured features, fitted to the dataset's scene."""
    if dataset.joint_weights is None or dataset.joint_parents is None:
        if config.features in ("occluders", "local_joints"):
            raise PrtnetError(
                "--features", f"{config.features} are made of joints, and a point cache has none; "
                "use joint_angles"
            )  # fmt: skip
        return interior_edges(dataset.faces, dataset.receiver_of_vertex)
    if config.features == "joint_angles":
        return fit_joint_angles(poses, dataset.joint_parents)
    if config.features == "local_joints":
        return fit_local_joints(
            slots, dataset.rest_positions, dataset.joint_weights, dataset.rest_pose
        )
    return fit_occluders(
        poses, slots, dataset.rest_positions, dataset.rest_normals, dataset.joint_weights,
        dataset.rest_pose, points=config.points, near=config.near, spheres=config.spheres,
        order=config.feature_order, seed=config.seed,
    )  # fmt: skip


def cross_validation_folds(dataset: Dataset, rows: IntArray) -> list[Fold]:
    """Folds over the clips of the training poses ``rows``, or over time where there is only one."""
    folds = folds_over_clips(dataset.read("sources", rows).astype(bool))
    if folds:
        return folds
    direct = np.array([name != SAMPLED for name in dataset.clip_names])[dataset.clip[rows]]
    if len(np.unique(dataset.clip[rows][direct])) != 1:
        return []
    return folds_over_time(dataset.time[rows], direct)


def to_device(inputs: FloatArray, targets: FloatArray, device: str) -> Problem:
    """Tensors on the device, float32: the closed forms keep their accuracy (see the tests)."""
    try:
        where = torch.device(device)
        x, t = (torch.tensor(a, dtype=torch.float32, device=where) for a in (inputs, targets))
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise PrtnetError("--device", f"'{device}' cannot be used ({reason}); use cpu") from error
    return Problem(x, t)


def with_products_and_smoothness(
    data: Problem, dataset: Dataset, rows: IntArray, config: TrainConfig
) -> Problem:
    """What quadratic models and the prior of smoothness add."""
    if config.regression == "quadratic":
        products = Products(data.inputs, config.leading)
        data = dataclasses.replace(data, inputs=products(data.inputs), products=products)
    if config.regression in ("linear", "quadratic") and config.smoothness > 0:
        sampled = sampled_clip(dataset.clip_names)
        steps = consecutive(dataset.read("clip", rows), dataset.read("time", rows), sampled)
        smoothness = config.smoothness * change_covariance(data.inputs, steps)
        data = dataclasses.replace(data, smoothness=smoothness)
    return data


def select(
    data: Problem, config: TrainConfig, folds: list[Fold], watch: Monitor
) -> tuple[int, float, dict[str, float]]:
    """Neurons and α as configured, or by cross-validation; the errors of all tried."""
    neural = config.regression in NEURAL
    neurons = DEFAULT_NEURONS if config.neurons == "auto" else config.neurons
    sized = config.neurons != "auto" or not neural
    if sized and config.alpha is not None:
        return neurons, config.alpha, {}
    # What a prior leaves of clips that it was fitted to says little about others.
    unfit = config.kind == "constant" or config.kind in AROUND
    if unfit or len(folds) < 2 or data.targets.shape[2] == 0:
        return neurons, DEFAULT_ALPHA if config.alpha is None else config.alpha, {}
    watch.stage(f"cross-validation, {len(folds)} folds")

    def network(inputs: Tensor, targets: Tensor, neurons: int, alpha: float) -> Fit:
        return fit_neural(inputs, targets, neurons, alpha, TRIAL_ITERATIONS, config.seed)

    def trial(inputs: Tensor, targets: Tensor, alpha: float) -> Fit:
        if not neural:
            return fit_linear(inputs, targets, alpha, data.smoothness)
        return network(inputs, targets, neurons, alpha)

    def show(alpha: float, error: float) -> None:
        watch.scalar("cross_validation/error", error, round(alpha * 1e6))

    if sized:
        alpha, errors = choose_alpha(trial, data.inputs, data.targets, folds, on_candidate=show)
        return neurons, alpha, {f"{a:g}": e for a, e in errors.items()}
    alphas = ALPHAS if config.alpha is None else (config.alpha,)
    start = neurons, DEFAULT_ALPHA if config.alpha is None else config.alpha
    neurons, alpha, pairs = choose_neurons(
        network, data.inputs, data.targets, folds, alphas, start=start, on_candidate=show
    )
    return neurons, alpha, {f"{n} neurons, {a:g}": e for (n, a), e in pairs.items()}


def fit(
    data: Problem, config: TrainConfig, neurons: int, alpha: float, watch: Monitor
) -> list[Fit]:
    """The final fits: one, or several networks from different starts."""
    if config.regression not in NEURAL or data.targets.shape[2] == 0:
        return [fit_linear(data.inputs, data.targets, alpha, data.smoothness)]
    fits = []
    limit = total_iterations(config.iterations, config.restarts)
    for network in range(config.networks):

        def on_iteration(iteration: int, values: Tensor, network: int = network) -> None:
            loss = float(values.mean())
            watch.progress(network * limit + iteration + 1, config.networks * limit, loss)
            watch.scalar(f"fit/objective_{network}", loss, iteration)
            if iteration % 25 == 0:
                watch.histogram(f"fit/objective_{network}", values.cpu().numpy(), iteration)

        fitted = fit_neural(
            data.inputs, data.targets, neurons, alpha, config.iterations,
            config.seed + network, on_iteration, config.restarts,
        )  # fmt: skip
        fits.append(fitted)
    return fits


def report_convergence(fits: Sequence[Mapping[str, Any]], watch: Monitor) -> None:
    """How each cluster's fits ended, of :func:`convergence`.

    By cluster, also 1 in the chart of the status that it ended with and 0 in those of others; as
    histograms; and as counts.
    """
    for network, fitted in enumerate(fits):
        watch.histogram("fit/iterations", np.array(fitted["iterations"]), network)
        watch.histogram("fit/final_objective", np.array(fitted["objective"]), network)
        for text, clusters in fitted["clusters"].items():
            name = text.replace(" ", "_")
            watch.scalar(f"fit/{name}", len(clusters), network)
            for cluster in range(len(fitted["iterations"])):
                watch.scalar(f"fit/{name}_{network}_by_cluster", cluster in clusters, cluster)
        for what in ("objective", "iterations"):
            for cluster, value in enumerate(fitted[what]):
                watch.scalar(f"fit/{what}_{network}_by_cluster", value, cluster)


def convergence(fitted: Fit) -> dict[str, Any]:
    """How each cluster's fit ended, for the model's header.

    Clusters by status; of each its iterations and the objective of targets of unit variance.
    """
    clusters = {
        text: [cluster for cluster, own in enumerate(fitted.status) if own == text]
        for text in sorted(set(fitted.status))
    }
    objective = [float(f"{loss:.4g}") for loss in fitted.loss.tolist()]
    return {
        "clusters": clusters, "iterations": fitted.iterations.tolist(), "objective": objective,
    }  # fmt: skip


def side_by_side(targets: FloatArray, parts: int) -> FloatArray:
    """Latents of groups (C · parts, P, L) as those of their clusters (C, P, parts · L)."""
    groups, poses, count = targets.shape
    split = targets.reshape(groups // parts, parts, poses, count)
    return np.swapaxes(split, 1, 2).reshape(groups // parts, poses, parts * count)


def to_regressor(fitted: Fit, products: Products | None, parts: int) -> Regressor:
    """As float32 NumPy arrays, the last layer split over each cluster's groups."""

    def array(tensor: Tensor | None) -> FloatArray | None:
        return None if tensor is None else tensor.cpu().numpy().astype(np.float32)

    pairs = None if products is None else products.pairs
    weight = array(fitted.weight if products is None else products.unscaled(fitted.weight))
    bias = array(fitted.bias)
    assert weight is not None
    assert bias is not None
    clusters, inner, count = weight.shape
    shape = (clusters * parts, inner, count // parts)
    weight = np.swapaxes(weight.reshape(clusters, inner, parts, count // parts), 1, 2).reshape(
        shape
    )
    bias = bias.reshape(shape[0], shape[2])
    return Regressor(weight, bias, array(fitted.hidden_weight), array(fitted.hidden_bias), pairs)


def fit_facts(fits: list[Fit]) -> dict[str, Any]:
    """How the fits went, for the model file."""
    status = [text for fitted in fits for text in fitted.status]
    return {
        "fit_status": {text: status.count(text) for text in sorted(set(status))},
        "fits": [convergence(fitted) for fitted in fits],
    }


def describe(dataset: Dataset, config: TrainConfig, features: Features) -> dict[str, Any]:
    """What the model file says about itself."""
    moving = getattr(features, "joint", None)
    names = dataset.joint_names
    still = [] if moving is None else sorted(set(range(len(names))) - set(moving.tolist()))
    return {
        "prtnet": __version__,
        "made_with": made_with(*PACKAGES, threads=thread_count()),
        "format_version": FORMAT_VERSION,
        "config": dataclasses.asdict(config),
        "dropped_joints": [names[joint] for joint in still],
        "pose_size": int(dataset.pose_size),
        "scene_kind": dataset.scene_kind,
        "scene_name": dataset.scene_name,
        "scene_sha256": dataset.scene_sha256,
        "mesh_sha256": dataset.mesh_sha256,
        "two_sided": dataset.two_sided,
        "clips": list(dataset.clip_names),
        "held_out": list(dataset.held_out),
    }


def report_errors(model: VisibilityModel, dataset: Dataset, watch: Monitor) -> None:
    """Training and held-out errors by the reference evaluation, into the metadata."""
    known = evenly(dataset.training_poses(), JUDGED)
    for name, rows in (("training", known), ("held_out", dataset.held_out_poses())):
        if len(rows) == 0:
            continue
        watch.stage(f"{name.replace('_', '-')} error")
        space = OutputSpace.of(model.metadata)
        total = ErrorSum()

        def predicted(block: IntArray, space: OutputSpace = space) -> tuple[FloatArray, FloatArray]:
            return model(dataset.read("pose", block)), space.read(dataset, block)

        blocks = np.array_split(rows, -(-len(rows) // BLOCK))
        count = thread_count()
        with in_threads() as each:
            for first in range(0, len(blocks), count):  # so that few are held
                for one in each(predicted, blocks[first : first + count]):
                    total.add(*one)
        summary = total.summary()
        model.metadata[f"{name}_error"] = summary
        watch.scalar(f"error/{name}", summary["rms"], 0)
        watch.histogram(f"error/{name}_by_receiver", total.relative(), 0)
