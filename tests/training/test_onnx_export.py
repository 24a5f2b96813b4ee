from __future__ import annotations

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.models import random_model, random_poses
from training.onnx_export import build_onnx, export_onnx
from training.onnx_graph import OPSET, PORTABLE, GraphBuilder

RELATIVE = 1e-5  # float32 through about ten thousand multiply-adds


def run(model, poses):
    proto = build_onnx(model)
    session = onnxruntime.InferenceSession(
        proto.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    return session.run(None, {"pose": poses})[0]


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
@pytest.mark.parametrize(
    "features", ["joint_angles", "dihedral_angles", "local_joints", "occluders"]
)
@pytest.mark.parametrize("morphs", [0, 2])
def test_graph_equals_the_numpy_reference(kind, features, morphs):
    if features == "dihedral_angles" and morphs:
        pytest.skip("point caches have no morph targets")
    model = random_model(kind, features, morphs=morphs)
    for count in (1, 7):
        poses = random_poses(count, 5, morphs, seed=count)
        expected = model(poses)
        got = run(model, poses)
        assert got.shape == expected.shape == (count, 40, 9)
        assert np.abs(got - expected).max() <= RELATIVE * np.abs(expected).max()
        if kind != "constant":
            assert np.ptp(run(model, random_poses(2, 5, morphs)), axis=0).max() > 0.1


@pytest.mark.parametrize("order", [1, 2, 3])
def test_every_order_of_the_caps(order):
    model = random_model(feature_order=order, seed=order)
    poses = random_poses(3, 5, seed=order, one_scale=model.features.one_scale)
    expected = model(poses)
    assert np.abs(run(model, poses) - expected).max() <= RELATIVE * np.abs(expected).max()


def test_one_cluster_and_equal_latents():
    model = random_model(clusters=1, receivers=9, seed=2)
    poses = random_poses(2, 5)
    expected = model(poses)
    assert np.abs(run(model, poses) - expected).max() <= RELATIVE * np.abs(expected).max()


def test_only_portable_operators_of_the_promised_opset():
    proto = build_onnx(random_model())
    assert [o.version for o in proto.opset_import] == [OPSET] == [15]
    assert {node.op_type for node in proto.graph.node} <= PORTABLE
    assert max(len(t.dims) for t in proto.graph.initializer) <= 8
    with pytest.raises(ValueError, match="not portable"):
        GraphBuilder().node("Einsum", "pose")


def test_file_passes_the_checker(tmp_path):
    export_onnx(random_model(), tmp_path / "model.onnx")
    onnx.checker.check_model(str(tmp_path / "model.onnx"), full_check=True)
    assert [f.name for f in tmp_path.iterdir()] == ["model.onnx"]
