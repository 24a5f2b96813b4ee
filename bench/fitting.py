"""The batched neural fit against scikit-learn's MLPRegressor, a cluster at a time, same data.

python bench/fitting.py [--write]
"""

from __future__ import annotations

import dataclasses
import time
import warnings

import numpy as np
import torch
from sklearn.neural_network import MLPRegressor
from tables import HUMAN, dataset, publish

from training.clusters import balanced_clusters, cluster_coordinates
from training.config import PRESETS
from training.inputs import fit_occluders
from training.reduction import input_reduction, reduce_output
from training.regression import fit_linear, fit_neural, target_scale

TRAIN, TEST = 200, 100
ALPHA = 3e-3


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
    table = []

    def add(name: str, seconds: float, predicted: np.ndarray) -> None:
        train_error = relative(predicted[:, ~test], output.targets[:, ~test])
        test_error = relative(predicted[:, test], output.targets[:, test])
        table.append(
            [name, f"{seconds:.1f}", f"{100 * train_error:.1f} %", f"{100 * test_error:.1f} %"]
        )
        print(table[-1], flush=True)

    fit_neural(x[:1, ~test], y[:1, ~test], 4, ALPHA, iterations=2)  # warm up
    started = time.perf_counter()
    linear = fit_linear(x[:, ~test], y[:, ~test], 1e-3)
    add("ridge", time.perf_counter() - started, linear(x).numpy())
    for iterations in (25, 50, 100, 200, 400):
        started = time.perf_counter()
        fitted = fit_neural(x[:, ~test], y[:, ~test], config.neurons, ALPHA, iterations)
        name = f"prtnet, {iterations} iterations"
        add(name, time.perf_counter() - started, fitted(x).numpy())

    # By its gradient scikit-learn minimises ½ mean_i ‖r_i‖² + ½ α/P Σ w²; ours is
    # mean_i ‖r_i‖² + α Σ w². The loss it reports also averages over outputs, which its line
    # search then sees: the peer as it is installed.
    scale = target_scale(y).numpy()
    for limit in (200, 1000):
        predicted = np.zeros_like(output.targets)
        started = time.perf_counter()
        for cluster in range(len(slots)):
            count = output.latents[cluster]
            if count == 0:
                continue
            peer = MLPRegressor(
                hidden_layer_sizes=(config.neurons,), activation="tanh", solver="lbfgs",
                alpha=ALPHA * TRAIN, max_iter=limit, max_fun=100_000, random_state=0,
            )  # fmt: skip
            wanted = output.targets[cluster, ~test, :count] / scale[cluster]
            peer.fit(inputs[cluster, ~test], wanted)
            answer = peer.predict(inputs[cluster]).reshape(TRAIN + TEST, count)
            predicted[cluster, :, :count] = answer * scale[cluster]
        name = f"scikit-learn MLPRegressor, {limit} iterations"
        add(name, time.perf_counter() - started, predicted)
    publish(
        "fitting",
        ("fit of 64 clusters, 32 neurons, 200 poses", "seconds", "training error", "test error"),
        table,
        f"Errors are of the latents, relative to predicting their mean; α = {ALPHA}.",
    )


if __name__ == "__main__":
    main()
