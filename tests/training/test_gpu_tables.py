from __future__ import annotations

import itertools
import json

import numpy as np
import onnxruntime
import pytest

from prtnet.errors import PrtnetError
from prtnet.glsl import texture
from prtnet.gpu_tables import COUNT_BITS, glsl, gpu_tables
from prtnet.storage import STORAGES
from tests.models import random_model, random_poses
from tests.priors import beside_prior, random_prior, sheet_with_prior
from tests.runtime.shader import DESKTOP, WEB, latents_of, transformed
from tests.skin import random_skin
from training.export import export_folder

METADATA = {"scene_name": "ball", "scene_kind": "skinned"}
RELATIVE = 1e-5  # float32 through a few hundred multiply-adds


@pytest.fixture(params=itertools.product(("neural", "quadratic"), STORAGES))
def exported(request, tmp_path):
    """A model, and the folder exported of it."""
    kind, storage = request.param
    model = random_model(kind, receivers=700, clusters=7, parts=2).stored_as(storage)
    model.metadata.update(METADATA)
    export_folder(model, tmp_path / "export")
    return model, tmp_path / "export"


def textures(folder):
    """Every texture that the manifest names, and the manifest."""
    layout = json.loads((folder / "gpu.json").read_text())
    data = (folder / layout["file"]).read_bytes()
    found = {}
    for name, own in layout["textures"].items():
        if "byte_offset" in own:
            end = own["byte_offset"] + own["byte_length"]
            flat = np.frombuffer(data[own["byte_offset"] : end], own["dtype"])
            found[name] = flat.reshape(own["shape"])
    return found, layout


def onnx_output(path, poses):
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    return session.run(None, {"pose": poses})[0]


