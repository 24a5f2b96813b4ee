"""While a model is made, libraries compute by one thread: work is divided into pieces alone."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from threadpoolctl import threadpool_info

from tests.training.data import memory_dataset
from training import search as module
from training.budget import Budget
from training.config import TrainConfig
from training.search import search
from training.train import train

SMALL = TrainConfig(
    clusters=3, iterations=10, neurons=6, points=2, near=6, spheres=12, latents=3, near_spheres=5,
    patches=9, near_patches=5, width=8, steps=60, codes=4, samples=2000,
)  # fmt: skip


class Counting:
    """A monitor that asks at every word how many threads there are."""

    def __init__(self) -> None:
        self.seen: set[int] = set()
        self.stages: list[str] = []

    def look(self, *_: Any) -> None:
        blas = [own["num_threads"] for own in threadpool_info() if own["user_api"] == "blas"]
        self.seen |= {torch.get_num_threads(), *blas}

    progress = scalar = histogram = look

    def stage(self, text: str) -> None:
        self.stages.append(text)
        self.look()


pytestmark = pytest.mark.usefixtures("three_threads")


@pytest.mark.parametrize("kind", ["linear", "quadratic", "neural", "lobes", "hybrid", "shared"])
def test_libraries_compute_by_one(kind: str) -> None:
    data: Any = memory_dataset(per_clip=6)
    watch = Counting()
    model = train(data, dataclasses.replace(SMALL, kind=kind), watch)
    assert watch.seen == {1}
    assert len(watch.stages) > 3
    assert torch.get_num_threads() == 3
    assert model.metadata["made_with"]["threads"] == 3


def test_libraries_compute_by_one_in_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    own = {name: each for name, each in module.FAMILIES.items() if each["kind"] == "linear"}
    monkeypatch.setattr(module, "FAMILIES", own)
    data: Any = memory_dataset(clips=5, per_clip=12)
    watch = Counting()
    budget = Budget(max_mb=0.02)
    search(data, TrainConfig(clusters=3, iterations=10), budget, lambda _: 1.0, watch)
    assert watch.seen == {1}
    assert torch.get_num_threads() == 3
