"""The cheapest model that meets its limits: only what the scene needs.

Every kind of model is judged at all its sizes on parts of the training clips that it has not seen
(:mod:`training.families`); of those that meet the limits the cheapest is taken. Held-out clips are
never looked at.

The expected error is of parts of clips that the model knows the rest of: new clips of the same kind
come near it, others may not. Kinds that look around every receiver are judged by half of the parts.
"""

from __future__ import annotations

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from prtnet.cores import divided, thread_count
from prtnet.dataset import Dataset, sampled_clip
from prtnet.errors import PrtnetError
from prtnet.model import VisibilityModel
from training.budget import Budget
from training.config import TrainConfig
from training.families import FAMILIES, QUICK, Candidate, Parts, judged, rich_config
from training.monitor import Monitor, Silent
from training.onnx_export import build_onnx
from training.outputs import AROUND
from training.selection import folds_over_moments
from training.train import (
    fit_model,
    report_convergence,
    report_errors,
    training_rows,
    with_training_range,
)

__all__ = ["Candidates", "Choice", "best", "compare", "feasible", "found", "kept", "search"]

CHOSEN = (
    "kind", "parts", "latents", "step", "output_variance", "storage", "frame", "target",
)  # fmt: skip
"""Options that a search settles itself."""
ANY_SIZE = 1e6  # megabytes
SENSIBLE = 1.1  # times the least error: from there on bytes buy little
FEW = 8  # training poses that are enough to build a graph of


@dataclass(frozen=True)
class Choice:
    """One candidate at its best size.

    Attributes:
        family: its name.
        size: which of the candidate's sizes.
        error: expected on clips not seen, relative RMS.
        model_bytes: of its graph.
        ms: a pose; None where nobody asked.
        meets: whether it keeps to all limits.
    """

    family: str
    size: int
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
        kinds: names of those to choose from, of ``FAMILIES``; all when not given.

    Raises:
        PrtnetError: the training clips cannot judge models.
    """

    def __init__(
        self,
        dataset: Dataset,
        base: TrainConfig,
        monitor: Monitor | None = None,
        kinds: Sequence[str] | None = None,
    ) -> None:
        self.dataset, self.base, self.watch = dataset, base, monitor or Silent()
        self.kinds = {name: FAMILIES[name] for name in (FAMILIES if kinds is None else kinds)}
        self.rows = training_rows(dataset)
        folds = folds_over_moments(
            dataset.clip[self.rows],
            dataset.read("time", self.rows),
            sampled_clip(dataset.clip_names),
        )
        if len(folds) < 2:
            raise PrtnetError(
                dataset.path, "has too few training poses to judge models by; generate more, or "
                "train without --max-error, --max-ms and --max-mb"
            )  # fmt: skip
        self.parts = Parts(dataset, self.rows, folds)
        self.fitted: dict[str, Candidate] = {}
        self.alphas: dict[str, float] = {}

    def __getitem__(self, family: str) -> Candidate:
        """One of the kinds."""
        if family not in self.fitted:
            config = rich_config(self.dataset, self.base, self.kinds[family])
            if config.alpha is None:  # chosen once for each kind
                config = dataclasses.replace(config, alpha=self.alphas.get(config.kind))
            self.fitted[family] = judged(self.parts, family, config, self.watch)
            self.alphas[config.kind] = self.fitted[family].models[0].metadata["alpha"]
        return self.fitted[family]

    def held_back(self, choice: Choice) -> bool:
        """Whether a limit keeps it from the size of the least error."""
        return choice.size < int(np.argmin(self[choice.family].errors))

    def worth_few_groups(self, choices: list[Choice], budget: Budget) -> bool:
        """Whether to try kinds that buy milliseconds with megabytes.

        Not where smaller ones meet a limit on the error, or none is held back.
        """
        if budget.max_ms is None:
            return False
        usual = [choice for choice in choices if choice.family not in QUICK]
        if budget.max_error is not None:
            return not any(choice.meets for choice in usual)
        return any(self.held_back(choice) for choice in usual)

    def worth_a_prior(
        self, family: str, choices: list[Choice], budget: Budget,
        milliseconds: Callable[[bytes], float],
    ) -> bool:  # fmt: skip
        """Whether to try a kind that looks around every receiver.

        They are small but take many times the milliseconds, and minutes to fit: not where a limit
        on the error is met already, nor where looking around alone takes too long.
        """
        if budget.max_error is not None and any(choice.meets for choice in choices):
            return False
        if budget.max_ms is None:
            return True
        self.watch.stage(f"{family}: milliseconds")
        config = rich_config(self.dataset, self.base, self.kinds[family])
        hasty = dataclasses.replace(config, latents=0, steps=1, samples=1, alpha=1.0)
        model = fit_model(self.dataset, self.rows[:FEW], hasty, [], Silent())
        return milliseconds(build_onnx(model).SerializeToString()) <= budget.max_ms

    def finished(self, choice: Choice) -> VisibilityModel:
        """The model of a choice, without its errors."""
        model = self[choice.family].cut(choice.size)
        config = {**model.metadata["config"], "storage": model.storage}
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
        budget: the limits; where there are none, a little more than the least error of quick kinds.
        milliseconds: a pose takes in a graph, given as bytes.
        monitor: is told how it goes.

    Returns:
        The model; ``search`` in its metadata tells what was compared.

    Raises:
        PrtnetError: no model meets the limits, the training clips cannot judge models, or ``base``
            asks for what the search chooses.
    """
    started = time.perf_counter()
    if base.kind == "auto":
        base = dataclasses.replace(base, kind=TrainConfig().kind)
    for name in CHOSEN:
        if getattr(base, name) != getattr(TrainConfig(), name):
            option = f"--{name.replace('_', '-')}"
            searches = "--kind auto, --max-error, --max-ms and --max-mb"
            raise PrtnetError(option, f"is chosen by {searches}; leave it, or its preset, out")
    candidates = Candidates(dataset, base, monitor)
    with divided(thread_count()):
        model = found(candidates, budget or sensible(candidates), milliseconds)
    model.metadata["seconds"]["total"] = time.perf_counter() - started
    return model


