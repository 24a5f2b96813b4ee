"""The cheapest model that meets its limits: only what the scene needs.

Every kind of model is fitted once with more components than any budget keeps, and once without
each fold: a quarter of every training clip in turn. What each component brings on what its fold
left out tells which of them are worth their bytes (:mod:`training.worth`), and what error to
expect: that of the median part left out. Held-out clips are never looked at. A group whose
components bring nothing keeps its mean alone.

The expected error is of parts of clips that the model knows the rest of: new clips of the same kind
come near it, others may not. Kinds that look around every receiver are judged by half of the parts.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset, evenly, sampled_clip
from prtnet.errors import PrtnetError
from prtnet.model import VisibilityModel
from prtnet.storage import Storage
from training.budget import Budget
from training.config import TrainConfig
from training.monitor import Monitor, Silent
from training.onnx_export import build_onnx
from training.selection import Fold, folds_over_moments
from training.train import (
    AROUND,
    fit_model,
    report_errors,
    training_rows,
    with_training_range,
)
from training.worth import Front, Marginal, front, marginal, truncated

__all__ = ["FAMILIES", "Candidates", "Choice", "best", "compare", "search"]

FAMILIES: dict[str, dict[str, Any]] = {
    "linear": {"kind": "linear"},
    "neural, small": {"kind": "neural", "neurons": 16, "points": 3, "near": 24, "spheres": 64},
    "neural": {"kind": "neural"},
    "neural, large": {
        "kind": "neural", "neurons": 64, "networks": 2, "inputs": 64,
        "points": 12, "near": 96, "spheres": 240,
    },
    "hybrid": {"kind": "hybrid"},
    "shared": {"kind": "shared"},
}  # fmt: skip
"""Kinds of models, the quick ones first: what each overrides in the configuration."""
RICH = 24  # components a group, on average, before the search drops what is not worth it
RICH_AROUND = 16  # beside a prior, where less is left
PARTS = 8  # groups a cluster: each keeps what it is worth
CHOSEN = (
    "kind", "parts", "latents", "step", "output_variance", "storage", "frame", "target",
)  # fmt: skip
"""Options that a search settles itself."""
FEWEST = 16  # receivers of a group
STORAGES: tuple[Storage, ...] = ("int8", "float16")
JUDGED = 40  # poses of each part that judge, at most
FOLDS_AROUND = 2  # priors take minutes to fit
ROUNDED = 8  # poses that tell what storing costs
BLOCK = 8
RESOLUTION = 64  # sizes that are told apart between nothing and everything


@dataclass(frozen=True, eq=False)
class Candidate:
    """One kind of model, fitted and judged.

    Attributes:
        family: its name.
        model: fitted to all training poses with more components than it will keep.
        marginal: what its components bring on each part of a clip left out.
        order: in which they are worth taking.
        rounding: relative squared error that each storage adds.
    """

    family: str
    model: VisibilityModel
    marginal: Marginal
    order: Front
    rounding: dict[Storage, float]

    def errors(self, storage: Storage) -> FloatArray:
        """Expected relative RMS after 0, 1, … steps: on the median of the parts left out."""
        exact = self.marginal.errors(self.order.brought(self.marginal.gain))
        return np.hypot(np.median(exact, axis=1), np.sqrt(self.rounding[storage]))

    def cut(self, steps: int, storage: Storage) -> VisibilityModel:
        """The model with the components of so many steps."""
        return truncated(self.model, self.order.counts(steps)).stored_as(storage)


@dataclass(frozen=True)
class Choice:
    """One candidate at its best size.

    Attributes:
        family: its name.
        storage: of its large arrays.
        steps: taken on its front.
        error: expected on clips not seen, relative RMS.
        model_bytes: of its graph.
        ms: a pose; None where nobody asked.
        meets: whether it keeps to all limits.
    """

    family: str
    storage: Storage
    steps: int
    error: float
    model_bytes: int
    ms: float | None
    meets: bool

    def excess(self, budget: Budget) -> dict[str, float]:
        """How many times over each limit it is, by the limit's option."""
        limits = {
            "--max-error": (self.error, budget.max_error),
            "--max-ms": (self.ms, budget.max_ms),
            "--max-mb": (self.model_bytes / 1e6, budget.max_mb),
        }
        return {
            option: value / limit
            for option, (value, limit) in limits.items()
            if value is not None and limit is not None
        }


