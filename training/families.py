"""Kinds of models, each fitted and judged on what it has not seen: what a search chooses from.

Every kind is fitted once with more components than any budget keeps, and once without each fold: a
quarter of every training clip in turn; each time with several numbers of neurons. What neurons,
components, bands and bits bring on what a fold left out tells which of them are worth their bytes
(:mod:`training.worth`), and what error to expect: that of the median part left out.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.components import coding
from prtnet.dataset import Dataset, evenly
from prtnet.model import VisibilityModel
from training.config import TrainConfig
from training.monitor import Monitor, Silent
from training.outputs import AROUND, Outputs, reduced_outputs
from training.selection import Fold
from training.train import NEURAL, Fitting, prepared, select, with_training_range
from training.worth import (
    Allocation,
    Prices,
    Unseen,
    allocated,
    allocations,
    expected,
    unseen,
)

__all__ = ["FAMILIES", "QUICK", "Candidate", "Parts", "judged", "rich_config"]

SMALL = {"kind": "neural", "neurons": 16, "points": 3, "near": 24, "spheres": 64}
FAMILIES: dict[str, dict[str, Any]] = {
    "linear": {"kind": "linear"},
    "neural, small": SMALL,
    "neural": {"kind": "neural"},
    "neural, large": {
        "kind": "neural", "neurons": 64, "inputs": 64, "points": 12, "near": 96, "spheres": 240,
    },
    "neural, quick": {**SMALL, "parts": 1},
    "neural, quick, half the clusters": {**SMALL, "parts": 1, "share": 1 / 2},
    "hybrid": {"kind": "hybrid"},
    "shared": {"kind": "shared"},
}  # fmt: skip
"""Kinds of models: what each overrides in the configuration; ``share`` is of the clusters.

Those that look around every receiver come last: a search tries them where no other will do.
Quadratic ones are not among them: at every size another kind errs less (robot: as linear ones,
for more bytes).
"""
QUICK = tuple(name for name in FAMILIES if name.startswith("neural, quick"))
"""Fewer groups and clusters are faster, and larger: only where milliseconds are what limits.

