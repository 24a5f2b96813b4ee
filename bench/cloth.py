"""A cloth's held-out error: dihedral angles in clusters, and what each receiver sees around it.

python bench/cloth.py [--write]
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np
import torch
from tables import CLOTH, dataset, per_cent, publish

from prtnet.dataset import Dataset
from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from prtnet.metrics import ErrorSum
from prtnet.prior import NetworkPrior
from runtime.onnx_model import OnnxModel
from training.config import PRESETS
from training.onnx_export import build_onnx
from training.patch_fit import fit_patches
from training.prior_samples import draw_samples
from training.shared_network import NetworkConfig, fit_network
from training.train import train

COLUMNS = ("model", "held-out", "p99", "MB", "ms", "training s")
SAMPLES = 600_000


def clustered(data: Dataset, kind: str) -> tuple[list[str], dict[str, float]]:
    """The papers' dihedral angles; and the yardsticks."""
    started = time.perf_counter()
    config = dataclasses.replace(
        PRESETS["default"], kind=kind, latents=24, inputs=60, input_variance=0.9
    )
    model = train(data, config)
    seconds = time.perf_counter() - started
    proto = build_onnx(model).SerializeToString()
    predict = OnnxModel(proto, threads=2)
    blocks = dataset_truth(model, data, data.held_out)
    result = evaluate(model, predict, blocks, NearestPose(data))
    milliseconds = predict.milliseconds(data.read("pose", slice(1)), repeats=50)
    size, speed = f"{len(proto) / 1e6:.1f}", f"{milliseconds:.1f}"
    name = f"dihedral angles, {kind}"
    cells = [name, per_cent(result["rms"]), per_cent(result["p99"]), size, speed, f"{seconds:.0f}"]
    return cells, result


def shared(data: Dataset, width: int) -> list[str]:
    """Control points and patches, one network for all receivers; in NumPy."""
    started = time.perf_counter()
    rows = data.training_poses()
    poses, visibility = data.read("pose", rows), data.read("visibility", rows)
    mean = visibility.mean(axis=0)
    rest = data.rest_pose.reshape(-1, 3)
    seen = fit_patches(
        data.faces, data.receiver_of_vertex, rest, data.rest_tangents, data.two_sided
    )
    samples = draw_samples(seen, poses, visibility, mean, SAMPLES, 0, lambda *_: None)
    layers = fit_network(samples, mean, NetworkConfig(width=width, batch=1024))
    low, high = samples.features.min(axis=0), samples.features.max(axis=0)
    prior = NetworkPrior(seen, low, high, layers.code, layers.weights, layers.biases)
    seconds = time.perf_counter() - started
    error = ErrorSum()
    for row in data.held_out_poses():
        truth = data.read("visibility", np.array([row]))
        error.add(mean + prior(data.read("pose", np.array([row])), mean), truth)
    summary = error.summary()
    size = (sum(a.nbytes for a in prior.arrays().values()) + mean.nbytes) / 1e6
    name = f"control points and patches, shared network of {width}"
    errors = per_cent(summary["rms"]), per_cent(summary["p99"])
    return [name, *errors, f"{size:.1f}", "–", f"{seconds:.0f}"]


def main() -> None:
    data = dataset("cloth", "cloth_train.npz", CLOTH)
    print("cloth: traced", flush=True)
    ours = [shared(data, width) for width in (64, 128)]
    print(ours, flush=True)
    (linear, yardsticks), (neural, _) = clustered(data, "linear"), clustered(data, "neural")
    rows = [
        [name, per_cent(yardsticks[key]), *["–"] * 4]
        for name, key in (
            ("mean", "signal"), ("nearest training pose", "nearest"),
            ("floor of 64 clusters, 24 latents", "pca_floor"),
        )
    ]  # fmt: skip
    publish("cloth", COLUMNS, [*rows, linear, neural, *ours])


if __name__ == "__main__":
    torch.set_num_threads(2)
    main()
