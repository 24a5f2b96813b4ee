"""Does `prtnet train --max-error` keep its word on clips that nobody has seen?

python bench/budget.py [robot|human|cloth] [--write]
"""

from __future__ import annotations

import dataclasses
import sys
import time

import numpy as np
import torch
from tables import CLOTH, HUMAN, ROBOT, dataset, held_out_errors, per_cent, publish

from runtime.onnx_model import OnnxModel
from training.budget import Budget
from training.config import PRESETS
from training.onnx_export import build_onnx
from training.search import Candidates, best, compare

SCENES = {
    "robot": ("robot", "robot.glb", ROBOT, 16, 4),
    "human": ("human", "human.glb", HUMAN, 64, 3),
    "cloth": ("cloth", "cloth_train.npz", CLOTH, 64, 3),
}
"""Dataset, scene, configuration, clusters, number of targets."""
COLUMNS = ("target", "expected", "held-out", "met", "kind", "storage", "MB", "ms", "seconds")


def rows_of(name: str) -> list[list[str]]:
    """Targets spread over what is feasible by cross-validation, and what became of them."""
    label, scene, config, clusters, count = SCENES[name]
    data = dataset(label, scene, config)
    base = dataclasses.replace(PRESETS["default"], clusters=clusters)
    candidates = Candidates(data, base)
    pose = data.read("pose", slice(1))

    def milliseconds(proto: bytes) -> float:
        return OnnxModel(proto, threads=2).milliseconds(pose)

    started = time.perf_counter()
    everything = compare(candidates, Budget(max_mb=1e3), milliseconds)
    least = min(choice.error for choice in everything)
    most = max(float(candidates[c.family].errors(c.storage)[0]) for c in everything)
    print(f"{name}: {time.perf_counter() - started:.0f} s", [*everything], flush=True)
    rows = []
    for target in np.geomspace(1.03 * least, 0.8 * most, count):
        started = time.perf_counter()
        budget = Budget(max_error=float(target))
        choice = best(compare(candidates, budget, milliseconds), budget)
        proto = build_onnx(candidates.finished(choice)).SerializeToString()
        predict = OnnxModel(proto, threads=2)
        error = held_out_errors(data, predict)["rms"]
        rows.append(
            [
                f"{name}, {per_cent(target)}",
                per_cent(choice.error),
                per_cent(error),
                "yes" if error <= target else "no",
                choice.family,
                choice.storage,
                f"{len(proto) / 1e6:.2f}",
                f"{predict.milliseconds(pose):.2f}",
                f"{time.perf_counter() - started:.0f}",
            ]
        )
        print(rows[-1], flush=True)
    return rows


def main() -> None:
    """Ten targets in all."""
    torch.set_num_threads(2)
    chosen = [name for name in SCENES if name in sys.argv] or list(SCENES)
    rows = [row for name in chosen for row in rows_of(name)]
    met = sum(row[3] == "yes" for row in rows)
    publish("budget", COLUMNS, rows, note=f"{met} of {len(rows)} targets met on held-out clips.")


if __name__ == "__main__":
    main()
