"""Other forms of the human's quick graph in onnxruntime: does any of them cost less?

python bench/graph_forms.py [--write]
"""

from __future__ import annotations

import sys
import time

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper
from tables import HUMAN, OUT, dataset, publish

from prtnet.model import VisibilityModel
from training.onnx_export import build_onnx

NAME = "human clips and 600 sampled poses, preset fast.safetensors"
REPEATS, TIMES = 400, 5


def session(proto: bytes, threads: int, branches: bool = False) -> onnxruntime.InferenceSession:
    """On so many threads: inside every node, or of nodes beside each other."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    options.intra_op_num_threads = 1 if branches else threads
    if branches:
        options.execution_mode = onnxruntime.ExecutionMode.ORT_PARALLEL
        options.inter_op_num_threads = threads
    return onnxruntime.InferenceSession(proto, options, providers=["CPUExecutionProvider"])


def reconstruction(model: VisibilityModel, integers: bool) -> bytes:
    """Latents to visibility alone, of random numbers in the model's shapes.

    In integers the mean takes two rows, and one scale is common to all groups: what the products
    give needs only to be converted.
    """
    rng = np.random.default_rng(0)
    width = model.basis.shape[1]
    nodes, values = [], {"ends": np.array([1, -1, model.order**2])}
    counts, groups = np.unique(model.latents, return_counts=True)
    for count, many in zip(counts.tolist(), groups.tolist(), strict=True):
        rows = count + (2 if integers else 1)
        own = rng.normal(size=(many, rows, width))
        values[f"rows{count}"] = (30 * own).astype(np.int8) if integers else own.astype(np.float32)
        values[f"latents{count}"] = rng.normal(128, 30, size=(1, many, 1, rows)).astype(np.float32)
        nodes.append(helper.make_node("Add", ["pose", f"latents{count}"], [f"own{count}"]))
        if integers:
            nodes += [
                helper.make_node("Cast", [f"own{count}"], [f"bytes{count}"], to=TensorProto.UINT8),
                helper.make_node(
                    "MatMulInteger", [f"bytes{count}", f"rows{count}"], [f"sum{count}"]
                ),
                helper.make_node("Cast", [f"sum{count}"], [f"slots{count}"], to=TensorProto.FLOAT),
            ]
        else:
            nodes.append(
                helper.make_node("MatMul", [f"own{count}", f"rows{count}"], [f"slots{count}"])
            )
        nodes.append(helper.make_node("Reshape", [f"slots{count}", "ends"], [f"part{count}"]))
    values["place"] = model.slot_of_receiver.astype(np.int32)
    nodes += [
        helper.make_node("Concat", [f"part{count}" for count in counts], ["every"], axis=1),
        helper.make_node("Gather", ["every", "place"], ["visibility"], axis=1),
    ]
    shape = [1, model.receiver_count, model.order**2]
    graph = helper.make_graph(
        nodes,
        "reconstruction",
        [helper.make_tensor_value_info("pose", TensorProto.FLOAT, [1])],
        [helper.make_tensor_value_info("visibility", TensorProto.FLOAT, shape)],
        [numpy_helper.from_array(array, name) for name, array in values.items()],
    )
    proto = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 15)], ir_version=8)
    onnx.checker.check_model(proto)
    return proto.SerializeToString()


def main() -> None:
    """One pose of the human's preset fast, and the last part of its graph by itself."""
    path = OUT / NAME
    if not path.exists():
        sys.exit(f"{path} is not there: run bench/models.py human first")
    model = VisibilityModel.load(path)
    pose = dataset("human", "human.glb", HUMAN).read("pose", slice(1)).astype(np.float32)
    whole = build_onnx(model).SerializeToString()
    one = np.ones(1, dtype=np.float32)
    sessions = {
        "whole graph, 1 thread": (session(whole, 1), pose),
        "whole graph, 2 threads in every node": (session(whole, 2), pose),
        "whole graph, 2 threads for nodes beside each other": (session(whole, 2, True), pose),
    }
    for form, integers in (("float32", False), ("8-bit integers", True)):
        proto = reconstruction(model, integers)
        for threads in (1, 2):
            label = f"reconstruction alone, {form}, {threads} thread{'s' * (threads > 1)}"
            sessions[label] = session(proto, threads), one
    taken: dict[str, list[float]] = {name: [] for name in sessions}
    for _ in range(TIMES):  # all in turn, so that a disturbance meets all
        for name, (run, value) in sessions.items():
            own = []
            for _ in range(REPEATS):
                started = time.perf_counter()
                run.run(None, {"pose": value})
                own.append(time.perf_counter() - started)
            taken[name].append(1e3 * float(np.median(own)))
    rows = [[name, f"{np.median(times):.3f}", f"{min(times):.3f}"] for name, times in taken.items()]
    publish("graph forms", ("human, preset fast", "ms, median", "ms, best of 5"), rows)


if __name__ == "__main__":
    main()
