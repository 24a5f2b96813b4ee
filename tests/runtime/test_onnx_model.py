from __future__ import annotations

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from prtnet.errors import PrtnetError
from runtime.onnx_model import OnnxModel
from tests.models import random_model, random_poses
from training.onnx_export import build_onnx, export_onnx


def test_a_file_and_its_bytes_answer_alike(tmp_path):
    model = random_model()
    export_onnx(model, tmp_path / "model.onnx")
    poses = random_poses(3, 5)
    file, memory = (
        OnnxModel(tmp_path / "model.onnx"),
        OnnxModel(build_onnx(model).SerializeToString(), threads=1),
    )
    assert np.array_equal(file(poses), memory(poses))
    assert (file.receiver_count, file.order, file.pose_size) == (40, 3, 60)
    rows = np.concatenate([answer for _, answer in memory.blocks(poses, 2)])
    assert np.allclose(rows, memory(poses), atol=1e-5)
    assert 0 < memory.milliseconds(poses[:1], repeats=3) < 1e4


def test_wrong_poses_and_files_are_told(tmp_path):
    model = OnnxModel(build_onnx(random_model()).SerializeToString())
    with pytest.raises(PrtnetError, match=r"wants \(poses, 60\)"):
        model(random_poses(1, 4))
    with pytest.raises(PrtnetError, match="does not exist"):
        OnnxModel(tmp_path / "none.onnx")
    (tmp_path / "bad.onnx").write_bytes(b"not a graph")
    with pytest.raises(PrtnetError, match="cannot be run"):
        OnnxModel(tmp_path / "bad.onnx")
    value = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1])
    result = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("Tanh", ["x"], ["y"])], "g", [value], [result])
    other = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 15)], ir_version=8)
    onnx.save(other, tmp_path / "other.onnx")
    with pytest.raises(PrtnetError, match="no prtnet visibility model"):
        OnnxModel(tmp_path / "other.onnx")
