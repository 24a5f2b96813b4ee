"""Every sample scene from file to ONNX: small, but the real thing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from data_gen.generate import GenerateConfig, generate
from data_gen.readers import read_scene
from prtnet.dataset import Dataset
from runtime.onnx_model import OnnxModel
from training.config import TrainConfig
from training.onnx_export import build_onnx
from training.train import train

SCENES = {
    "arm.glb": ("Bend",),
    "fox.glb": ("Walk", "Run"),
    "robot.glb": ("Robot_Dance", "Robot_Jump"),
    "human.glb": ("Walk", "RangeOfMotion"),
    "cloth_train.npz": ("cloth_train",),
}
SMALL = TrainConfig(clusters=32, neurons=6, latents=3, spheres=40, points=3, near=12, alpha=1e-2)


@pytest.fixture(scope="module", params=SCENES)
def dataset(request, shared_data, tmp_path_factory):
    out = tmp_path_factory.mktemp("sample") / "data.zarr"
    scene = read_scene(shared_data / request.param)
    clips = SCENES[request.param]
    cache = request.param.endswith(".npz")
    config = GenerateConfig(
        clips=clips, count=3 if cache else 4, rays=24, two_sided=cache, threads=2,
        sample=0 if cache else 3,
    )  # fmt: skip
    generate(scene, config, out)
    return Dataset.open(out)


@pytest.mark.parametrize(
    ("kind", "features"), [("neural", None), ("linear", None), ("neural", "joint_angles")]
)
def test_onnx_equals_the_numpy_reference(dataset, kind, features):
    config = dataclasses.replace(SMALL, kind=kind, features=features, iterations=15)
    model = train(dataset, config)
    poses = dataset.read("pose")
    run = OnnxModel(build_onnx(model).SerializeToString())
    expected = model(poses)
    assert np.isfinite(expected).all()
    assert np.ptp(expected, axis=0).max() > 0.01  # the pose matters
    for size in (1, len(poses)):
        got = np.concatenate([answer for _, answer in run.blocks(poses, size)])
        assert np.linalg.norm(got - expected) <= 2e-6 * np.linalg.norm(expected)
        # One coefficient of one receiver, where a sphere nearly touches a reference point.
        assert np.abs(got - expected).max() <= 2e-5 * np.abs(expected).max()