class Candidates:
    """Kinds of models of a dataset, each fitted and judged when it is first asked for.

    Args:
        dataset: from ``prtnet generate``.
        base: options that the search does not choose.
        monitor: is told how it goes.

    Raises:
        PrtnetError: the training clips cannot judge models.
    """

    def __init__(self, dataset: Dataset, base: TrainConfig, monitor: Monitor | None = None) -> None:
        self.dataset, self.base, self.watch = dataset, base, monitor or Silent()
        self.rows = training_rows(dataset)
        self.folds = folds_over_moments(
            dataset.clip[self.rows],
            dataset.read("time", self.rows),
            sampled_clip(dataset.clip_names),
        )
        if len(self.folds) < 2:
            raise PrtnetError(
                dataset.path, "has too few training poses to judge models by; generate more, or "
                "train without --max-error, --max-ms and --max-mb"
            )  # fmt: skip
        self.fitted: dict[str, Candidate] = {}
        self.alphas: dict[str, float] = {}

    def __getitem__(self, family: str) -> Candidate:
        """One of ``FAMILIES``."""
        if family not in self.fitted:
            config = rich_config(self.dataset, self.base, FAMILIES[family])
            if config.alpha is None:  # chosen once for each kind
                config = dataclasses.replace(config, alpha=self.alphas.get(config.kind))
            self.fitted[family] = judged(
                self.dataset, self.rows, self.folds, family, config, self.watch
            )
            self.alphas[config.kind] = self.fitted[family].model.metadata["alpha"]
        return self.fitted[family]

    def finished(self, choice: Choice) -> VisibilityModel:
        """The model of a choice, without its errors."""
        model = self[choice.family].cut(choice.steps, choice.storage)
        config = {**model.metadata["config"], "storage": choice.storage}
        metadata = {**model.metadata, "config": config, "seconds": {**model.metadata["seconds"]}}
        model = dataclasses.replace(model, metadata=metadata)
        # Its range is that of its rounded inputs.
        return with_training_range(model, model.features(self.dataset.read("pose", self.rows)))


def search(
    dataset: Dataset,
    base: TrainConfig,
    budget: Budget,
    milliseconds: Callable[[bytes], float],
    monitor: Monitor | None = None,
) -> VisibilityModel:
    """Train the cheapest model within a budget.

    Args:
        dataset: from ``prtnet generate``.
        base: options that the search does not choose.
        budget: the limits.
        milliseconds: a pose takes in a graph, given as bytes.
        monitor: is told how it goes.

    Returns:
        The model; ``search`` in its metadata tells what was compared.

    Raises:
        PrtnetError: no model meets the limits, the training clips cannot judge models, or ``base``
            asks for what the search chooses.
    """
    started = time.perf_counter()
    for name in CHOSEN:
        if getattr(base, name) != getattr(TrainConfig(), name):
            option = f"--{name.replace('_', '-')}"
            limits = "--max-error, --max-ms or --max-mb"
            raise PrtnetError(option, f"is chosen by {limits}; leave it, or its preset, out")
    candidates = Candidates(dataset, base, monitor)
    choices = compare(candidates, budget, milliseconds)
    chosen = best(choices, budget)
    model = candidates.finished(chosen)
    report_errors(model, dataset, candidates.watch)
    model.metadata["seconds"]["total"] = time.perf_counter() - started
    model.metadata["search"] = {
        "budget": dataclasses.asdict(budget),
        "chosen": dataclasses.asdict(chosen),
        "why": reason(chosen, model, budget),
        "compared": [dataclasses.asdict(choice) for choice in choices],
    }
    return model


def compare(
    candidates: Candidates, budget: Budget, milliseconds: Callable[[bytes], float]
) -> list[Choice]:
    """Every kind worth trying at its best size, in every storage."""
    choices: list[Choice] = []
    for family, options in FAMILIES.items():
        if options["kind"] in AROUND and not worth_a_prior(choices, budget):
            continue
        candidate = candidates[family]
        candidates.watch.stage(f"{family}: sizes")
        choices += [sized(candidate, storage, budget, milliseconds) for storage in STORAGES]
    return choices


def best(choices: list[Choice], budget: Budget) -> Choice:
    """Of those that meet the limits the smallest, where the error is limited, or the most exact.

    Raises:
        PrtnetError: none meets them.
    """
    key = "error" if budget.max_error is None else "model_bytes"
    meeting = [choice for choice in choices if choice.meets]
    if meeting:
        return min(meeting, key=lambda choice: float(getattr(choice, key)))
    chosen = min(choices, key=lambda choice: max(choice.excess(budget).values()))
    near = f"{100 * chosen.error:.3g} % in {chosen.model_bytes / 1e6:.3g} MB"
    if chosen.ms is not None:
        near += f" and {chosen.ms:.3g} ms"
    excess = chosen.excess(budget)
    raise PrtnetError(
        max(excess, key=lambda option: excess[option]),
        f"no model is expected to meet {budget.text()}; the nearest, {chosen.family}, has "
        f"{near}; allow more, or generate more poses"
    )  # fmt: skip


def worth_a_prior(choices: list[Choice], budget: Budget) -> bool:
    """Whether to try kinds that look around every receiver.

    They are small but take many times the milliseconds, and minutes to fit: not where a limit on
    the error is met already, nor where the quickest kind's time is near the limit.
    """
    if budget.max_error is not None and any(choice.meets for choice in choices):
        return False
    quickest = min(choice.ms for choice in choices if choice.ms is not None) if budget.max_ms else 0
    return budget.max_ms is None or budget.max_ms > 10 * quickest


