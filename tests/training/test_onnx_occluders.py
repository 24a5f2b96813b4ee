"""The graph that fills the texture of a prior's occluders, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from prtnet.gpu_tables import gpu_tables
from runtime.onnx_model import OnnxPart
from tests.models import random_model, random_poses
from tests.priors import beside_prior, random_prior, sheet_with_prior
from training.onnx_occluders import build_occluder_onnx

ABSOLUTE = 1e-6  # of lengths in units of the body: float32


def check(model, poses):
    expected = np.stack([gpu_tables(model).prior.seen.posed(pose) for pose in poses])
    graph = OnnxPart(build_occluder_onnx(model).SerializeToString(), threads=1)
    given = graph(poses)
    assert given.shape == expected.shape
    assert expected.shape[1] == gpu_tables(model).prior.seen.posed_texels
    assert np.abs(given - expected).max() <= ABSOLUTE * np.abs(expected).max()
    assert np.ptp(expected, axis=0).max() > 0.1


@pytest.mark.parametrize("morphs", [0, 2])
def test_occluders_of_a_skin(morphs):
    model = beside_prior(random_model(morphs=morphs), random_prior("maps"))
    check(model, random_poses(3, 5, morphs))


@pytest.mark.parametrize("away", [0.0, 512.0])
@pytest.mark.parametrize("two_sided", [False, True])
def test_occluders_of_a_sheet(two_sided, away):
    model, poses = sheet_with_prior("maps", two_sided)
    check(model, np.round((poses + away) * 4096) / np.float32(4096))  # what float32 keeps out there


def test_a_model_without_a_prior_has_none():
    with pytest.raises(TypeError, match="no occluders of NoneType"):
        build_occluder_onnx(random_model())
