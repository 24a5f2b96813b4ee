"""An exported model in onnxruntime: poses in, visibility out, and how long it takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError

__all__ = ["OnnxModel", "OnnxPart"]


class OnnxPart:
    """A graph beside the model's own, of ``pose`` alone, run by onnxruntime on the CPU.

    Args:
        model: bytes of the graph of latents or of occluders; see ``prtnet export``.
        threads: of onnxruntime; all cores when None.
    """

    def __init__(self, model: bytes, threads: int | None = None) -> None:
        self.session = onnxruntime.InferenceSession(
            model, session_options(threads), providers=["CPUExecutionProvider"]
        )

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Latents (P, Σ latents) or texels of occluders (P, N, 4) of flattened poses (P, D)."""
        feed = {"pose": np.ascontiguousarray(poses, dtype=np.float32)}
        return self.session.run(None, feed)[0]


def session_options(threads: int | None) -> Any:
    """Of onnxruntime: quiet, so many threads, or all cores."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = threads or 0
    options.inter_op_num_threads = 1
    return options


class OnnxModel:
    """A visibility model run by onnxruntime on the CPU.

    Args:
        model: path of an ``.onnx`` file, or its bytes.
        threads: of onnxruntime; all cores when None.

    Raises:
        PrtnetError: the file is missing, damaged, or no visibility model.
    """

    def __init__(self, model: str | Path | bytes, threads: int | None = None) -> None:
        name = "ONNX model" if isinstance(model, bytes) else str(model)
        if not isinstance(model, bytes) and not Path(model).is_file():
            raise PrtnetError(name, "does not exist; run `prtnet export` first")
        try:
            self.session = onnxruntime.InferenceSession(
                model if isinstance(model, bytes) else str(model),
                session_options(threads),
                providers=["CPUExecutionProvider"],
            )
        except Exception as error:  # onnxruntime raises types of its own, from C++
            reason = str(error).splitlines()[0]
            raise PrtnetError(name, f"cannot be run ({reason}); export it anew") from error
        inputs = {i.name: i.shape for i in self.session.get_inputs()}
        outputs = {o.name: o.shape for o in self.session.get_outputs()}
        if list(inputs) != ["pose"] or list(outputs) != ["visibility"]:
            raise PrtnetError(name, "is no prtnet visibility model (pose in, visibility out)")
        self.pose_size = int(inputs["pose"][1])
        self.receiver_count = int(outputs["visibility"][1])
        self.order = round(outputs["visibility"][2] ** 0.5)

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Visibility (P, V, n²) of flattened poses (P, D)."""
        if poses.ndim != 2 or poses.shape[1] != self.pose_size:
            raise PrtnetError(
                "pose", f"has shape {poses.shape}, the model wants (poses, {self.pose_size})"
            )
        feed = {"pose": np.ascontiguousarray(poses, dtype=np.float32)}
        return self.session.run(["visibility"], feed)[0]

    def blocks(self, poses: FloatArray, size: int = 1) -> Iterator[tuple[slice, FloatArray]]:
        """Visibility block by block of poses: bounded memory for any number of them."""
        for start in range(0, len(poses), size):
            block = slice(start, min(start + size, len(poses)))
            yield block, self(poses[block])

    def milliseconds(self, pose: FloatArray, repeats: int = 50, warm_up: int = 5) -> float:
        """Median time of one pose (1, D), into an output buffer that is there already."""
        binding = self.session.io_binding()
        binding.bind_cpu_input("pose", np.ascontiguousarray(pose, dtype=np.float32))
        result = np.empty((1, self.receiver_count, self.order**2), dtype=np.float32)
        binding.bind_output("visibility", "cpu", 0, np.float32, result.shape, result.ctypes.data)
        taken = []
        for _ in range(warm_up + repeats):
            started = time.perf_counter()
            self.session.run_with_iobinding(binding)
            taken.append(time.perf_counter() - started)
        return 1e3 * float(np.median(taken[warm_up:]))
