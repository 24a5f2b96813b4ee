from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
import safetensors.numpy

from prtnet import sh
from prtnet.components import coding
from prtnet.errors import PrtnetError
from prtnet.lobe_numbers import LobeNumbers
from prtnet.model import VisibilityModel
from prtnet.storage import STORAGES
from prtnet.zh import Lobes
from tests.models import random_model, random_poses
from tests.priors import random_prior


def slow(model, pose):
    """One receiver at a time, straight from the definition."""
    inputs = model.reduced(pose[None])[0].astype(np.float64)
    result = np.zeros((model.receiver_count, model.order**2))
    starts = np.concatenate([[0], np.cumsum(model.latents)])
    regressor = model.regressor
    for group, slots in enumerate(model.receivers):
        cluster = group // model.parts
        value, strength = inputs[cluster], 1.0
        if model.input_low is not None:
            box = min(cluster, len(model.input_low) - 1)
            low, high = model.input_low[box], model.input_high[box]
            known = np.array([min(max(v, a), b) for v, a, b in zip(value, low, high, strict=True)])
            diagonal = sum((float(b) - a) ** 2 for a, b in zip(low, high, strict=True)) ** 0.5
            strength = 1 / (1 + sum((value - known) ** 2) / (diagonal / 2) ** 2)
            value = known
        if regressor.pairs is not None:
            products = [value[i] * value[j] for i, j in regressor.pairs.T]
            value = np.concatenate([value, products])
        if regressor.hidden_weight is not None:
            value = np.tanh(
                value @ regressor.hidden_weight[cluster] + regressor.hidden_bias[cluster]
            )
        latent = strength * (value @ regressor.weight[group] + regressor.bias[group])
        for slot, receiver in enumerate(slots):
            if receiver < 0:
                continue
            own = slice(slot * model.order**2, (slot + 1) * model.order**2)
            result[receiver] = model.mean[group, own]
            for k in range(model.latents[group]):
                result[receiver] += latent[k] * model.basis[starts[group] + k, own]
    return result


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
@pytest.mark.parametrize(
    "features", ["joint_angles", "dihedral_angles", "local_joints", "occluders"]
)
@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("clamped", [True, False])
def test_equals_the_definition(kind, features, parts, clamped):
    model = random_model(kind, features, parts=parts, clamped=clamped)
    shared = kind != "neural" and features not in ("occluders", "local_joints")
    assert model.parts == (1 if shared else parts)  # sharing nothing but the inputs is no cluster
    poses = random_poses(3, 5)
    expected = np.stack([slow(model, pose) for pose in poses])
    assert np.allclose(model(poses), expected, rtol=1e-4, atol=1e-4)


def test_encode_inverts_decode_for_orthonormal_components():
    model = random_model()
    starts = np.concatenate([[0], np.cumsum(model.latents)])
    for cluster, slots in enumerate(model.receivers):
        rows = model.basis[starts[cluster] : starts[cluster + 1]]
        rows = rows * np.repeat(slots >= 0, model.order**2)
        model.basis[starts[cluster] : starts[cluster + 1]] = np.linalg.qr(rows.T)[0].T
    latent = model.latent(random_poses(2, 5))
    most = int(model.latents.max())
    assert np.allclose(model.encode(model.decode(latent)), latent[..., :most], atol=1e-4)


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("clamped", [True, False])
def test_file_round_trip(kind, storage, clamped, tmp_path):
    model = random_model(kind, parts=2, clamped=clamped).stored_as(storage)
    model.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    poses = random_poses(2, 5)
    assert (again.kind, again.storage) == (kind, storage)
    assert np.array_equal(again(poses), model(poses))
    assert (again.input_low is not None) == clamped
    again.save(tmp_path / "again.safetensors")
    files = [(tmp_path / f"{name}.safetensors").read_bytes() for name in ("m", "again")]
    assert files[0] == files[1] or storage == "float16"  # halves may choose half the scale


