"""Bytes and error of models of the human in every storage there is.

python bench/storage.py [--write]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from tables import HUMAN, OUT, dataset, held_out_errors, per_cent, publish

from prtnet.model import VisibilityModel
from prtnet.storage import STORAGES
from training.export import export_folder

MODELS = {
    "clips and 600 sampled poses, neural, occluders, 14 latents": "14 latents",
    "clips and 600 sampled poses, preset fast": "preset fast",
}


def main() -> None:
    """Every storage of both models: what lies on disk and on the GPU, and the held-out error."""
    data = dataset("human", "human.glb", HUMAN)
    rows = []
    for name, label in MODELS.items():
        path = OUT / f"human {name}.safetensors"
        if not path.exists():
            sys.exit(f"{path} is not there: run bench/models.py human first")
        trained = VisibilityModel.load(path)
        for storage in STORAGES:
            model = trained.stored_as(storage)
            with tempfile.TemporaryDirectory() as folder:
                file = Path(folder) / "model.safetensors"
                model.save(file)
                sizes = export_folder(model, Path(folder) / "export")
                sizes["file"] = file.stat().st_size
            shown = ("file", "model.onnx", "gpu.bin", "latent.onnx")
            rows.append(
                [
                    f"{label}, {storage}",
                    per_cent(held_out_errors(data, model)["rms"]),
                    *(f"{sizes[part] / 1e6:.2f}" for part in shown),
                ]
            )
            print(rows[-1], flush=True)
    columns = ("human", "held-out", "MB", "MB of ONNX", "MB on the GPU", "MB of latent ONNX")
    publish("storage", columns, rows)


if __name__ == "__main__":
    main()
