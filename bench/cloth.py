"""A cloth's held-out error: dihedral angles in clusters, and what each receiver sees around it.

python bench/cloth.py [--write]
"""

from __future__ import annotations

import dataclasses

import models
import torch
from tables import CLOTH, dataset, publish

from prtnet.dataset import Dataset
from training.config import PRESETS, TrainConfig

COLUMNS = (*models.COLUMNS, "training s")


def row(name: str, data: Dataset, config: TrainConfig) -> list[str]:
    """As of other scenes, with the seconds of the whole training, which priors take."""
    cells, model = models.measured(name, data, config)
    return [*cells, f"{model.metadata['seconds']['total']:.0f}"]


def main() -> None:
    data = dataset("cloth", "cloth_train.npz", CLOTH)
    print("cloth: traced", flush=True)
    base, alone = PRESETS["default"], dataclasses.replace(PRESETS["default"], latents=0)
    papers = dataclasses.replace(base, latents=24, inputs=60, input_variance=0.9)
    shared = dataclasses.replace(alone, kind="shared", width=64)
    configs = {
        "linear, dihedral angles": dataclasses.replace(papers, kind="linear"),
        "neural, dihedral angles": papers,
        "hybrid, maps": dataclasses.replace(alone, kind="hybrid"),
        "shared, 64": shared,
        "shared, 64, 4 bits": dataclasses.replace(shared, storage="int4"),
        "shared, 128": dataclasses.replace(shared, width=128),
    }
    publish("cloth", COLUMNS, [row(name, data, config) for name, config in configs.items()])


if __name__ == "__main__":
    torch.set_num_threads(2)
    main()