@pytest.mark.parametrize("kind", ["constant", "linear", "quadratic", "neural"])
@pytest.mark.parametrize("lobes", [1, 2])
def test_lobes_equal_their_definition(kind, lobes):
    """One receiver and one lobe at a time, each evaluated about its own axis."""
    model = random_model(kind, parts=2, lobes=lobes)
    poses = random_poses(3, 5)
    flat = dataclasses.replace(model, lobes=0, order=3)
    numbers = model.decoded(model.latent(poses)).astype(np.float64)
    expected = np.zeros((3, 40, 9))
    for pose, receiver in np.ndindex(3, 40):
        own = numbers[pose, receiver]
        expected[pose, receiver, 0] = own[0]
        for lobe in range(lobes):
            axis = own[1 + 3 * lobe : 4 + 3 * lobe]
            basis = sh.evaluate_reference(axis / np.linalg.norm(axis), 3)
            for band in (1, 2):
                part = slice(band * band, (band + 1) ** 2)
                g = own[1 + 3 * lobes + 2 * lobe + band - 1]
                value = g * np.sqrt(4 * np.pi / (2 * band + 1)) * basis[part]
                expected[pose, receiver, part] += value
    assert np.allclose(model(poses), expected, rtol=1e-4, atol=1e-4)
    assert np.allclose(model.lobes_of(poses).harmonics(), expected, rtol=1e-4, atol=1e-4)
    with pytest.raises(PrtnetError, match="predicts no lobes"):
        flat.lobes_of(poses)


@pytest.mark.parametrize("storage", ["float32", "float16", "int8"])
def test_lobes_in_files(storage, tmp_path):
    model = random_model("neural", parts=2, lobes=2).stored_as(storage)
    model.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    poses = random_poses(2, 5)
    assert (again.kind, again.lobes, again.storage) == ("lobes", 2, storage)
    assert np.array_equal(again(poses), model(poses))
    assert np.array_equal(again.training_mean, model.training_mean)
    with pytest.raises(PrtnetError, match=r"^--storage: int4 is made for .*; use int8"):
        model.stored_as("int4")


@pytest.mark.parametrize(
    ("header", "arrays", "told"),
    [
        (lambda h: h.pop("lobes"), None, "number of lobes does not fit the kind"),
        (lambda h: h.update(lobes=-2), None, "number of lobes does not fit the kind"),
        (lambda h: h.update(kind="linear"), None, "number of lobes does not fit the kind"),
        (lambda h: h.update(lobes=3), None, "mean has shape"),
        (lambda h: h.update(lobes="many"), None, "not a whole prtnet model"),
        (None, lambda a: a.pop("signal"), "lobes without their signal"),
    ],
)
def test_damaged_models_of_lobes_are_told(header, arrays, told, tmp_path):
    path = tmp_path / "m.safetensors"
    random_model("linear", lobes=2).save(path)
    rewrite(path, header, arrays)
    with pytest.raises(PrtnetError, match=told):
        VisibilityModel.load(path)


def test_the_best_that_components_of_lobes_could_do():
    """Nothing but the lobes' own error where there are as many components as numbers."""
    rng = np.random.default_rng(0)
    coding, poses = LobeNumbers(1, 3), random_poses(2, 5)
    model = random_model("linear", clusters=2, receivers=4, lobes=1)
    model.receivers[:] = [[0, 1], [2, 3]]
    size = 2 * coding.size
    basis = np.concatenate([np.eye(size, dtype=np.float32)] * 2)
    model = dataclasses.replace(model, latents=np.array([size, size]), basis=basis)
    turned = model.mean_lobes.axes + 0.1 * rng.normal(size=(2, 4, 1, 3))
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    g = np.tile([3.0, 1.0, 0.5], (2, 4, 1, 1))
    truth = Lobes(turned, g).harmonics().astype(np.float32)
    assert np.allclose(model.closest(poses, truth), truth, atol=0.05)
    exact = coding.harmonics(coding.fitted(truth, model.mean_lobes))
    assert np.allclose(model.closest(poses, truth), exact, atol=1e-4)
    fewer = dataclasses.replace(model, latents=np.array([2, 2]), basis=basis[:4])
    assert not np.allclose(fewer.closest(poses, truth), exact, atol=0.1)


