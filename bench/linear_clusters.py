"""Is there anything in clusters of one model choosing between a line and a network?

python bench/linear_clusters.py [robot|human] [--write]

A search lets every cluster choose between two numbers of neurons. Here a line is one more choice,
or there are more numbers; how many bytes models need for the same expected error says what that
brings. Bytes are those that the search counts, beside what a model of means alone has.
"""

from __future__ import annotations

import dataclasses
import sys
from dataclasses import dataclass

import numpy as np
import torch
from ablation import Thinned
from tables import HUMAN, ROBOT, dataset, per_cent, publish

from prtnet.arrays import FloatArray
from prtnet.dataset import Dataset, evenly, sampled_clip
from training.config import PRESETS, TrainConfig
from training.families import (
    FAMILIES,
    FOLD_ITERATIONS,
    ROUNDED,
    Parts,
    base_step,
    priced,
    ranged,
    rich_config,
    rounded_off,
    some_poses,
)
from training.monitor import Silent
from training.onnx_export import build_onnx
from training.selection import folds_over_moments
from training.train import prepared
from training.worth import (
    COLUMN,
    SCALE,
    Allocation,
    Prices,
    Unseen,
    allocated,
    allocations,
    expected,
    unseen,
)

SCENES = {
    "robot": ("robot.glb", ROBOT, 16, 0.053, 0.0025),
    "human": ("human.glb", HUMAN, 64, 0.041, 0.0018),
}
"""Scene, dataset, clusters, and the weight decay of lines and of networks that models.py found."""
SHARES = (0.125, 0.25, 0.5, 1.0)
LINE = 0  # where the line stands among the choices; numbers of neurons follow
CHOICES = {
    "a line": (LINE,),
    "two numbers of neurons, as in a search": (2, 4),
    "those or a line": (LINE, 2, 4),
    "four numbers of neurons": (1, 2, 3, 4),
    "four or a line": (LINE, 1, 2, 3, 4),
}
TARGETS = 4
COLUMNS = ("scene, kind, expected error", "regressors", *(f"MB: {name}" for name in CHOICES),
           "clusters with a line")  # fmt: skip


@dataclass(frozen=True)
class Judged:
    """A line and networks, fitted and judged together.

    Attributes:
        known: what their parts leave of the error.
        prices: of those parts; ``inner`` is an array here, since a line has no layer inside.
        latents: components that each group has at most, (G,).
        step: groups have multiples of so many.
        rounding: relative squared error of storing all but the components in 8 bits.
        fixed: bytes of a model of means alone.
    """

    known: Unseen
    prices: Prices
    latents: FloatArray
    step: int
    rounding: float
    fixed: int

    def path(self, which: tuple[int, ...]) -> list[tuple[float, float, Allocation]]:
        """Bytes, expected error and what is kept, of the best model of every size."""
        own = list(which)
        known = Unseen(self.known.energy, self.known.left[:, own], self.known.latent[:, own])
        prices = dataclasses.replace(
            self.prices, widths=self.prices.widths[own], inner=self.prices.inner[own]
        )
        found = []
        for size in allocations(known, prices, self.latents, self.step):
            exact = float(np.median(expected(known, prices, size)))
            error = float(np.hypot(exact, np.sqrt(self.rounding)))
            found.append((self.fixed + bytes_of(prices, size), error, size))
        return found


def bytes_of(prices: Prices, size: Allocation, regressors_alone: bool = False) -> float:
    """What a search counts for an allocation beside its means."""
    number = np.maximum(size.neurons, 0)
    width = np.repeat(prices.widths[number], prices.parts)
    total = float((size.counts * (COLUMN + width)).sum())
    alive = size.neurons >= 0
    total += float(((prices.inputs + (prices.inner * prices.widths)[number]) * alive).sum())
    if regressors_alone:
        return total
    kept = np.arange(size.bits.shape[1]) < size.counts[:, None]
    each = prices.slots * size.orders[:, None] ** 2 * size.bits / 8.0 + SCALE
    return total + float((each * kept).sum())