def rich_config(dataset: Dataset, base: TrainConfig, options: dict[str, Any]) -> TrainConfig:
    """A family's configuration, with more components than it will keep."""
    receivers = len(dataset.rest_tangents)
    clusters = max(1, min(base.clusters, receivers // FEWEST))
    parts = 1 if options["kind"] in AROUND else int(
        np.clip(receivers // clusters // FEWEST, 1, PARTS)
    )  # fmt: skip
    latents = parts * (RICH_AROUND if options["kind"] in AROUND else RICH)
    settled = {
        "clusters": clusters, "parts": parts, "latents": latents, "output_variance": 1.0,
        "step": 1, "storage": "float32", "frame": "local", "target": "visibility",
    }  # fmt: skip
    return dataclasses.replace(base, **{**settled, **options})


def judged(
    dataset: Dataset,
    rows: IntArray,
    folds: list[Fold],
    family: str,
    config: TrainConfig,
    watch: Monitor,
) -> Candidate:
    """One kind of model, fitted to everything and to each fold."""
    watch.stage(f"{family}: all training clips")
    model, layout = fit_model(dataset, rows, config, folds, Silent())
    hidden = model.regressor.hidden_bias
    neurons = config.neurons if hidden is None else hidden.shape[1] // config.networks
    fixed = dataclasses.replace(config, alpha=model.metadata["alpha"], neurons=neurons)
    parts = []
    used = folds[:FOLDS_AROUND] if config.kind in AROUND else folds
    for number, fold in enumerate(used, start=1):
        watch.stage(f"{family}: fold {number} of {len(used)}")
        part, _ = fit_model(dataset, rows[fold.train], fixed, [], Silent(), layout)
        left_out = rows[fold.validate]
        clip = dataset.clip[left_out]
        parts += [
            marginal(part, some_poses(dataset, left_out[clip == own])) for own in np.unique(clip)
        ]
    total = Marginal.joined(parts, int(model.latents.max(initial=0)))
    order = front(total.votes(), model.latents, base_step(config))
    poses = dataset.read("pose", rows[:: max(1, len(rows) // ROUNDED)][:ROUNDED])
    answer = model(poses)
    rounding = {
        storage: float(np.mean((model.stored_as(storage)(poses) - answer) ** 2))
        / max(float(np.mean(answer**2)), 1e-30)
        for storage in STORAGES
    }
    return Candidate(family, model, total, order, rounding)


def base_step(config: TrainConfig) -> int:
    """Groups keep multiples of so many components: few different sizes are fast."""
    return 2 if config.parts > 1 else 4


def some_poses(dataset: Dataset, rows: IntArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Evenly chosen poses with their visibility, block by block."""
    chosen = evenly(rows, JUDGED)
    for start in range(0, len(chosen), BLOCK):
        block = chosen[start : start + BLOCK]
        yield dataset.read("pose", block), dataset.read("visibility", block)


def sized(
    candidate: Candidate, storage: Storage, budget: Budget, milliseconds: Callable[[bytes], float]
) -> Choice:
    """The candidate at its best size: the smallest that errs little enough, or the best."""

    @functools.cache  # a time measured twice is two times: what was allowed stays allowed
    def measured(steps: int) -> tuple[int, float | None]:
        proto = build_onnx(candidate.cut(steps, storage)).SerializeToString()
        return len(proto), None if budget.max_ms is None else milliseconds(proto)

    def allowed(size: int, ms: float | None) -> bool:
        small = budget.max_mb is None or size <= 1e6 * budget.max_mb
        return small and (budget.max_ms is None or ms is None or ms <= budget.max_ms)

    errors = candidate.errors(storage)

    def goal(most: int) -> int:
        """The first of small enough error among so many steps, or the one of least."""
        enough = errors[: most + 1] <= (budget.max_error or 0.0)
        return int(np.argmax(enough) if enough.any() else np.argmin(errors[: most + 1]))

    wanted = goal(len(candidate.order))
    size, ms = measured(wanted)
    if not allowed(size, ms):
        low, high = 0, wanted  # `high` is too much
        while high - low > max(1, len(candidate.order) // RESOLUTION):
            middle = (low + high) // 2
            low, high = (middle, high) if allowed(*measured(middle)) else (low, middle)
        wanted = goal(low)
        size, ms = measured(wanted)
        if not allowed(size, ms):  # smaller and yet slower: chance; what was allowed is there
            wanted, (size, ms) = low, measured(low)
    error = float(errors[wanted])
    meets = allowed(size, ms) and (budget.max_error is None or error <= budget.max_error)
    return Choice(candidate.family, storage, wanted, error, size, ms, meets)


def reason(choice: Choice, model: VisibilityModel, budget: Budget) -> str:
    """What was chosen and why, in a sentence."""
    still = int((model.latents == 0).sum())
    groups = len(model.latents)
    kept = f"{int(model.latents.sum())} components in {groups} groups"
    if still:
        kept += f", of which {still} keep their mean alone"
    goal = "the smallest of those that meet" if budget.max_error else "the least error within"
    return (
        f"{choice.family} in {choice.storage}, {kept}: {goal} {budget.text()}; expected error "
        f"{100 * choice.error:.3g} % by cross-validation, "
        f"{choice.model_bytes / 1e6:.3g} MB of ONNX"
        + ("" if choice.ms is None else f", {choice.ms:.3g} ms")
    )