def test_fewer_bytes_err_little(tmp_path):
    model = random_model(receivers=600)
    poses = random_poses(20, 5)
    expected, sizes = model(poses), {}
    for storage, error in (("float32", 0.0), ("float16", 5e-4), ("int8", 1.5e-2)):
        rounded = model.stored_as(storage)
        rounded.save(tmp_path / "m.safetensors")
        arrays = safetensors.numpy.load_file(tmp_path / "m.safetensors")
        sizes[storage] = arrays["mean"].nbytes + arrays["basis"].nbytes
        relative = np.linalg.norm(rounded(poses) - expected) / np.linalg.norm(expected)
        assert error / 10 <= relative <= error, storage
    assert sizes["float32"] == 2 * sizes["float16"] == 4 * sizes["int8"]
    model.regressor.weight[..., 0] *= 20.0  # leading components move most
    rounded, expected = model.stored_as("int4"), model(poses)
    rounded.save(tmp_path / "m.safetensors")
    arrays = safetensors.numpy.load_file(tmp_path / "m.safetensors")
    assert arrays["basis"].nbytes < 0.75 * model.basis.nbytes / 4
    assert set(np.unique(rounded.coding.bits)) == {4, 8}
    relative = np.linalg.norm(rounded(poses) - expected) / np.linalg.norm(expected)
    assert 0.01 < relative < 0.1


def test_a_coding_that_is_given_is_kept(tmp_path):
    model = random_model(receivers=600)
    count = len(model.basis)
    bits, orders = np.full(count, 8), np.arange(count) % model.order + 1
    rounded = model.stored_as("int4", coding(model.basis, 9, bits, orders))
    rounded.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    for how in (again.coding, again.stored_as("int4").coding):
        assert how.orders.tolist() == orders.tolist()
        assert how.bits.tolist() == bits.tolist()
    shaped = again.basis.reshape(count, -1, 9)
    assert not shaped[orders == 1][..., 1:].any()
    assert again.stored_as("float32").coding is None


def test_numbers_that_nothing_uses_are_not_written(tmp_path):
    model = random_model(parts=2)
    neurons = np.array([6, 0, 2, 6, 3, 1], dtype=np.int32)
    idle = np.arange(6) >= neurons[:, None]
    layer = model.regressor
    layer.hidden_weight[np.broadcast_to(idle[:, None], layer.hidden_weight.shape)] = 0.0
    layer.hidden_bias[idle] = 0.0
    layer.weight[np.repeat(idle, 2, axis=0)] = 0.0
    for storage in STORAGES:
        lean = dataclasses.replace(model, neurons=neurons).stored_as(storage)
        lean.save(tmp_path / "m.safetensors")
        arrays = safetensors.numpy.load_file(tmp_path / "m.safetensors")
        assert arrays["regressor.hidden_weight"].shape == (4 * neurons.sum(),)
        assert arrays["regressor.bias"].shape == (model.latents.sum(),)
        used = np.repeat(neurons, 2) * model.latents
        assert arrays["regressor.weight"].shape == (used.sum(),)
        again = VisibilityModel.load(tmp_path / "m.safetensors")
        poses = random_poses(3, 5)
        assert np.array_equal(again(poses), lean(poses))
        assert again.neurons.tolist() == neurons.tolist()


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("kind", ["linear", "neural"])
def test_clusters_that_keep_their_mean_have_no_input_pca_in_the_file(storage, kind, tmp_path):
    model = random_model(kind, clusters=9, parts=2, receivers=90)
    alive = np.arange(9) % 4 > 0
    latents = np.where(np.repeat(alive, 2), 2, 0).astype(np.int32)
    model = dataclasses.replace(model, latents=latents, basis=model.basis[: latents.sum()])
    path = tmp_path / "m.safetensors"

    def rows_of(model):
        model.stored_as(storage).save(path)
        again, poses = VisibilityModel.load(path), random_poses(3, 5)
        assert np.array_equal(again(poses), model.stored_as(storage)(poses))
        assert np.array_equal(again.input_basis, model.stored_as(storage).input_basis)
        return len(safetensors.numpy.load_file(path)["input_basis"])

    assert rows_of(model) == 9  # what is there is kept
    basis = np.where(alive[:, None, None], model.input_basis, np.float32(0.0))
    lean = dataclasses.replace(model, input_basis=basis)
    assert rows_of(lean) == alive.sum()
    none = dataclasses.replace(
        lean, latents=0 * lean.latents, basis=lean.basis[:0], input_basis=0 * basis
    )
    assert rows_of(none) == 0
    rows_of(lean)
    rewrite(path, None, lambda arrays: arrays.update(input_basis=arrays["input_basis"][1:]))
    with pytest.raises(PrtnetError, match="input_basis does not fit the latents"):
        VisibilityModel.load(path)


