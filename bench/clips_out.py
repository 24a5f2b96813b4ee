"""Leave one clip out: the human on each of its clips, trained on the other two.

python bench/clips_out.py [--write]

A model that fits its training poses and nothing else can be worse than the mean of visibility;
none of these may be.
"""

from __future__ import annotations

import dataclasses

import torch
from tables import HUMAN, dataset, per_cent, publish

from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from runtime.onnx_model import OnnxModel
from training.config import PRESETS
from training.onnx_export import build_onnx
from training.train import train

CLIPS = ("RangeOfMotion", "Walk", "Playground_A")
EFFORT = dataclasses.replace(HUMAN, rays=256, sample=300)
MODELS = {
    "joint angles": dataclasses.replace(PRESETS["default"], features="joint_angles"),
    "occluders": PRESETS["default"],
    "preset tiny": PRESETS["tiny"],
    "kind shared": dataclasses.replace(
        PRESETS["default"], kind="shared", steps=2000, samples=1_000_000
    ),
}
COLUMNS = ("held out, model", "error", "p99", "mean", "nearest", "error / mean", "distance")


def main() -> None:
    """Every clip, every model."""
    torch.set_num_threads(2)
    rows = []
    for clip in CLIPS:
        config = dataclasses.replace(EFFORT, holdout=(clip,))
        data = dataset(f"human_without_{clip}", "human.glb", config)
        for name, fit in MODELS.items():
            model = train(data, fit)
            predict = OnnxModel(build_onnx(model).SerializeToString(), threads=2)
            blocks = dataset_truth(model, data, data.held_out)
            result = evaluate(model, predict, blocks, NearestPose(data))
            share = result["rms"] / result["signal"]
            figures = (per_cent(result[key]) for key in ("rms", "p99", "signal", "nearest"))
            distance = result["distance"]["mean"]
            rows.append([f"{clip}, {name}", *figures, f"{share:.2f}", f"{distance:.2f}"])
            print(rows[-1], flush=True)
    publish("clips_out", COLUMNS, rows)


if __name__ == "__main__":
    main()
