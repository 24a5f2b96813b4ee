"""Does a search keep its word on clips that nobody has seen?

python bench/budget.py [robot|human|cloth] [--write]
"""

from __future__ import annotations

import dataclasses
import sys
import time

import numpy as np
import torch
from ablation import Thinned
from tables import CLOTH, HUMAN, PAGE, ROBOT, dataset, held_out_errors, per_cent, publish

from runtime.onnx_model import OnnxModel
from training.budget import Budget
from training.config import PRESETS
from training.onnx_export import build_onnx
from training.search import Candidates, best, compare, kept

SCENES = {
    "robot": ("robot", "robot.glb", ROBOT, 16, 4),
    "human": ("human", "human.glb", HUMAN, 64, 3),
    "cloth": ("cloth", "cloth_train.npz", CLOTH, 64, 3),
}
"""Dataset, scene, configuration, clusters, number of targets."""
LIMITS = {
    "robot": [Budget(max_mb=1.5), Budget(max_mb=1.5, max_ms=0.25)],
    "human": [Budget(max_mb=1.5, max_ms=1.0), Budget(max_ms=0.35)],
}
"""Of bytes and milliseconds, beside the targets for the error."""
COLUMNS = ("target", "expected", "held-out", "met", "kind", "kept", "MB", "ms", "seconds")


def rows_of(name: str) -> list[list[str]]:
    """Targets spread over what is feasible by cross-validation, and what became of them."""
    label, scene, config, clusters, count = SCENES[name]
    data = dataset(label, scene, config)
    if name == "human":
        data = Thinned.open(data.path)
    base = dataclasses.replace(PRESETS["default"], clusters=clusters)
    candidates = Candidates(data, base)
    pose = data.read("pose", slice(1))

    def milliseconds(proto: bytes) -> float:
        return OnnxModel(proto, threads=2).milliseconds(pose)

    started = time.perf_counter()
    everything = compare(candidates, Budget(max_mb=1e3), milliseconds)
    least = min(choice.error for choice in everything)
    most = max(float(candidates[c.family].errors[0]) for c in everything)
    print(f"{name}: {time.perf_counter() - started:.0f} s", [*everything], flush=True)
    targets = np.geomspace(1.03 * least, 0.8 * most, count)
    budgets = [Budget(max_error=float(target)) for target in targets] + LIMITS.get(name, [])
    rows = []
    for budget in budgets:
        started = time.perf_counter()
        choice = best(compare(candidates, budget, milliseconds), budget)
        model = candidates.finished(choice)
        proto = build_onnx(model).SerializeToString()
        predict = OnnxModel(proto, threads=2)
        error, ms = held_out_errors(data, predict)["rms"], predict.milliseconds(pose, repeats=400)
        kept_to = (
            error <= (budget.max_error or np.inf)
            and len(proto) <= 1e6 * (budget.max_mb or np.inf)
            and ms <= (budget.max_ms or np.inf)
        )
        rows.append(
            [
                f"{name}, {budget.text()}",
                per_cent(choice.error),
                per_cent(error),
                "yes" if kept_to else "no",
                choice.family,
                kept(model),
                f"{len(proto) / 1e6:.2f}",
                f"{ms:.2f}",
                f"{time.perf_counter() - started:.0f}",
            ]
        )
        print(rows[-1], flush=True)
    return rows


def kept_of(name: str) -> list[list[str]]:
    """A scene's rows as they stand in the page: it takes many minutes to make them anew."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    own = [line for line in lines if line.startswith((f"| {name}, an error of", *limits(name)))]
    return [[cell.strip() for cell in line.strip("| ").split(" | ")] for line in own]


def limits(name: str) -> tuple[str, ...]:
    """How the rows of a scene's limits begin."""
    return tuple(f"| {name}, {budget.text()} |" for budget in LIMITS.get(name, []))


def main() -> None:
    """Ten targets for the error in all, and limits of bytes and milliseconds."""
    torch.set_num_threads(2)
    chosen = [name for name in SCENES if name in sys.argv] or list(SCENES)
    rows = [row for name in SCENES for row in (rows_of(name) if name in chosen else kept_of(name))]
    targets = [row for row in rows if "an error of" in row[0]]
    met = sum(row[3] == "yes" for row in targets)
    note = f"{met} of {len(targets)} targets for the error met on held-out clips."
    publish("budget", COLUMNS, rows, note=note)


if __name__ == "__main__":
    main()