def judged(data: Dataset, config: TrainConfig, decay: float, alpha: float) -> Judged:
    """A line and four numbers of neurons on every fold, of these weight decays."""
    rows = data.training_poses()
    folds = folds_over_moments(
        data.clip[rows], data.read("time", rows), sampled_clip(data.clip_names)
    )
    parts = Parts(data, rows, folds)
    line = dataclasses.replace(config, kind="linear")
    whole = parts.fitting(config, None, None)
    straight = prepared(data, rows, line, Silent(), whole.outputs)
    numbers = [max(1, round(share * config.neurons)) for share in SHARES]
    models = ranged(straight, [1], decay) + ranged(whole, numbers, alpha)
    hasty = dataclasses.replace(config, iterations=FOLD_ITERATIONS)
    sets = []
    for fold in folds:
        share = float(fold.train.mean())
        part = parts.fitting(hasty, fold, whole.outputs)
        own = prepared(data, rows[fold.train], line, Silent(), part.outputs)
        rivals = ranged(own, [1], decay / share) + ranged(part, numbers, alpha / share)
        left_out = rows[fold.validate]
        clip = data.clip[left_out]
        sets += [unseen(rivals, some_poses(data, left_out[clip == c])) for c in np.unique(clip)]
        print(f"  fold of {len(left_out)} poses", flush=True)
    body = models[-1]
    known = Unseen.joined(sets, int(body.latents.max(initial=0)))
    prices = priced(models[1:])
    inputs = body.input_basis.shape[2]
    prices = dataclasses.replace(
        prices,
        widths=np.array([inputs, *prices.widths]),
        inner=np.array([0, *[prices.inner] * len(numbers)]),
    )
    poses = data.read("pose", evenly(rows, ROUNDED))
    size = allocations(known, prices, body.latents, base_step(config))[0]
    fixed = len(build_onnx(allocated(models[1:], size)).SerializeToString())
    rounding = rounded_off(body, poses)
    return Judged(known, prices, body.latents, base_step(config), rounding, fixed)


def megabytes(path: list[tuple[float, float, Allocation]], target: float) -> float:
    """Of the smallest model that errs no more, between the sizes there are; NaN where none does."""
    size, error = np.array([p[0] for p in path]), np.array([p[1] for p in path])
    least = np.minimum.accumulate(error)  # of all that are no larger
    if least[-1] > target:
        return np.nan
    return float(np.interp(-target, -least, size)) / 1e6


def rows_of(name: str) -> list[list[str]]:
    """Targets spread over what is feasible, and the megabytes that each set of choices needs."""
    scene, how, clusters, *decays = SCENES[name]
    data = dataset(name, scene, how)
    if name == "human":
        data = Thinned.open(data.path)
    base = dataclasses.replace(PRESETS["default"], clusters=clusters)
    rows = []
    for family in ("neural, small", "neural"):
        print(f"{name}, {family}", flush=True)
        found = judged(data, rich_config(data, base, FAMILIES[family]), *decays)
        paths = {choice: found.path(which) for choice, which in CHOICES.items()}
        usual = paths["two numbers of neurons, as in a search"]
        least, most = min(p[1] for p in usual), usual[0][1]
        mixed = paths["those or a line"]
        for target in np.geomspace(1.03 * least, 0.9 * most, TARGETS):
            _, _, size = next(p for p in mixed if p[1] <= target)
            prices = dataclasses.replace(
                found.prices,
                widths=found.prices.widths[[LINE, 2, 4]],
                inner=found.prices.inner[[LINE, 2, 4]],
            )
            whole = found.fixed + bytes_of(prices, size)
            share = bytes_of(prices, size, regressors_alone=True) / whole
            alive = int((size.neurons >= 0).sum())
            sizes = [megabytes(path, float(target)) for path in paths.values()]
            usual_size = sizes[1]
            rows.append(
                [
                    f"{name}, {family}, {per_cent(target)}",
                    f"{100 * share:.0f} %",
                    *(
                        "–" if np.isnan(mb) else f"{mb:.3f} ({100 * (mb / usual_size - 1):+.1f} %)"
                        for mb in sizes
                    ),
                    f"{int((size.neurons == LINE).sum())} of {alive}",
                ]
            )
            print(rows[-1], flush=True)
    return rows


if __name__ == "__main__":
    torch.set_num_threads(2)
    chosen = [name for name in SCENES if name in sys.argv] or list(SCENES)
    publish("linear clusters", COLUMNS, [row for name in chosen for row in rows_of(name)])
