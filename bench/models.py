"""Held-out error, size and speed of models of the robot and the human.

python bench/models.py [robot|human] [--write]
"""

from __future__ import annotations

import dataclasses
import sys
import time

import numpy as np
import torch
from tables import HUMAN, OUT, ROBOT, dataset, per_cent, publish

from prtnet.arrays import IntArray
from prtnet.dataset import SAMPLED, Dataset
from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from prtnet.model import VisibilityModel
from runtime.onnx_model import OnnxModel
from training.config import PRESETS, TrainConfig
from training.graph_cost import operations
from training.onnx_export import build_onnx
from training.train import train

COLUMNS = (
    "model", "held-out", "p99", "signal", "nearest", "floor", "MB", "ms", "kop", "latents", "α",
    "fit s",
)  # fmt: skip


def row(name: str, data: Dataset, config: TrainConfig) -> list[str]:
    """Train, export and evaluate one model."""
    return measured(name, data, config)[0]


def measured(name: str, data: Dataset, config: TrainConfig) -> tuple[list[str], VisibilityModel]:
    """A row of the table, and its model."""
    started = time.perf_counter()
    model = train(data, config)
    print(f"{name}: trained in {time.perf_counter() - started:.0f} s", flush=True)
    model.save(OUT / f"{data.scene_name} {name.replace(':', ',')}.safetensors")
    proto = build_onnx(model)
    predict = OnnxModel(proto.SerializeToString(), threads=2)
    blocks = dataset_truth(model, data, data.held_out)
    result = evaluate(model, predict, blocks, NearestPose(data))
    milliseconds = predict.milliseconds(data.read("pose", slice(1)), repeats=300)
    cells = [
        name,
        *(per_cent(result[key]) for key in ("rms", "p99", "signal", "nearest", "pca_floor")),
        f"{proto.ByteSize() / 1e6:.2f}",
        f"{milliseconds:.2f}",
        f"{operations(proto) / 1e3 / model.receiver_count:.1f}",
        f"{np.mean(model.latents):.1f}",
        f"{model.metadata['alpha']:.2g}",
        f"{model.metadata['seconds']['fit']:.1f}",
    ]
    return cells, model


class ClipsOnly(Dataset):
    """A dataset without its sampled poses."""

    def training_poses(self) -> IntArray:
        return np.setdiff1d(super().training_poses(), self.poses_of(SAMPLED))


def robot() -> None:
    """Ten training clips, four held out, 16 clusters."""
    data = dataset("robot", "robot.glb", ROBOT)
    base = dataclasses.replace(PRESETS["default"], clusters=16, latents=14)
    papers = dataclasses.replace(base, features="joint_angles", input_variance=0.9)
    rows = [
        row("linear, joint angles", data, dataclasses.replace(papers, kind="linear")),
        row("neural, joint angles", data, papers),
        row("linear, occluders", data, dataclasses.replace(base, kind="linear")),
        row("neural, occluders", data, base),
        row("hybrid", data, dataclasses.replace(base, kind="hybrid")),
        row("shared", data, dataclasses.replace(base, kind="shared")),
        row("preset tiny", data, dataclasses.replace(PRESETS["tiny"], clusters=16)),
        row("preset large", data, dataclasses.replace(PRESETS["large"], clusters=16)),
        row(
            "preset large, 4 bits",
            data,
            dataclasses.replace(PRESETS["large"], clusters=16, storage="int4"),
        ),
    ]
    publish("robot", COLUMNS, rows)


def human() -> None:
    """RangeOfMotion and Walk, Playground_A held out; with and without sampled poses."""
    base = PRESETS["default"]
    papers = dataclasses.replace(base, features="joint_angles", input_variance=0.9)
    sampled = dataset("human", "human.glb", HUMAN)
    rows = []
    for name, data in (
        ("clips only", ClipsOnly.open(sampled.path)),
        ("clips and 600 sampled poses", sampled),
    ):
        for kind in ("linear", "neural"):
            for seen, config in (("joint angles", papers), ("occluders", base)):
                chosen = dataclasses.replace(config, kind=kind)
                rows.append(row(f"{name}: {kind}, {seen}", data, chosen))
    wider = dataclasses.replace(base, latents=14)
    for name, config in (
        ("neural, occluders, 14 latents", wider),
        ("preset small", PRESETS["small"]),
        ("preset fast", PRESETS["fast"]),
        ("preset large", PRESETS["large"]),
        ("preset large, 4 bits", dataclasses.replace(PRESETS["large"], storage="int4")),
        ("preset tiny", PRESETS["tiny"]),
        ("preset best", PRESETS["best"]),
    ):
        rows.append(row(f"clips and 600 sampled poses: {name}", sampled, config))
    publish("human", COLUMNS, rows)


if __name__ == "__main__":
    torch.set_num_threads(2)
    chosen = [name for name in ("robot", "human") if name in sys.argv] or ["robot", "human"]
    for name in chosen:
        {"robot": robot, "human": human}[name]()
