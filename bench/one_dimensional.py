"""Models of kind lobes: error, size and speed, and the comparisons of the paper of 1D BRDFs.

python bench/one_dimensional.py [robot|human] [--write]

[1] is Nowrouzezahrai, Kalogerakis, Simari, Fiume, "Shadowed Relighting of Dynamic Geometry with 1D
BRDFs", 2008: a linear model of each vertex from the joint angles. The human's poses are every
fourth.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator

import numpy as np
import torch
from tables import HUMAN, OUT, ROBOT, ROOT, dataset, per_cent, publish

from prtnet import lobe_numbers
from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.lobe_numbers import LobeNumbers
from prtnet.metrics import ErrorSum, relative_rms
from prtnet.model import Regressor, VisibilityModel
from prtnet.operators import cosine_matrix
from prtnet.output_space import OutputSpace
from prtnet.zh import RIDGE, Lobes
from runtime.onnx_model import OnnxModel
from training.clustering import cluster_receivers
from training.config import PRESETS, TrainConfig
from training.lobe_targets import lobe_targets
from training.monitor import Silent
from training.onnx_export import build_onnx
from training.outputs import Layout, Outputs
from training.reduction import reduce_output
from training.train import (
    cross_validation_folds,
    prepared,
    report_errors,
    select,
    with_training_range,
)

PAPERS = ROOT / "docs" / "papers.md"
LOBES = (0, 1, 2)  # 0: coefficients, no lobes
TARGETS = ("visibility", "cosine")
LINEAR, OURS = "linear, joint angles [1]", "neural, occluders"
REGRESSORS: dict[str, dict[str, object]] = {
    LINEAR: {
        "regressor": "linear", "features": "joint_angles", "latents": 1e9, "output_variance": 1.0,
        "step": 1,
    },
    "linear, occluders": {"regressor": "linear"},
    OURS: {"regressor": "neural"},
}  # fmt: skip
STEP = 4  # the fits' own error is of every so many held-out poses


class FewerPoses(Dataset):
    """Every fourth training pose: fits of lobes of all would take an hour."""

    def training_poses(self) -> IntArray:
        return super().training_poses()[::4]


def scene(name: str) -> Dataset:
    """The dataset, with as many poses as the benchmark uses."""
    if name == "robot":
        return dataset("robot", "robot.glb", ROBOT)
    return FewerPoses.open(dataset("human", "human.glb", HUMAN).path)


class Predicted:
    """What models of one scene, number of lobes and target predict: fitted once for all.

    Args:
        name: of the scene.
        lobes: c, or 0 for coefficients.
        target: visibility, or cosine.
    """

    def __init__(self, name: str, lobes: int, target: str) -> None:
        self.data, self.lobes, self.space = scene(name), lobes, OutputSpace("local", target)
        self.rows = self.data.training_poses()
        self.clusters = 16 if name == "robot" else 64
        truth = self.space.read(self.data, self.rows)
        self.signal = truth.mean(axis=0, dtype=np.float64).astype(np.float32)
        self.slots = cluster_receivers(self.data, self.rows, truth, self.config())
        self.numbers = lobe_targets(truth, lobes, Silent()) if lobes else truth

    def config(self, **options: object) -> TrainConfig:
        """The configuration of one regressor."""
        base = dataclasses.replace(PRESETS["default"], clusters=self.clusters, latents=14.0)
        kind = "lobes" if self.lobes else options.get("regressor", "neural")
        if not self.lobes:
            options = {name: value for name, value in options.items() if name != "regressor"}
        return dataclasses.replace(
            base, kind=kind, lobes=max(1, self.lobes), target=self.space.target, **options
        )

    def model(self, **options: object) -> VisibilityModel:
        """A trained model with its errors."""
        config = self.config(**options)
        around = {"lobes": self.lobes, "signal": self.signal} if self.lobes else {}
        reduction = reduce_output(
            self.numbers, self.slots, config.output_variance, config.latents, config.step
        )
        outputs = Outputs(Layout(self.slots, self.slots), reduction, around)
        fitting = prepared(self.data, self.rows, config, Silent(), outputs)
        folds = cross_validation_folds(self.data, self.rows)
        neurons, alpha, _ = select(fitting.data, config, folds, Silent())
        model = fitting.model(neurons, alpha, Silent())
        if config.features == "joint_angles":
            model = of_vertices(model)
        else:
            model = with_training_range(model, fitting.features)
        report_errors(model, self.data, Silent())
        return model

    def own_error(self) -> float | None:
        """Of lobes fitted to held-out poses themselves; nothing predicts better."""
        if not self.lobes:
            return None
        coding = LobeNumbers(self.lobes, self.data.order)
        start: Lobes = coding.start(self.signal)
        total = ErrorSum()
        for row in self.data.held_out_poses()[::STEP]:
            truth = self.space.read(self.data, np.array([row]))
            total.add(coding.harmonics(coding.fitted(truth, start)), truth)
        return total.rms()


def of_vertices(model: VisibilityModel) -> VisibilityModel:
    """The same linear model without components between: a matrix for each vertex, as in [1]."""
    mean, basis = model.mean.copy(), []
    for group, (start, count) in enumerate(zip(model.first_component, model.latents, strict=True)):
        own = model.basis[start : start + count]
        mean[group] += model.regressor.bias[group, :count] @ own
        basis.append(model.regressor.weight[group, :, :count] @ own)
    groups, inputs = model.regressor.weight.shape[:2]
    same = np.tile(np.eye(inputs, dtype=np.float32), (groups, 1, 1))
    return dataclasses.replace(
        model,
        mean=mean,
        basis=np.concatenate(basis).astype(np.float32),
        latents=np.full(groups, inputs, dtype=np.int32),
        regressor=Regressor(same, np.zeros((groups, inputs), dtype=np.float32)),
    )


def blocks(rows: IntArray, size: int = 8) -> Iterator[IntArray]:
    """Rows, so many at a time."""
    for start in range(0, len(rows), size):
        yield rows[start : start + size]


def pose_errors(
    model: VisibilityModel, data: Dataset, rows: IntArray, weighted: bool = False
) -> FloatArray:
    """Relative RMS of each pose; ``weighted``: of prediction and truth times the cosine."""
    found: list[float] = []
    space = OutputSpace.of(model.metadata)
    matrix = cosine_matrix(data.order) if weighted else np.eye(data.order**2)
    for some in blocks(rows):
        answer, truth = model(data.read("pose", some)) @ matrix, space.read(data, some) @ matrix
        found += [relative_rms(a[None], t[None]) for a, t in zip(answer, truth, strict=True)]
    return np.array(found)


def spread(errors: FloatArray) -> str:
    """Mean ± standard deviation."""
    return f"{100 * errors.mean():.2f} ± {100 * errors.std():.2f} %"


def measured(own: Predicted, label: str, model: VisibilityModel, floor: float | None) -> list[str]:
    """A row: errors, sizes and milliseconds."""
    rms = [model.metadata[f"{part}_error"]["rms"] for part in ("training", "held_out")]
    proto = build_onnx(model).SerializeToString()
    small = model.stored_as("int8")
    eighth = len(build_onnx(small).SerializeToString())
    report_errors(small, own.data, Silent())
    pose = own.data.read("pose", slice(1))
    rounded = small.metadata["held_out_error"]["rms"]
    row = [
        str(own.lobes or "–"), own.space.target, label, *map(per_cent, [*rms, floor]),
        f"{len(proto) / 1e6:.2f}", f"{eighth / 1e6:.2f}", per_cent(rounded),
        f"{OnnxModel(proto, threads=2).milliseconds(pose, repeats=300):.2f}",
    ]  # fmt: skip
    print(row, flush=True)
    return row


def figure3(own: Predicted, model: VisibilityModel) -> list[str]:
    """[1] figure 3: errors of the linear model, plain and then with the cosine."""
    found = [str(own.lobes or "–"), own.space.target]
    for weighted in (False, True):
        if weighted and own.space.target == "cosine":
            return [*found, "–", "–"]
        for rows in (own.rows, own.data.held_out_poses()):
            found.append(spread(pose_errors(model, own.data, rows, weighted)))
    return found


def usual_ridge(name: str) -> list[str]:
    """Two lobes whose fits are as near as they can be."""
    kept = lobe_numbers.LOBE_RIDGE
    lobe_numbers.LOBE_RIDGE = RIDGE
    try:
        own = Predicted(name, 2, "visibility")
        model = own.model(**REGRESSORS[OURS])
        return measured(own, f"{OURS}, nearest fits", model, own.own_error())
    finally:
        lobe_numbers.LOBE_RIDGE = kept


def run(name: str) -> None:
    """All tables of one scene."""
    rows, third, fifth = [], [], {}
    for target in TARGETS:
        for lobes in LOBES:
            own = Predicted(name, lobes, target)
            floor = own.own_error()
            for label, options in REGRESSORS.items():
                if target == "cosine" and label != LINEAR and lobes == 0:
                    continue
                model = own.model(**options)
                model.save(OUT / f"{name} {lobes or 'no'} lobes, {target}, {label}.safetensors")
                rows.append(measured(own, label, model, floor))
                if label == LINEAR:
                    third.append(figure3(own, model))
                    if target == "visibility" and lobes:
                        fifth[lobes] = model
    if name == "robot":
        rows.append(usual_ridge(name))
    columns = ("lobes", "target", "regressor", "training", "held-out", "fits alone", "MB",
               "MB in 8 bits", "held-out in 8 bits", "ms")  # fmt: skip
    publish(f"lobes of {name}", columns, rows)
    columns = ("lobes", "fitted", "training", "held-out", "training, times the cosine",
               "held-out, times the cosine")  # fmt: skip
    publish(f"cosine {name}", columns, third, page=PAPERS)
    data = scene(name)
    clips = [clip for clip in data.clip_names if len(data.poses_of(clip)) > 0]
    columns = ("clip", *(f"{lobes} lobe{'s' * (lobes > 1)}" for lobes in fifth))
    table = [
        [
            f"{clip}, held out" if clip in data.held_out else clip,
            *(spread(pose_errors(m, data, data.poses_of(clip)[::2])) for m in fifth.values()),
        ]
        for clip in clips
    ]
    publish(f"lobes by clip {name}", columns, table, page=PAPERS)


if __name__ == "__main__":
    torch.set_num_threads(2)
    for chosen in [name for name in ("robot", "human") if name in sys.argv] or ["robot", "human"]:
        run(chosen)
