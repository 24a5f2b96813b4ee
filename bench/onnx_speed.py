"""onnxruntime on the human's models, beside the time to read a model's bytes once.

python bench/onnx_speed.py [--write]
"""

from __future__ import annotations

import sys
import threading
import time

import numpy as np
from tables import HUMAN, OUT, dataset, publish

from prtnet.model import VisibilityModel
from runtime.onnx_model import OnnxModel
from training.onnx_export import build_onnx

MODELS = {
    "clips and 600 sampled poses, neural, occluders": "preset default, neural on occluders",
    "clips and 600 sampled poses, neural, occluders, 14 latents": "the same with 14 latents",
    "clips and 600 sampled poses, preset small": "preset small",
    "clips and 600 sampled poses, preset fast": "preset fast",
}


def read_milliseconds(size: int, threads: int, repeats: int = 200) -> float:
    """Median time for ``threads`` threads to sum ``size`` bytes of float32, each its share."""
    parts = np.array_split(np.ones(size // 4, dtype=np.float32), threads)
    taken = []
    for _ in range(repeats):
        barrier = threading.Barrier(threads + 1)

        def work(part: np.ndarray, gate: threading.Barrier = barrier) -> None:
            gate.wait()
            np.add.reduce(part)
            gate.wait()

        team = [threading.Thread(target=work, args=(part,)) for part in parts]
        for thread in team:
            thread.start()
        barrier.wait()
        started = time.perf_counter()
        barrier.wait()
        taken.append(time.perf_counter() - started)
    return 1e3 * float(np.median(taken))


def main() -> None:
    """One pose, full SH visibility of 13,380 receivers, features computed in the graph."""
    data = dataset("human", "human.glb", HUMAN)
    pose = data.read("pose", slice(1))
    rows = []
    for name, label in MODELS.items():
        path = OUT / f"human {name}.safetensors"
        if not path.exists():
            sys.exit(f"{path} is not there: run bench/models.py human first")
        proto = build_onnx(VisibilityModel.load(path)).SerializeToString()
        for threads in (1, 2):
            model = OnnxModel(proto, threads)
            taken = [model.milliseconds(pose, repeats=400) for _ in range(5)]
            rows.append(
                [
                    f"{label}, {threads} thread{'s' * (threads > 1)}",
                    f"{len(proto) / 1e6:.1f}",
                    f"{np.median(taken):.3f}",
                    f"{min(taken):.3f}",
                    f"{read_milliseconds(len(proto), threads):.3f}",
                ]
            )
            print(rows[-1], flush=True)
    columns = ("human, one pose", "MB", "ms, median", "ms, best of 5", "ms to read the bytes")
    publish("onnx", columns, rows)


if __name__ == "__main__":
    main()
