"""The batched neural fit against scikit-learn's MLPRegressor, a cluster at a time, same data.

python bench/fitting.py [--write]
"""

from __future__ import annotations

import dataclasses
import statistics
import time
import warnings

import numpy as np
import torch
from sklearn.neural_network import MLPRegressor
from tables import HUMAN, dataset, publish

from training.clusters import balanced_clusters, cluster_coordinates
from training.config import PRESETS
from training.inputs import fit_occluders
from training.reduction import OutputReduction, input_reduction, reduce_output
from training.regression import fit_linear, fit_neural, target_scale

TRAIN, TEST = 200, 100
ALPHA = 3e-3
REPEATS = 5


def relative(predicted: np.ndarray, truth: np.ndarray) -> float:
    """Error of the latents against predicting their mean of zero."""
    return float(np.sqrt(((predicted - truth) ** 2).sum() / (truth**2).sum()))


def main() -> None:
    """64 clusters, 32 neurons, 200 poses to fit and 100 to test, drawn at random."""
    torch.set_num_threads(2)
    warnings.simplefilter("ignore")  # scikit-learn's iteration limit
    data = dataset("human", "human.glb", HUMAN)
    config = dataclasses.replace(PRESETS["default"], neurons=32)
    rows = np.sort(np.random.default_rng(0).permutation(data.training_poses())[: TRAIN + TEST])
    test = np.random.default_rng(1).permutation(TRAIN + TEST) >= TRAIN
    coordinates = cluster_coordinates(data.rest_positions, data.joint_weights)
    slots = balanced_clusters(coordinates, config.clusters)
    output = reduce_output(data.read("visibility", rows), slots, 0.99, config.latents)
    poses = data.read("pose", rows)
    features = fit_occluders(
        poses, slots, data.rest_positions, data.rest_normals, data.joint_weights, data.rest_pose
    )(poses)
    mean, basis = input_reduction(features, config.input_variance, config.inputs)
    inputs = (np.swapaxes(features, 0, 1) - mean[:, None]) @ basis
    x, y = torch.tensor(inputs), torch.tensor(output.targets, dtype=torch.float32)
    table: list[list[str]] = []

    def errors(predicted: np.ndarray) -> tuple[float, float]:
        """Relative error of the latents of the poses fitted to, and of the others."""
        return (
            relative(predicted[:, ~test], output.targets[:, ~test]),
            relative(predicted[:, test], output.targets[:, test]),
        )

    def add(name: str, seconds: float, reached: tuple[float, float], peer: str = "") -> None:
        table.append([name, f"{seconds:.2f}", *(f"{100 * e:.1f} %" for e in reached), peer])
        print(table[-1], flush=True)

    fit_neural(x[:1, ~test], y[:1, ~test], 4, ALPHA, iterations=2)  # warm up
    started = time.perf_counter()
    linear = fit_linear(x[:, ~test], y[:, ~test], 1e-3)
    add("ridge", time.perf_counter() - started, errors(linear(x).numpy()))

    peers = {}
    for limit in (50, 100, 200):
        seconds, predicted = scikit_learn(inputs, output, test, config.neurons, limit)
        peers[limit] = seconds, errors(predicted)
        add(f"scikit-learn MLPRegressor, {limit} iterations", *peers[limit])
    seconds, (train_goal, test_goal) = peers[200]
    waiting = True
    for iterations in (2, 3, 4, 5, 6, 8, 10, 12, 15, 20, 25, 50, 100, 200, 400):
        taken = []
        for _ in range(REPEATS if iterations <= 25 else 1):
            started = time.perf_counter()
            fitted = fit_neural(x[:, ~test], y[:, ~test], config.neurons, ALPHA, iterations)
            taken.append(time.perf_counter() - started)
        ours, reached = statistics.median(taken), errors(fitted(x).numpy())
        sooner = ""
        if waiting and reached[0] <= train_goal and reached[1] <= test_goal:
            waiting, sooner = False, f"{seconds / ours:.0f} ×"
        add(f"prtnet, {iterations} iterations", ours, reached, sooner)
    publish(
        "fitting",
        (
            "fit of 64 clusters, 32 neurons, 200 poses", "seconds", "training error",
            "test error", "sooner",
        ),
        table,
        f"Errors are of the latents, relative to predicting their mean; α = {ALPHA}. *Sooner*:"
        " where prtnet first has both errors of scikit-learn's 200 iterations.",
    )  # fmt: skip


def scikit_learn(
    inputs: np.ndarray, output: OutputReduction, test: np.ndarray, neurons: int, limit: int
) -> tuple[float, np.ndarray]:
    """Seconds and predicted latents of a network a cluster, clusters without latents left out.

    By its gradient scikit-learn minimises ½ mean_i ‖r_i‖² + ½ α/P Σ w²; ours is
    mean_i ‖r_i‖² + α Σ w². The loss it reports also averages over outputs, which its line search
    then sees: the peer as it is installed.
    """
    scale = target_scale(torch.tensor(output.targets)).numpy()
    predicted = np.zeros_like(output.targets)
    started = time.perf_counter()
    for cluster, count in enumerate(output.latents):
        if count == 0:
            continue
        peer = MLPRegressor(
            hidden_layer_sizes=(neurons,), activation="tanh", solver="lbfgs",
            alpha=ALPHA * TRAIN, max_iter=limit, max_fun=100_000, random_state=0,
        )  # fmt: skip
        wanted = output.targets[cluster, ~test, :count] / scale[cluster]
        peer.fit(inputs[cluster, ~test], wanted)
        answer = peer.predict(inputs[cluster]).reshape(len(test), count)
        predicted[cluster, :, :count] = answer * scale[cluster]
    return time.perf_counter() - started, predicted


if __name__ == "__main__":
    main()
