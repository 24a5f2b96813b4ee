from __future__ import annotations

import dataclasses

import numpy as np
import onnx
import onnxruntime
import pytest

from prtnet.components import coding
from prtnet.lobe_numbers import LobeNumbers
from prtnet.storage import STORAGES, Packing, Stored, quantise
from tests.models import random_model, random_poses
from tests.priors import random_prior
from training.onnx_components import matrix_nodes
from training.onnx_export import build_onnx, export_onnx
from training.onnx_graph import OPSET, PORTABLE, GraphBuilder
from training.onnx_lobes import lobe_nodes

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
@pytest.mark.parametrize("clamped", [True, False])
def test_graph_equals_the_numpy_reference(kind, features, morphs, clamped):
    if features == "dihedral_angles" and morphs:
        pytest.skip("point caches have no morph targets")
    model = random_model(kind, features, morphs=morphs, clamped=clamped)
    for count in (1, 7):
        poses = random_poses(count, 5, morphs, seed=count)
        expected = model(poses)
        got = run(model, poses)
        assert got.shape == expected.shape == (count, 40, 9)
        assert np.abs(got - expected).max() <= RELATIVE * np.abs(expected).max()
        if kind != "constant":
            assert np.ptp(run(model, random_poses(2, 5, morphs)), axis=0).max() > 0.1


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("clamped", [True, False])
@pytest.mark.parametrize("features", ["joint_angles", "local_joints", "occluders"])
def test_fewer_bytes_and_more_groups_equal_the_reference(kind, storage, parts, clamped, features):
    model = random_model(kind, features, morphs=2, receivers=900, parts=parts, clamped=clamped)
    model = model.stored_as(storage)
    poses = random_poses(4, 5, 2)
    expected = model(poses)
    assert np.abs(run(model, poses) - expected).max() <= RELATIVE * np.abs(expected).max()


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
@pytest.mark.parametrize("storage", ["float32", "float16", "int8"])
@pytest.mark.parametrize("lobes", [1, 2, 5])
@pytest.mark.parametrize(("parts", "features"), [(1, "joint_angles"), (3, "occluders")])
def test_lobes_equal_the_reference(kind, storage, lobes, parts, features):
    model = random_model(kind, features, receivers=900, parts=parts, lobes=lobes)
    model = model.stored_as(storage)
    for count in (1, 4):
        poses = random_poses(count, 5)
        expected = model(poses)
        got = run(model, poses)
        assert got.shape == (count, 900, 9)
        assert np.abs(got - expected).max() <= RELATIVE * np.abs(expected).max()


def test_lobes_of_one_band_and_lobes_without_a_direction():
    model = random_model("linear", lobes=2)
    model.mean[:, 1:7] = model.basis[:, 1:7] = 0.0  # of the first receiver of each group
    poses = random_poses(3, 5)
    assert np.abs(run(model, poses) - model(poses)).max() <= RELATIVE * np.abs(model(poses)).max()
    graph = GraphBuilder()
    value = graph.reshape(graph.node("Add", "pose", graph.constant(0.0)), [-1, 3, 7])
    lobe_nodes(graph, LobeNumbers(2, 1), value, 3, "visibility")
    proto = graph.model(21, "visibility", [3, 1], {})
    given = np.arange(42, dtype=np.float32).reshape(2, 21)
    session = onnxruntime.InferenceSession(proto.SerializeToString())
    got = session.run(None, {"pose": given})[0]
    assert np.array_equal(got, LobeNumbers(2, 1).harmonics(given.reshape(2, 3, 7)))