def test_wrong_poses_are_told(tmp_path):
    model = random_model()
    with pytest.raises(PrtnetError, match=r"wants \(poses, 60\)"):
        model(random_poses(2, 4))
    broken = random_poses(2, 5)
    broken[1, 3] = np.nan
    with pytest.raises(PrtnetError, match="not finite"):
        model(broken)


def rewrite(path, change_header=None, change_arrays=None):
    arrays = safetensors.numpy.load_file(path)
    with safetensors.safe_open(path, "numpy") as file:
        header = json.loads(file.metadata()["prtnet"])
    if change_header:
        change_header(header)
    if change_arrays:
        change_arrays(arrays)
    safetensors.numpy.save_file(arrays, path, {"prtnet": json.dumps(header)})


@pytest.mark.parametrize(
    ("header", "arrays", "told"),
    [
        (lambda h: h.update(format_version=99), None, "format version 99"),
        (lambda h: h.pop("kind"), None, "not a whole prtnet model"),
        (lambda h: h.update(features="tea_leaves"), None, "not a whole prtnet model"),
        (None, lambda a: a.pop("mean"), "not a whole prtnet model"),
        (None, lambda a: a.update(basis=a["basis"][1:]), "basis has shape"),
        (None, lambda a: a["mean"].fill(np.nan), "not finite"),
        (None, lambda a: a["receivers"].fill(0), "exactly one slot"),
        (lambda h: h.update(storage="parchment"), None, "no storage is called parchment"),
        (None, lambda a: a.update({"scale.mean": np.ones(3, np.float32)}), "does not fit mean"),
        (None, lambda a: a.update({"scale.sun": np.ones(3, np.float32)}), "belongs to no array"),
        (None, lambda a: a["regressor.weight"].fill(np.inf), "weight holds values"),
        (None, lambda a: a.pop("input_low"), "input_low and input_high"),
        (None, lambda a: a["input_high"].fill(np.nan), "input_high holds values"),
        (None, lambda a: a["features.point"].fill(np.nan), "point holds values"),
        (
            None,
            lambda a: a.update({"regressor.weight": a["regressor.weight"][1:]}),
            "does not fit",
        ),
        (None, lambda a: a.update(neurons=np.array([], np.int32)), "neurons or latents are empty"),
        (None, lambda a: a.update(neurons=a["neurons"][1:]), "not a whole prtnet model"),
        (None, lambda a: a["neurons"].fill(200), "does not fit"),
    ],
)
def test_damaged_models_are_told(header, arrays, told, tmp_path):
    path = tmp_path / "m.safetensors"
    random_model().save(path)
    rewrite(path, header, arrays)
    with pytest.raises(PrtnetError, match=told):
        VisibilityModel.load(path)