A quarter of the clusters is slower for the same error (human), since those left out cost nothing.
"""
RICH = 24  # components a group, on average, before the search drops what is not worth it
RICH_AROUND = 16  # beside a prior, where less is left
PARTS = 8  # groups a cluster: each keeps what it is worth
FEWEST = 16  # receivers of a group
NEURON_PARTS = (0.25, 1.0)  # of a kind's neurons: what a cluster chooses from
BIAS = 12  # bytes of a neuron beside its weights: bias, scale, where it stands
JUDGED = 40  # poses of each part that judge, at most
FOLD_ITERATIONS = 80  # of a fold's fits: they are compared, they need not converge
FOLDS_AROUND = 2  # priors take minutes to fit
ROUNDED = 8  # poses that tell what storing costs
BLOCK = 8
OF_OUTPUTS = (
    "clusters", "clustering", "seed", "parts", "latents", "output_variance", "step", "frame",
    "target",
)  # fmt: skip
"""Options that say what there is to predict of poses, without a prior."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One kind of model, fitted and judged.

    Attributes:
        family: its name.
        models: fitted to all training poses with more components than any will keep, of every
            number of neurons.
        known: what their parts leave of the error on each part of a clip left out.
        prices: of those parts.
        sizes: the best model of each size, the smallest first.
        rounding: relative squared error of storing all but the components in 8 bits.
    """

    family: str
    models: list[VisibilityModel]
    known: Unseen
    prices: Prices
    sizes: list[Allocation]
    rounding: float

    @functools.cached_property
    def errors(self) -> FloatArray:
        """Expected relative RMS of each size: on the median of the parts left out."""
        exact = [np.median(expected(self.known, self.prices, size)) for size in self.sizes]
        return np.hypot(exact, np.sqrt(self.rounding))

    def cut(self, size: int) -> VisibilityModel:
        """The model of one of the sizes."""
        return allocated(self.models, self.sizes[size])


def rich_config(dataset: Dataset, base: TrainConfig, options: dict[str, Any]) -> TrainConfig:
    """A family's configuration, with more components than it will keep."""
    receivers = len(dataset.rest_tangents)
    options = dict(options)
    share = options.pop("share", 1.0)
    clusters = max(1, round(share * min(base.clusters, receivers // FEWEST)))
    parts = int(np.clip(receivers // clusters // FEWEST, 1, PARTS))
    parts = 1 if options["kind"] in AROUND else options.get("parts", parts)
    latents = parts * (RICH_AROUND if options["kind"] in AROUND else RICH)
    settled = {
        "clusters": clusters, "parts": parts, "latents": latents, "output_variance": 1.0,
        "step": 1, "storage": "float32", "frame": "local", "target": "visibility",
    }  # fmt: skip
    return dataclasses.replace(base, **{**settled, **options})


class Parts:
    """Training poses, all of them and without each fold.

    What there is to predict of them is reduced once for all kinds without a prior.

    Args:
        dataset: of the poses.
        rows: the training poses, (P,).
        folds: of those.
    """

    def __init__(self, dataset: Dataset, rows: IntArray, folds: list[Fold]) -> None:
        self.dataset, self.rows, self.folds = dataset, rows, folds
        self.known: dict[tuple[Any, ...], Outputs] = {}

    def left(self, fold: Fold | None) -> IntArray:
        """The poses without a fold, or all."""
        return self.rows if fold is None else self.rows[fold.train]

    def fitting(self, config: TrainConfig, fold: Fold | None, whole: Outputs | None) -> Fitting:
        """A kind's models but for their regressors, of what a fold leaves, grouped as the whole."""
        key = (fold, *(getattr(config, name) for name in OF_OUTPUTS))
        outputs = None if config.kind in AROUND else self.known.get(key)
        if outputs is None:
            layout = None if whole is None else whole.layout
            rows = self.left(fold)
            outputs = reduced_outputs(self.dataset, rows, config, Silent(), layout)
            if config.kind not in AROUND:
                self.known[key] = outputs
        return prepared(self.dataset, self.left(fold), config, Silent(), outputs)


def judged(parts: Parts, family: str, config: TrainConfig, watch: Monitor) -> Candidate:
    """One kind of model, fitted to everything and to each fold."""
    watch.stage(f"{family}: all training clips")
    dataset, rows = parts.dataset, parts.rows
    whole = parts.fitting(config, None, None)
    neurons, alpha, trials = select(whole.data, config, parts.folds, Silent())
    numbers = sorted({max(1, round(part * neurons)) for part in NEURON_PARTS})
    if config.kind not in NEURAL:
        numbers = [neurons]
    models = ranged(whole, numbers, alpha)
    hasty = dataclasses.replace(config, iterations=min(config.iterations, FOLD_ITERATIONS))
    sets = []
    used = parts.folds[:FOLDS_AROUND] if config.kind in AROUND else parts.folds
    for turn, fold in enumerate(used, start=1):
        watch.stage(f"{family}: fold {turn} of {len(used)}")
        part = parts.fitting(hasty, fold, whole.outputs)
        # As strong against fewer poses as against all: see ``selection.refined``.
        rivals = ranged(part, numbers, alpha / float(fold.train.mean()))
        left_out = rows[fold.validate]
        clip = dataset.clip[left_out]
        sets += [
            unseen(rivals, some_poses(dataset, left_out[clip == own])) for own in np.unique(clip)
        ]
    for model in models:
        model.metadata["cross_validation"] = trials
    body = models[0]
    known = Unseen.joined(sets, int(body.latents.max(initial=0)))
    prices = priced(models)
    sizes = allocations(known, prices, body.latents, base_step(config))
    poses = dataset.read("pose", evenly(rows, ROUNDED))
    rounding = rounded_off(models[-1], poses)
    candidate = Candidate(family, models, known, prices, sizes, rounding)
    for number, error in enumerate(candidate.errors):
        watch.scalar(f"search/{family}", float(error), number)
    return candidate


def ranged(fitting: Fitting, numbers: list[int], alpha: float) -> list[VisibilityModel]:
    """Models of each number of neurons, that clamp to the training range."""
    models = (fitting.model(number, alpha, Silent()) for number in numbers)
    return [with_training_range(model, fitting.features) for model in models]


def rounded_off(model: VisibilityModel, poses: FloatArray) -> float:
    """Relative squared error of storing all but the components in 8 bits, on poses (P, D)."""
    answer = model(poses)
    energy = float(np.mean(answer**2))
    if energy == 0.0:  # always dark: nothing to be off
        return 0.0
    stored = dataclasses.replace(model.stored_as("int8"), basis=model.basis)
    return float(np.mean((stored(poses) - answer) ** 2)) / energy


def priced(models: list[VisibilityModel]) -> Prices:
    """What parts of models of one kind cost, in 8 bits where nothing else is said."""
    body = models[0]
    most = int(body.latents.max(initial=0))
    used = np.arange(most) < body.latents[:, None]
    rounding = np.zeros((2, len(body.latents), most))
    for row, bits in enumerate((4, 8)):
        how = coding(body.basis, body.order**2, np.full(len(body.basis), bits))
        difference = how.encode(body.basis).array() - body.basis
        rounding[row][used] = np.square(difference, dtype=np.float64).sum(axis=1)
    features, inputs = body.input_basis.shape[1:]
    clusters = len(body.latents) // body.parts
    layered = body.regressor.hidden_weight is not None
    return Prices(
        slots=body.receivers.shape[1],
        parts=body.parts,
        widths=np.array([model.regressor.weight.shape[1] for model in models]),
        inputs=features * inputs if len(body.input_basis) == clusters else 0,
        inner=inputs + BIAS if layered else 0,
        rounding=rounding,
    )


def base_step(config: TrainConfig) -> int:
    """Groups keep multiples of so many components: few different sizes are fast."""
    return 2 if config.parts > 1 else 4


def some_poses(dataset: Dataset, rows: IntArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Evenly chosen poses with their visibility, block by block."""
    chosen = evenly(rows, JUDGED)
    for start in range(0, len(chosen), BLOCK):
        block = chosen[start : start + BLOCK]
        yield dataset.read("pose", block), dataset.read("visibility", block)
