from __future__ import annotations

import itertools
import json

import moderngl
import numpy as np
import onnxruntime
import pytest

from prtnet.errors import PrtnetError
from prtnet.gpu_tables import COUNT_BITS, gpu_tables
from prtnet.storage import STORAGES
from tests.models import random_model, random_poses
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
    for name, texture in layout["textures"].items():
        if "byte_offset" in texture:
            end = texture["byte_offset"] + texture["byte_length"]
            flat = np.frombuffer(data[texture["byte_offset"] : end], texture["dtype"])
            found[name] = flat.reshape(texture["shape"])
    return found, layout


def latents_of(folder, poses):
    session = onnxruntime.InferenceSession(
        folder / "latent.onnx", providers=["CPUExecutionProvider"]
    )
    return session.run(["latents"], {"pose": poses})[0]


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
    latents = latents_of(folder, poses)
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


SHADER = """#version 330
%s
out vec4 v0;
out vec4 v1;
out vec4 v2;
void main() {
    vec4 v[PRTNET_TEXELS];
    prtnet_visibility(gl_VertexID, v);
    v0 = v[0];
    v1 = v[1];
    v2 = v[2];
}
"""
SIGNED_NORMALISED = {"RGBA8_SNORM": 0x8F97}  # moderngl would make it unsigned
UPLOADS = {"RGBA8_SNORM": "ni1", "RGBA16F": "f2", "RGBA32F": "f4", "RG32UI": "u4", "R32F": "f4"}


@pytest.mark.gl
def test_the_shader_gives_the_models_visibility(exported):
    model, folder = exported
    pose = random_poses(1, 5)
    expected = model(pose)[0]
    found, layout = textures(folder)
    padded = np.zeros(layout["textures"]["prtnet_latents"]["shape"], dtype=np.float32)
    padded.ravel()[: layout["latents"]] = latents_of(folder, pose)[0]
    context = moderngl.create_context(standalone=True, backend="egl", require=330)
    with context:
        context.simple_framebuffer((1, 1)).use()  # OpenGL wants one even where nothing is drawn
        program = context.program(
            vertex_shader=SHADER % (folder / "prtnet.glsl").read_text(),
            varyings=["v0", "v1", "v2"],
        )
        for unit, (name, data) in enumerate((found | {"prtnet_latents": padded}).items()):
            texel = layout["textures"][name]["format"]
            texture = context.texture(
                data.shape[1::-1], data.shape[2], data.tobytes(), dtype=UPLOADS[texel],
                internal_format=SIGNED_NORMALISED.get(texel),
            )  # fmt: skip
            texture.filter = (moderngl.NEAREST, moderngl.NEAREST)
            texture.use(unit)
            program[name] = unit
        buffer = context.buffer(reserve=model.receiver_count * 12 * 4)
        context.vertex_array(program, []).transform(
            buffer, moderngl.POINTS, vertices=model.receiver_count
        )
        got = np.frombuffer(buffer.read(), np.float32).reshape(-1, 12)
    context.release()
    assert np.abs(got[:, :9] - expected).max() <= RELATIVE * np.abs(expected).max()
    assert (got[:, 9:] == 0).all()
