"""Which models a report compares: families of models, each in several sizes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from training.config import PRESETS, TrainConfig

__all__ = ["FAMILIES", "SIZES", "Candidate", "Family", "candidates"]

FEWEST_RECEIVERS = 100  # a cluster: small meshes get fewer clusters


@dataclass(frozen=True)
class Family:
    """Models that differ in size alone.

    Attributes:
        name: what readers call it; "joint angles" in it becomes "dihedral angles" for caches.
        options: fields of the configuration that make the family.
        needs_skin: whether a point cache cannot have it.
        around: whether its models look around every receiver: they take minutes to fit.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    needs_skin: bool = False
    around: bool = False

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
    """

    name: str
    family: str
    config: TrainConfig

    def with_alpha(self, alpha: float) -> Candidate:
        """The same with a weight decay that is known already."""
        return dataclasses.replace(self, config=dataclasses.replace(self.config, alpha=alpha))


FAMILIES = (
    Family("linear, joint angles", {"kind": "linear", "features": "joint_angles"}),
    Family("neural, joint angles", {"kind": "neural", "features": "joint_angles"}),
    Family("linear, occluders", {"kind": "linear", "features": "occluders"}, needs_skin=True),
    Family("neural, occluders", {"kind": "neural", "features": "occluders"}, needs_skin=True),
    Family("hybrid", {"kind": "hybrid"}, around=True),
    Family("shared", {"kind": "shared"}, around=True),
)
SIZES = {
    "small": PRESETS["small"],
    "medium": PRESETS["default"],
    "large": dataclasses.replace(PRESETS["default"], latents=24),
}
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
    most = max(1, receivers // FEWEST_RECEIVERS)
    made = []
    for family in FAMILIES:
        if (family.needs_skin and not skinned) or (family.around and quick):
            continue
        name = family.name if skinned else family.name.replace("joint", "dihedral")
        for size, base in list(family.sizes.items())[: 1 if quick else None]:
            own = {"clusters": min(base.clusters, most), "device": device, **family.options}
            config = TrainConfig(**{**dataclasses.asdict(base), **own})
            made.append(Candidate(f"{name}, {size}", name, config))
    return made
