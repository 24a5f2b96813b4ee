from __future__ import annotations

import dataclasses

import numpy as np
import onnxruntime
import pytest

from prtnet.gpu_tables import gpu_tables
from tests.models import random_model, random_poses
from tests.training.test_onnx_export import RELATIVE, run
from training.awake import awake, awake_clusters
from training.graph_cost import operations
from training.onnx_export import build_latent_onnx, build_onnx

FEATURES = ["joint_angles", "local_joints", "occluders"]


def asleep(kind, features, clusters, of=6, parts=2, **options):
    """A random model whose groups have two latents each, but for some clusters'."""
    model = random_model(kind, features, clusters=of, parts=parts, receivers=200, **options)
    latents = np.full((of, parts), 2, dtype=np.int32)
    latents[list(clusters)] = 0
    rows = np.arange(int(latents.sum()))
    basis = np.random.default_rng(1).normal(size=(len(rows), model.mean.shape[1]))
    return dataclasses.replace(
        model, latents=latents.ravel(), basis=basis.astype(np.float32), coding=None
    )


@pytest.mark.parametrize("kind", ["linear", "quadratic", "neural"])
@pytest.mark.parametrize("features", FEATURES)
@pytest.mark.parametrize("clusters", [(0, 3), (1, 2, 3, 4, 5), (0, 1, 2, 3, 4, 5), ()])
def test_latents_of_some_clusters_are_those_of_all(kind, features, clusters):
    parts = 1 if features == "joint_angles" and kind != "neural" else 2
    model = asleep(kind, features, clusters, parts=parts)
    poses = random_poses(5, 5)
    own = awake_clusters(model)
    groups = (own[:, None] * model.parts + np.arange(model.parts)).ravel()
    assert np.array_equal(awake(model, own).latent(poses), model.latent(poses)[:, groups])
    assert set(own) >= set(range(6)) - set(clusters)
    assert np.abs(run(model, poses) - model(poses)).max() <= RELATIVE * np.abs(model(poses)).max()


@pytest.mark.parametrize("storage", ["float32", "int8", "int4"])
@pytest.mark.parametrize("features", FEATURES)
def test_a_cluster_that_sleeps_costs_nothing_but_its_mean(features, storage):
    """As much arithmetic as in a model that never had it, and as few bytes beside the mean."""
    six, four = (
        asleep("neural", features, clusters, of=of, parts=3).stored_as(storage)
        for clusters, of in (((1, 4), 6), ((), 4))
    )
    count = int(six.latents.sum())
    protos = [build_latent_onnx(model, np.ones(count)) for model in (six, four)]
    assert operations(protos[0]) == operations(protos[1])
    assert protos[0].ByteSize() == pytest.approx(protos[1].ByteSize(), rel=0.02)
    assert operations(build_onnx(six)) < operations(
        build_onnx(asleep("neural", features, (), parts=3))
    )


def test_groups_of_one_cluster_share_its_inputs():
    """Of a linear model of a single cluster: its groups pass for clusters."""
    model = asleep("linear", "occluders", (), of=1, parts=3)
    latents = np.array([2, 0, 4], dtype=np.int32)
    model = dataclasses.replace(model, latents=latents)
    assert model.parts == 1
    poses = random_poses(3, 5)
    assert np.abs(run(model, poses) - model(poses)).max() <= RELATIVE * np.abs(model(poses)).max()


def test_latents_for_a_shader_are_in_order():
    model = asleep("neural", "occluders", (0, 3))
    poses = random_poses(3, 5)
    scale = gpu_tables(model).latent_scale
    proto = build_latent_onnx(model, np.ones_like(scale))
    used = np.arange(model.regressor.weight.shape[2]) < model.latents[:, None]
    assert run_latents(proto, poses) == pytest.approx(model.latent(poses)[:, used], abs=1e-4)


def run_latents(proto, poses):
    session = onnxruntime.InferenceSession(
        proto.SerializeToString(), providers=["CPUExecutionProvider"]
    )
    return session.run(None, {"pose": poses})[0]
