"""Which models a report compares: families of models, each in several sizes.

Some are fitted, some are those once more in fewer bytes, some a search finds.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np

from prtnet.dataset import Dataset
from prtnet.model import VisibilityModel
from prtnet.storage import Storage
from training.budget import Budget
from training.config import PRESETS, TrainConfig
from training.search import Candidates, feasible, found
from training.train import train, training_rows, with_training_range

__all__ = [
    "FAMILIES",
    "SEARCHED",
    "SIZES",
    "Candidate",
    "Family",
    "candidates",
    "fitted",
    "rounded",
    "searched",
]

FEWEST_RECEIVERS = 100  # a cluster: small meshes get fewer clusters
BITS: dict[Storage, str] = {"int8": "8 bits", "int4": "4 bits"}
SEARCHED = 3  # models that are searched for
SEARCH_KINDS = ("linear", "neural, small", "neural")  # what fits in seconds
STRICT, LOOSE = 1.05, 0.8  # limits on the error, of the least expected and of that of the mean


@dataclass(frozen=True)
class Family:
    """Models that differ in size alone.

    Attributes:
        name: what readers call it; "joint angles" in it becomes "dihedral angles" for caches.
        options: fields of the configuration that make the family.
        needs_skin: whether a point cache cannot have it.
        around: whether its models look around every receiver: they take minutes to fit.
        storages: in which fewer bytes its models are shown as well.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    needs_skin: bool = False
    around: bool = False
    storages: tuple[Storage, ...] = ()

    @property
    def sizes(self) -> dict[str, TrainConfig]:
        """The family's sizes, the smallest first."""
        return AROUND_SIZES if self.around else SIZES


@dataclass(frozen=True)
class Candidate:
    """One model to fit.

    Attributes:
        name: family and size.
        family: the family's name.
        config: how to fit it.
        source: the name of the model that this one is in fewer bytes; None for one to fit.
    """

    name: str
    family: str
    config: TrainConfig
    source: str | None = None

    def with_alpha(self, alpha: float) -> Candidate:
        """The same with a weight decay that is known already."""
        return dataclasses.replace(self, config=dataclasses.replace(self.config, alpha=alpha))


FAMILIES = (
    Family("linear, joint angles", {"kind": "linear", "features": "joint_angles"}),
    Family("quadratic, joint angles", {"kind": "quadratic", "features": "joint_angles"}),
    Family("neural, joint angles", {"kind": "neural", "features": "joint_angles"}),
    Family("linear, occluders", {"kind": "linear", "features": "occluders"}, needs_skin=True),
    Family("quadratic, occluders", {"kind": "quadratic", "features": "occluders"}, needs_skin=True),
    Family(
        "neural, occluders", {"kind": "neural", "features": "occluders"}, needs_skin=True,
        storages=("int8", "int4"),
    ),
    Family("hybrid", {"kind": "hybrid"}, around=True),
    Family("shared", {"kind": "shared"}, around=True, storages=("int4",)),
)  # fmt: skip
SIZES = {
    "small": PRESETS["small"],
    "medium": PRESETS["default"],
    "large": dataclasses.replace(PRESETS["default"], latents=24),
}
SEARCH_BASE = PRESETS["default"]
AROUND_SIZES = {
    "small": dataclasses.replace(PRESETS["default"], latents=0),
    "medium": PRESETS["default"],
}


def candidates(
    scene_kind: str, receivers: int, quick: bool = False, device: str = "cpu"
) -> list[Candidate]:
    """The models of a report.

    Args:
        scene_kind: "skinned" or "point_cache".
        receivers: of the dataset.
        quick: the smallest of every family that takes seconds to fit.
        device: where to fit.
    """
    skinned = scene_kind == "skinned"
    made = []
    for family in FAMILIES:
        if (family.needs_skin and not skinned) or (family.around and quick):
            continue
        name = family.name if skinned else family.name.replace("joint", "dihedral")
        own = []
        for size, base in list(family.sizes.items())[: 1 if quick else None]:
            config = dataclasses.asdict(fewer_clusters(base, receivers))
            config |= {"device": device, **family.options}
            own.append(Candidate(f"{name}, {size}", name, TrainConfig(**config)))
        made += own
        for storage in family.storages:
            made += [in_fewer_bytes(each, storage) for each in own]
    return made


def fewer_clusters(config: TrainConfig, receivers: int) -> TrainConfig:
    """The configuration, its clusters not too small for so many receivers."""
    clusters = min(config.clusters, max(1, receivers // FEWEST_RECEIVERS))
    return dataclasses.replace(config, clusters=clusters)


def in_fewer_bytes(candidate: Candidate, storage: Storage) -> Candidate:
    """The same model in fewer bytes."""
    size = candidate.name.removeprefix(candidate.family)
    family = f"{candidate.family}, {BITS[storage]}"
    config = dataclasses.replace(candidate.config, storage=storage)
    return Candidate(family + size, family, config, source=candidate.name)


def fitted(
    dataset: Dataset, chosen: Sequence[Candidate]
) -> Iterator[tuple[Candidate, VisibilityModel]]:
    """Each candidate's model; the first of a family chooses weight decay for the others."""
    alphas: dict[str, float] = {}
    models: dict[str, VisibilityModel] = {}
    for candidate in chosen:
        if candidate.source is not None:
            yield candidate, rounded(models[candidate.source], dataset, candidate.config.storage)
            continue
        known = alphas.get(candidate.family)
        config = candidate.config if known is None else candidate.with_alpha(known).config
        model = models[candidate.name] = train(dataset, config)
        alphas[candidate.family] = model.metadata["alpha"]
        yield candidate, model


def rounded(model: VisibilityModel, dataset: Dataset, storage: Storage) -> VisibilityModel:
    """A model in fewer bytes, as if it had been trained so; its training error is not known."""
    known = {name: value for name, value in model.metadata.items() if not name.endswith("_error")}
    config = {**known["config"], "storage": storage}
    model = dataclasses.replace(model, metadata={**known, "config": config}).stored_as(storage)
    # Its range is that of its rounded inputs.
    return with_training_range(model, model.features(dataset.read("pose", training_rows(dataset))))


def searched(
    dataset: Dataset, device: str, milliseconds: Callable[[bytes], float]
) -> Iterator[VisibilityModel]:
    """The smallest models within limits on the error, spread over what is feasible.

    Large kinds and those that look around every receiver are not among them: they take minutes to
    fit. The first has the seconds of fitting all.

    Args:
        dataset: from ``prtnet generate``.
        device: where to fit.
        milliseconds: a pose takes in a graph, given as bytes.

    Raises:
        PrtnetError: the training clips cannot judge models.
    """
    base = fewer_clusters(SEARCH_BASE, len(dataset.rest_tangents))
    started = time.perf_counter()
    base = dataclasses.replace(base, device=device)
    kinds = Candidates(dataset, base, kinds=SEARCH_KINDS)
    least, mean = feasible(kinds)
    strict, loose = STRICT * least, LOOSE * mean
    if 0.0 < strict < loose < 1.0:  # there is something to choose
        for limit in np.geomspace(loose, strict, SEARCHED):
            model = found(kinds, Budget(max_error=float(limit)), milliseconds)
            model.metadata["seconds"]["total"] = time.perf_counter() - started
            yield model
            started = time.perf_counter()