def found(
    candidates: Candidates, budget: Budget, milliseconds: Callable[[bytes], float]
) -> VisibilityModel:
    """The cheapest of some kinds within a budget, as :func:`search` gives it.

    Raises:
        PrtnetError: no model meets the limits.
    """
    choices = compare(candidates, budget, milliseconds)
    chosen = best(choices, budget)
    model = candidates.finished(chosen)
    report_convergence(model.metadata["fits"], candidates.watch)
    report_errors(model, candidates.dataset, candidates.watch)
    model.metadata["search"] = {
        "budget": dataclasses.asdict(budget),
        "chosen": dataclasses.asdict(chosen),
        "why": reason(chosen, model, budget),
        "compared": [dataclasses.asdict(choice) for choice in choices],
    }
    return model


def sensible(candidates: Candidates) -> Budget:
    """A little more than the least error of the kinds that fit in seconds, or of all for caches.

    Those look at a cache's dihedral angles alone, which tell little of its shadows.
    """
    least, _ = feasible(candidates, around=candidates.dataset.scene_kind == "point_cache")
    if SENSIBLE * least >= 1.0:  # nothing tells anything of these poses
        return Budget(max_mb=ANY_SIZE)
    return Budget(max_error=max(SENSIBLE * least, 1e-6))


def feasible(candidates: Candidates, around: bool = False) -> tuple[float, float]:
    """The least error that kinds without a prior are expected to reach, and that of means alone.

    Args:
        candidates: fits them.
        around: whether to fit kinds with a prior as well, which takes minutes.
    """
    tried = [
        candidates[name].errors
        for name, own in candidates.kinds.items()
        if name not in QUICK and (around or own["kind"] not in AROUND)
    ]
    return min(float(errors.min()) for errors in tried), float(tried[0][0])


def compare(
    candidates: Candidates, budget: Budget, milliseconds: Callable[[bytes], float]
) -> list[Choice]:
    """Every kind worth trying at its best size."""
    choices: list[Choice] = []
    for family, options in candidates.kinds.items():
        if family in QUICK and not candidates.worth_few_groups(choices, budget):
            continue
        if options["kind"] in AROUND and not candidates.worth_a_prior(
            family, choices, budget, milliseconds
        ):
            continue
        candidate = candidates[family]
        candidates.watch.stage(f"{family}: sizes")
        choices.append(sized(candidate, budget, milliseconds))
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


def sized(candidate: Candidate, budget: Budget, milliseconds: Callable[[bytes], float]) -> Choice:
    """The candidate at its best size: the smallest that errs little enough, or the best."""

    @functools.cache  # a time measured twice is two times: what was allowed stays allowed
    def measured(size: int) -> tuple[int, float | None]:
        proto = build_onnx(candidate.cut(size)).SerializeToString()
        return len(proto), None if budget.max_ms is None else milliseconds(proto)

    def allowed(size: int, ms: float | None) -> bool:
        small = budget.max_mb is None or size <= 1e6 * budget.max_mb
        return small and (budget.max_ms is None or ms is None or ms <= budget.max_ms)

    errors = candidate.errors

    def goal(most: int) -> int:
        """The first of small enough error among so many sizes, or the one of least."""
        enough = errors[: most + 1] <= (budget.max_error or 0.0)
        return int(np.argmax(enough) if enough.any() else np.argmin(errors[: most + 1]))

    wanted = goal(len(errors) - 1)
    size, ms = measured(wanted)
    if not allowed(size, ms):
        low, high = 0, wanted  # `high` is too much
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if allowed(*measured(middle)) else (low, middle)
        wanted = goal(low)
        size, ms = measured(wanted)
        if not allowed(size, ms):  # smaller and yet slower: chance; what was allowed is there
            wanted, (size, ms) = low, measured(low)
    error = float(errors[wanted])
    meets = allowed(size, ms) and (budget.max_error is None or error <= budget.max_error)
    return Choice(candidate.family, wanted, error, size, ms, meets)


def reason(choice: Choice, model: VisibilityModel, budget: Budget) -> str:
    """What was chosen and why, in a sentence or two."""
    goal = "the smallest of those that meet" if budget.max_error else "the least error within"
    return (
        f"{choice.family}, {kept(model)}: {goal} {budget.text()}; expected error "
        f"{100 * choice.error:.3g} % by cross-validation, "
        f"{choice.model_bytes / 1e6:.3g} MB of ONNX"
        + ("" if choice.ms is None else f", {choice.ms:.3g} ms")
    )


def kept(model: VisibilityModel) -> str:
    """What a model found consists of, in words."""
    still, groups = int((model.latents == 0).sum()), len(model.latents)
    text = f"{int(model.latents.sum())} components in {groups} groups"
    if still:
        text += f" ({still} keep their mean alone)"
    if model.coding is not None and len(model.coding) > 0:
        text += f", {100 * (model.coding.bits == 4).mean():.0f} % of them in 4 bits"
        short = (model.coding.orders < model.order).mean()
        if short > 0:
            text += f", {100 * short:.0f} % without the last bands"
    if model.neurons is not None:
        numbers = [f"{n} in {int((model.neurons == n).sum())}" for n in np.unique(model.neurons)]
        text += f", neurons {', '.join(numbers)} clusters"
    return text