def test_the_file_shrinks_with_the_storage():
    model = random_model(receivers=9000)
    whole, half, quarter, fewest = (
        build_onnx(model.stored_as(storage)).ByteSize() for storage in STORAGES
    )
    arrays = model.mean.nbytes + model.basis.nbytes
    assert whole - half > 0.49 * arrays
    assert whole - quarter > 0.74 * arrays
    assert quarter - fewest > 0.05 * arrays


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("clamped", [True, False])
def test_clusters_of_few_neurons_and_components_of_few_bands(storage, clamped):
    model = random_model(receivers=900, clusters=9, parts=2, clamped=clamped)
    model.latents[4:8] = 0  # clusters that keep their mean alone
    model = dataclasses.replace(model, basis=model.basis[: model.latents.sum()])
    neurons = np.array([6, 2, 0, 0, 6, 3, 3, 1, 6], dtype=np.int32)
    idle = np.arange(6) >= neurons[:, None]
    layer = model.regressor
    layer.hidden_weight[np.broadcast_to(idle[:, None], layer.hidden_weight.shape)] = 0.0
    layer.hidden_bias[idle] = 0.0
    layer.weight[np.repeat(idle, 2, axis=0)] = 0.0
    full = build_onnx(model.stored_as(storage)).ByteSize()
    model = dataclasses.replace(model, neurons=neurons)
    how = None
    if storage == "int4":
        count = len(model.basis)
        bits, orders = np.where(np.arange(count) % 3, 4, 8), np.arange(count) % 3 + 1
        how = coding(model.basis, model.order**2, bits, orders)
    lean = model.stored_as(storage, how)
    poses = random_poses(4, 5)
    expected = lean(poses)
    assert np.abs(run(lean, poses) - expected).max() <= RELATIVE * np.abs(expected).max()
    if storage == "int4":
        assert build_onnx(lean).ByteSize() < full


def test_matrices_that_are_mostly_zeros_are_stored_without_them():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(9, 40, 70)).astype(np.float32)
    values[:, :, 30:] = 0.0
    values[4] = 0.0
    heights = np.array([40, 7, 40, 40, 0, 7, 7, 40, 40])
    values[np.broadcast_to((np.arange(40) >= heights[:, None])[..., None], values.shape)] = 0.0
    packing = Packing("int8", axis=(-2, -1), period=70)
    for stored in (Stored(values, np.ones((1, 1, 1), np.float32)), quantise(values, packing)):
        graph = GraphBuilder()
        value = matrix_nodes(graph, stored, heights)
        zero = graph.clip(graph.slice("pose", 0, 1, 1), 0.0, 0.0)
        graph.node("Add", graph.reshape(value, [1, -1]), zero, output="visibility")
        proto = graph.model(3, "visibility", [values.size], {})
        session = onnxruntime.InferenceSession(
            proto.SerializeToString(), providers=["CPUExecutionProvider"]
        )
        got = session.run(None, {"pose": np.zeros((1, 3), np.float32)})[0]
        assert np.array_equal(got.reshape(values.shape), stored.array())
        assert proto.ByteSize() < 0.6 * stored.values.nbytes


@pytest.mark.parametrize("features", ["joint_angles", "local_joints", "occluders"])
@pytest.mark.parametrize("kind", ["linear", "quadratic", "neural"])
@pytest.mark.parametrize(("storage", "parts"), [("float32", 1), ("float32", 3), ("int8", 3)])
def test_graph_clamps_and_fades_as_the_reference_does(kind, features, storage, parts):
    """Boxes from tiny to all-embracing: far outside, at the edge and inside."""
    model = random_model(kind, features, parts=parts).stored_as(storage)
    poses = random_poses(5, 5)
    inputs = model.reduced(poses)
    for size in (1e-3, 0.3, 1.0, 1e3):
        low = -size * np.abs(inputs).max(axis=0)[: len(model.input_low)]
        span = {"input_low": low.astype(np.float32), "input_high": -low.astype(np.float32)}
        boxed = dataclasses.replace(model, **span)
        expected = boxed(poses)
        assert np.abs(run(boxed, poses) - expected).max() <= RELATIVE * np.abs(expected).max()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_every_order_of_the_caps(order):
    model = random_model(feature_order=order, seed=order)
    poses = random_poses(3, 5, seed=order, one_scale=model.features.one_scale)
    expected = model(poses)
    assert np.abs(run(model, poses) - expected).max() <= RELATIVE * np.abs(expected).max()


@pytest.mark.parametrize("features", ["joint_angles", "occluders"])
@pytest.mark.parametrize("clamped", [True, False])
def test_one_cluster_and_equal_latents(features, clamped):
    model = random_model(features=features, clusters=1, receivers=9, seed=2, clamped=clamped)
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


@pytest.mark.parametrize("kind", ["maps", "network"])
@pytest.mark.parametrize("storage", STORAGES)
def test_graph_adds_the_prior(kind, storage):
    model = dataclasses.replace(random_model(), prior=random_prior(kind)).stored_as(storage)
    poses = random_poses(3, 5)
    expected = model(poses)
    assert np.abs(run(model, poses) - expected).max() <= RELATIVE * np.abs(expected).max()
