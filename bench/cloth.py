"""A cloth's held-out error: dihedral angles in clusters, and what each receiver sees around it.

python bench/cloth.py [--write]
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import torch
from tables import CLOTH, dataset, per_cent, publish

from prtnet.dataset import Dataset
from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from runtime.onnx_model import OnnxModel
from training.config import PRESETS, TrainConfig
from training.onnx_export import build_onnx
from training.train import train

COLUMNS = ("model", "held-out", "p99", "MB", "ms", "training s")


def clustered(data: Dataset, kind: str) -> tuple[list[str], dict[str, float]]:
    """The papers' dihedral angles; and the yardsticks."""
    config = dataclasses.replace(
        PRESETS["default"], kind=kind, latents=24, inputs=60, input_variance=0.9
    )
    return measured(f"dihedral angles, {kind}", data, config)


def measured(name: str, data: Dataset, config: TrainConfig) -> tuple[list[str], dict[str, float]]:
    """A row of the table, and the yardsticks."""
    started = time.perf_counter()
    model = train(data, config)
    seconds = time.perf_counter() - started
    proto = build_onnx(model).SerializeToString()
    predict = OnnxModel(proto, threads=2)
    blocks = dataset_truth(model, data, data.held_out)
    result = evaluate(model, predict, blocks, NearestPose(data))
    milliseconds = predict.milliseconds(data.read("pose", slice(1)), repeats=50)
    size, speed = f"{len(proto) / 1e6:.1f}", f"{milliseconds:.1f}"
    cells = [name, per_cent(result["rms"]), per_cent(result["p99"]), size, speed, f"{seconds:.0f}"]
    return cells, result


def around(data: Dataset, **options: Any) -> list[str]:
    """What every receiver sees around it."""
    name = f"{options['kind']}, {options.get('width', 'maps')}"
    return measured(name, data, dataclasses.replace(PRESETS["default"], latents=0, **options))[0]


def main() -> None:
    data = dataset("cloth", "cloth_train.npz", CLOTH)
    print("cloth: traced", flush=True)
    ours = [around(data, kind="hybrid"), *(around(data, kind="shared", width=w) for w in (64, 128))]
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
