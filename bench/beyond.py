"""What clamping inputs to the training range and fading beyond it does to held-out clips.

python bench/beyond.py [robot|human] [--write]
"""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import torch
from models import ClipsOnly
from tables import HUMAN, ROBOT, dataset, per_cent, publish

from prtnet.arrays import IntArray
from prtnet.dataset import Dataset
from prtnet.evaluation import dataset_truth, evaluate
from runtime.onnx_model import OnnxModel
from training.config import PRESETS, TrainConfig
from training.onnx_export import build_onnx
from training.train import train

COLUMNS = (
    "model", "held-out, free", "held-out, clamped", "signal", "distance",
    "correlation with error", "ms, free", "ms, clamped", "MB, free", "MB, clamped",
)  # fmt: skip
NARROW = ("Robot_Idle", "Robot_Walking")


class Narrow(Dataset):
    """The robot, trained on two clips only: nearly everything held out is far from them."""

    def training_poses(self) -> IntArray:
        return np.concatenate([self.poses_of(name) for name in NARROW])


def row(name: str, data: Dataset, config: TrainConfig) -> list[str]:
    """One model, with and without its training range."""
    model = train(data, config)
    free = dataclasses.replace(model, input_low=None, input_high=None)
    results, cells = {}, {}
    for label, each in (("free", free), ("clamped", model)):
        proto = build_onnx(each).SerializeToString()
        predict = OnnxModel(proto, threads=2)
        blocks = dataset_truth(model, data, data.held_out)
        results[label] = evaluate(model, predict, blocks)
        milliseconds = predict.milliseconds(data.read("pose", slice(1)), repeats=300)
        cells[label] = [f"{milliseconds:.2f}", f"{len(proto) / 1e6:.2f}"]
    poses = results["clamped"]["poses"]
    distance, error = (np.array([pose[key] for pose in poses]) for key in ("distance", "rms"))
    together = np.corrcoef(distance, error)[0, 1] if np.ptp(distance) > 0 else np.nan
    told = [per_cent(results[label]["rms"]) for label in ("free", "clamped")]
    told += [per_cent(results["clamped"]["signal"]), f"{distance.mean():.3f}", f"{together:.2f}"]
    told += [cells[label][part] for part in (0, 1) for label in ("free", "clamped")]
    print(name, told, flush=True)
    return [name, *told]


def main() -> None:
    """The robot, trained on ten clips and on two; the human without its sampled poses."""
    default = PRESETS["default"]
    small = dataclasses.replace(default, clusters=16, latents=14)
    chosen = [name for name in ("robot", "human") if name in sys.argv] or ["robot", "human"]
    cases: list[tuple[str, Dataset, TrainConfig]] = []
    if "robot" in chosen:
        robot = dataset("robot", "robot.glb", ROBOT)
        cases += [("robot", robot, small), ("robot, two clips", Narrow.open(robot.path), small)]
    if "human" in chosen:
        human = dataset("human", "human.glb", HUMAN)
        cases.append(("human, clips only", ClipsOnly.open(human.path), default))
    rows = []
    for name, data, base in cases:
        for kind in ("linear", "neural"):
            for seen in ("joint_angles", "occluders"):
                config = dataclasses.replace(base, kind=kind, features=seen)
                rows.append(row(f"{name}: {kind}, {seen.replace('_', ' ')}", data, config))
    publish("beyond", COLUMNS, rows)


if __name__ == "__main__":
    torch.set_num_threads(2)
    main()
