"""What each lever brings on the human: held-out error, megabytes, milliseconds.

python bench/ablation.py [neural] [--write]

Two starting points, a network a cluster (preset default) and a map around every receiver (preset
tiny, in float32); each row changes one thing. Weight decay is chosen anew in every row.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from typing import Any
from unittest import mock

import numpy as np
import torch
from tables import HUMAN, dataset, held_out_errors, markdown, per_cent, publish

from prtnet import prior, sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import SAMPLED, Dataset
from runtime.onnx_model import OnnxModel
from training import ridge_maps
from training.config import PRESETS, TrainConfig
from training.onnx_export import build_onnx
from training.train import train

NOISE = 0.0083  # of visibility at 512 rays, relative: bench/visibility.py
EVERY = 4  # which held-out poses are judged: models around receivers are slow
COLUMNS = ("lever", "held-out", "change", "p99", "MB", "ms", "seconds")
NEURAL = PRESETS["default"]
AROUND = dataclasses.replace(PRESETS["tiny"], storage="float32", samples=600_000)

NEURAL_LEVERS: list[tuple[str, dict[str, Any]]] = [
    ("joint angles in place of occluders", {"features": "joint_angles"}),
    ("local joints in place of occluders", {"features": "local_joints"}),
    ("a line in place of a network", {"kind": "linear"}),
    ("a line and its products", {"kind": "quadratic"}),
    ("12 reference points, 96 spheres near", {"points": 12, "near": 96, "inputs": 64}),
    ("3 reference points, 24 spheres near", {"points": 3, "near": 24}),
    ("caps to order 2", {"feature_order": 2}),
    ("16 neurons", {"neurons": 16}),
    ("64 neurons", {"neurons": 64}),
    ("3 networks averaged into one", {"networks": 3}),
    ("best of 4 starts", {"restarts": 4}),
    ("14 latents", {"latents": 14}),
    ("8 groups a cluster, 32 latents", {"parts": 8, "latents": 32}),
    ("clusters by signal", {"clustering": "signal"}),
    ("clusters of like skin weights", {"clustering": "weights"}),
    ("clusters that turn alike", {"clustering": "rigid"}),
    ("8 bits", {"storage": "int8"}),
    ("4 and 8 bits", {"storage": "int4"}),
    ("all 160 spheres near: no choice of occluders brings more", {"near": 160}),
    ("320 spheres, 96 near: no other shape of occluders does", {"spheres": 320, "near": 96}),
]
AROUND_LEVERS: list[tuple[str, dict[str, Any]]] = [
    ("patches alone, one sphere", {"near_spheres": 1}),
    ("spheres alone, one patch", {"near_patches": 1}),
    ("caps to order 3", {"prior_order": 3}),
    ("8 bits", {"storage": "int8"}),
    ("and 4 latents a cluster", {"latents": 4}),
    ("a shared network in place of maps", {"kind": "shared"}),
]


class Thinned(Dataset):
    """Every second training pose: levers are compared in half the time."""

    def training_poses(self) -> IntArray:
        return super().training_poses()[::2]


class Noisy(Thinned):
    """With the noise of 512 rays once more in the training poses' visibility."""

    def read(self, name: str, index: int | slice | IntArray | None = None) -> Any:
        value = super().read(name, index)
        rows = np.atleast_1d(np.arange(len(self))[slice(None) if index is None else index])
        if name != "visibility" or not np.isin(rows, self.training_poses()).all():
            return value
        noise = np.random.default_rng(int(rows[0])).normal(size=value.shape)
        return value + (NOISE * np.sqrt(np.square(value).mean()) * noise).astype(np.float32)


class ThinnedClips(Thinned):
    """Without sampled poses."""

    def training_poses(self) -> IntArray:
        return np.setdiff1d(super().training_poses(), self.poses_of(SAMPLED))


class Table:
    """Rows, each beside the starting point."""

    def __init__(self) -> None:
        self.rows: list[list[str]] = []
        self.start: float | None = None

    def add(self, name: str, data: Dataset, config: TrainConfig, start: bool = False) -> None:
        """Train and judge one model."""
        begun = time.perf_counter()
        model = train(data, config)
        taken = time.perf_counter() - begun
        proto = build_onnx(model).SerializeToString()
        predict = OnnxModel(proto, threads=2)
        ms = predict.milliseconds(data.read("pose", slice(1)))
        error = held_out_errors(data, predict, EVERY)
        if start:
            self.start = error["rms"]
        self.row(name, error, f"{len(proto) / 1e6:.2f}", f"{ms:.2f}", taken, start)

    def row(
        self, name: str, error: dict[str, float], size: str, ms: str, taken: float,
        start: bool = False,
    ) -> None:  # fmt: skip
        """Write one row down."""
        assert self.start is not None
        change = "" if start else f"{100 * (error['rms'] - self.start):+.2f}"
        cells = [per_cent(error["rms"]), change, per_cent(error["p99"]), size, ms, f"{taken:.0f}"]
        self.rows.append([name, *cells])
        print(self.rows[-1], flush=True)


DIRECTIONS = sh.fibonacci_sphere(96).astype(np.float64)


def exponential(features: FloatArray) -> FloatArray:
    """1 − exp(−caps) in place of f / (1 + |f|/2): sums of caps as optical depth, group by group.

    After Ren et al. 2006, "Real-time soft shadows in dynamic scenes using spherical harmonic
    exponentiation", exactly: on directions rather than by a series.
    """
    count = 16
    rows = sh.evaluate(DIRECTIONS, 4).astype(np.float32)  # [D, n²]
    back = np.linalg.pinv(rows.astype(np.float64)).T.astype(np.float32)
    groups = features.reshape(-1, features.shape[-1] // count, count)
    out = np.empty_like(groups)
    for begin in range(0, len(groups), 4096):
        depth = np.maximum(groups[begin : begin + 4096] @ rows.T, 0.0)
        out[begin : begin + 4096] = (1.0 - np.exp(-depth)) @ back
    return out.reshape(features.shape)


def exponential_row(table: Table, data: Dataset) -> None:
    """The map around receivers with the exponential: NumPy alone, no graph."""
    begun = time.perf_counter()
    with (
        mock.patch.object(prior, "saturated", exponential),
        mock.patch.object(ridge_maps, "saturated", exponential),
    ):
        error = held_out_errors(data, train(data, AROUND), EVERY)
    taken = time.perf_counter() - begun
    table.row("exponential in place of saturated sums", error, "–", "–", taken)


def main() -> None:
    """Both starting points and their levers."""
    torch.set_num_threads(2)
    path = dataset("human", "human.glb", HUMAN).path
    data, clips = Thinned.open(path), ThinnedClips.open(path)
    table = Table()
    table.add("**a network a cluster**", data, NEURAL, start=True)
    table.add("no sampled poses", clips, NEURAL)
    table.add("targets twice as noisy: no weighing of noise brings more", Noisy.open(path), NEURAL)
    for name, options in NEURAL_LEVERS:
        table.add(name, data, dataclasses.replace(NEURAL, **options))
    if "neural" in sys.argv:
        print(markdown(COLUMNS, table.rows))
        return
    table.add("**a map around every receiver**", data, AROUND, start=True)
    table.add("no sampled poses", clips, AROUND)
    for name, options in AROUND_LEVERS:
        table.add(name, data, dataclasses.replace(AROUND, **options))
    exponential_row(table, data)
    publish("ablation", COLUMNS, table.rows, note="Change: in points of held-out error.")


if __name__ == "__main__":
    main()