@pytest.mark.parametrize(
    ("arrays", "told"),
    [
        (lambda a: a.update(basis=a["basis"][1:]), "is shorter than"),
        (lambda a: a.update(basis=a["basis"][:0]), "is shorter than"),
        (lambda a: a.update(basis=np.append(a["basis"], a["basis"][:1])), "does not fit its bits"),
        (lambda a: a.update(basis=a["basis"].view(np.int8)), "basis are no bytes"),
        (lambda a: a["coding.profile"][:1].fill(0.0), "not finite, or not above"),
        (lambda a: a.pop("coding.bits"), "against what storage says"),
        (lambda a: a["coding.bits"].fill(5), "coding does not fit"),
        (lambda a: a["coding.orders"].fill(9), "coding does not fit"),
        (lambda a: a["coding.orders"].fill(0), "coding does not fit"),
        (lambda a: a.update({"coding.profile": np.ones(4, np.float32)}), "coding does not fit"),
        (lambda a: a["coding.profile"].fill(np.nan), "not finite, or not above"),
        (lambda a: a["scale.basis"].fill(np.inf), "not finite, or not above"),
        (lambda a: a.pop("scale.basis"), "not a whole prtnet model"),
        (lambda a: a.pop("coding.orders"), "not a whole prtnet model"),
    ],
)
def test_damaged_codings_are_told(arrays, told, tmp_path):
    path = tmp_path / "m.safetensors"
    random_model().stored_as("int4").save(path)
    rewrite(path, None, arrays)
    with pytest.raises(PrtnetError, match=told):
        VisibilityModel.load(path)


def test_files_that_are_no_models(tmp_path):
    with pytest.raises(PrtnetError, match="does not exist"):
        VisibilityModel.load(tmp_path / "none.safetensors")
    (tmp_path / "text").write_text("hello")
    with pytest.raises(PrtnetError, match="damaged or no safetensors"):
        VisibilityModel.load(tmp_path / "text")
    safetensors.numpy.save_file({"a": np.zeros(2)}, tmp_path / "other.safetensors")
    with pytest.raises(PrtnetError, match="no prtnet model"):
        VisibilityModel.load(tmp_path / "other.safetensors")
    random_model().save(tmp_path / "m.safetensors")
    whole = (tmp_path / "m.safetensors").read_bytes()
    (tmp_path / "m.safetensors").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(PrtnetError, match="damaged"):
        VisibilityModel.load(tmp_path / "m.safetensors")


def test_nothing_is_left_when_writing_fails(tmp_path):
    with pytest.raises(PrtnetError, match="cannot be written"):
        random_model().save(tmp_path / "nowhere" / "m.safetensors")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["maps", "network"])
@pytest.mark.parametrize("storage", STORAGES)
def test_a_prior_is_added_and_kept_in_the_file(kind, storage, tmp_path):
    plain = random_model()
    signal = np.random.default_rng(0).normal(size=(40, 9)).astype(np.float32)
    prior = random_prior(kind)
    model = dataclasses.replace(plain, prior=prior, signal=signal)
    poses = random_poses(2, 5)
    assert np.array_equal(model(poses), plain(poses) + prior(poses))
    assert np.array_equal(model.training_mean, signal)
    truth = model(poses)
    best = model.closest(poses, truth) - truth
    assert np.abs(best).max() <= np.abs(plain.closest(poses, truth) - truth).max() + 1e-3
    rounded = model.stored_as(storage)
    rounded.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    assert np.array_equal(again(poses), rounded(poses))
    error = np.linalg.norm(rounded(poses) - truth) / np.linalg.norm(truth)
    assert error <= {"float32": 0.0, "float16": 1e-3, "int8": 2e-2, "int4": 2e-1}[storage]


def test_a_prior_of_other_receivers_is_refused(tmp_path):
    model = dataclasses.replace(random_model(receivers=39), prior=random_prior("maps"))
    model.save(tmp_path / "m.safetensors")
    with pytest.raises(PrtnetError, match="prior does not fit"):
        VisibilityModel.load(tmp_path / "m.safetensors")