def emulate(folder, latents, order):
    """What the shader does with one pose's latents, receiver by receiver, of the files alone."""
    found, layout = textures(folder)
    rows = found["prtnet_rows"].reshape(-1, 4)
    if rows.dtype == np.int8:
        rows = rows / 127
    entries = found["prtnet_receivers"].reshape(-1, 2).tolist()
    receivers = json.loads((folder / "model.json").read_text())["receivers"]
    texels = -(-(order**2) // 4)
    result = np.empty((receivers, order**2))
    for receiver, (texel, packed) in enumerate(entries[:receivers]):
        first, count = packed >> layout["count_bits"], packed % 2 ** layout["count_bits"]
        own = rows[texel : texel + (1 + count) * texels].reshape(1 + count, -1)[:, : order**2]
        mean = layout["mean_offset"] + np.array(layout["mean_scale"]) * own[0]
        sums = latents[first : first + count] @ own[1:].astype(np.float64)
        result[receiver] = mean + layout["profile"] * sums
    return result


def test_files_alone_give_the_models_visibility(exported):
    model, folder = exported
    poses = random_poses(2, 5)
    expected = model(poses)
    latents = onnx_output(folder / "latent.onnx", poses)
    assert latents.shape == (2, model.latents.sum())
    for pose in range(2):
        got = emulate(folder, latents[pose], model.order)
        assert np.abs(got - expected[pose]).max() <= RELATIVE * np.abs(expected).max()


def test_bytes_are_those_of_the_storage(exported):
    model, folder = exported
    rows = textures(folder)[0]["prtnet_rows"]
    size = {"float32": 4, "float16": 2, "int8": 1, "int4": 1}[model.storage]
    assert rows.itemsize == size
    counts = model.latents[model.slot_of_receiver // model.receivers.shape[1]]
    used = int((1 + counts).sum()) * 12 * size  # nine coefficients take three texels
    assert used <= rows.nbytes < used + 2048 * 4 * size


def test_a_constant_model_has_means_alone(tmp_path):
    model = random_model("constant").stored_as("int8")
    model.metadata.update(METADATA)
    export_folder(model, tmp_path / "export")
    assert not (tmp_path / "export" / "latent.onnx").exists()
    got = emulate(tmp_path / "export", np.zeros(0), model.order)
    expected = model(random_poses(1, 5))[0]
    assert np.abs(got - expected).max() <= RELATIVE * np.abs(expected).max()


def test_more_latents_than_an_entry_counts_are_refused():
    model = random_model()
    model.latents[0] = 2**COUNT_BITS
    with pytest.raises(PrtnetError, match="too many latents"):
        gpu_tables(model)


@pytest.mark.gl
def test_the_shader_gives_the_models_visibility(exported):
    model, folder = exported
    pose = random_poses(1, 5)
    assert shader_error(model, folder, pose) <= RELATIVE


@pytest.mark.gl
@pytest.mark.parametrize("kind", ["maps", "network"])
@pytest.mark.parametrize("body", ["skin", "sheet", "skin without latents"])
@pytest.mark.parametrize("storage", ["float32", "int8"])
def test_files_alone_tell_the_shader_of_the_surroundings(kind, body, storage, tmp_path):
    if body == "sheet":
        model, poses = sheet_with_prior(kind)
    else:
        seen = random_skin(receivers=300)
        prior = random_prior(kind, receivers=300, surroundings=seen)
        fitted = "constant" if body == "skin without latents" else "neural"
        model, poses = beside_prior(random_model(fitted, receivers=300), prior, True), None
    model = model.stored_as(storage)
    model.metadata.update(METADATA)
    folder = tmp_path / "export"
    files = export_folder(model, folder)
    assert ("latent.onnx" in files) == (body != "skin without latents")
    pose = random_poses(1, 5, seed=3) if poses is None else poses[-1:]
    assert shader_error(model, folder, pose) <= RELATIVE
    words = (folder / "README.md").read_text()
    names = json.loads((folder / "gpu.json").read_text())["textures"]
    assert [name for name in names if f"`{name}`" not in words] == []
    assert "{" not in words


@pytest.mark.gl
@pytest.mark.parametrize("lobes", [1, 2, 3])
@pytest.mark.parametrize("kind", ["constant", "linear", "neural"])
@pytest.mark.parametrize("storage", ["float32", "float16", "int8"])
def test_files_alone_tell_the_shader_of_lobes(lobes, kind, storage, tmp_path):
    model = random_model(kind, receivers=300, parts=2, lobes=lobes).stored_as(storage)
    model.metadata.update(METADATA)
    folder = tmp_path / "export"
    export_folder(model, folder)
    assert shader_error(model, folder, random_poses(1, 5, seed=3)) <= RELATIVE
    assert json.loads((folder / "gpu.json").read_text())["lobes"] == lobes
    assert json.loads((folder / "model.json").read_text())["lobes"] == lobes
    words = (folder / "README.md").read_text()
    assert f"Those {1 + 5 * lobes} numbers stand for the {lobes} zonal lobes" in words
    assert "{" not in words


@pytest.mark.gl
@pytest.mark.parametrize("head", [DESKTOP, WEB])
def test_the_shader_gives_lobes(head):
    """Axes and coefficients themselves; receivers without a direction among them."""
    model = random_model("linear", receivers=300, lobes=2)
    model.basis[:, : model.numbers] = model.mean[:, : model.numbers] = 0.0
    pose = random_poses(1, 5)
    lobes = model.lobes_of(pose)
    expected = np.concatenate([lobes.axes, lobes.coefficients], axis=-1).reshape(300, 12)
    tables = gpu_tables(model)
    latents = {"prtnet_latents": texture(latents_of(model, tables, pose[0])[:, None])}
    text = glsl(tables).replace("prtnet_visibility", "unused") + LISTED
    got = transformed(text, tables.textures, [latents], 300, 3, head)[0]
    assert np.abs(got - expected).max() <= RELATIVE * np.abs(expected).max()
    assert (np.abs(got).sum(axis=1) > 1.9).all()  # two unit axes each


LISTED = """
void prtnet_visibility(highp int receiver, out highp vec4 v[PRTNET_TEXELS]) {
    highp vec3 axis[PRTNET_LOBES];
    highp float g[PRTNET_LOBES * PRTNET_ORDER];
    prtnet_lobes(receiver, axis, g);
    v[0] = vec4(axis[0], g[0]);
    v[1] = vec4(g[1], g[2], axis[1].xy);
    v[2] = vec4(axis[1].z, g[3], g[4], g[5]);
}
"""


def shader_error(model, folder, pose):
    """Of what the exported shader gives for a pose (1, D), relative to the largest coefficient."""
    expected = model(pose)[0]
    found, layout = textures(folder)
    posed = {}
    for name, file in (("prtnet_latents", "latent.onnx"), ("prtnet_prior_pose", "occluders.onnx")):
        if name in layout["textures"]:
            posed[name] = np.zeros(layout["textures"][name]["shape"], dtype=np.float32)
            if (folder / file).exists():
                values = onnx_output(folder / file, pose).ravel()
                posed[name].ravel()[: values.size] = values
    text = (folder / "prtnet.glsl").read_text()
    got = transformed(text, found, [posed], model.receiver_count, -(-(model.order**2) // 4))[0]
    return np.abs(got[:, : model.order**2] - expected).max() / np.abs(expected).max()
