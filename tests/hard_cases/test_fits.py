"""Fits that have too little, too much or nothing finite to go by."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
import torch

from prtnet.cores import divided
from prtnet.metrics import relative_rms
from prtnet.storage import STORAGES
from runtime.onnx_model import OnnxModel
from tests.hard_cases.measured import above, at_least, at_most, below, close, equal, finite, refuses
from tests.hard_cases.test_training import fitted
from tests.models import random_model, random_poses
from tests.training.data import memory_dataset
from tests.training.test_regression import problem
from tests.training.test_train import SMALL
from training import regression
from training.onnx_export import build_onnx
from training.regression import fit_linear, fit_neural
from training.train import train

FITS = [fit_linear, lambda x, t, alpha: fit_neural(x, t, 6, alpha, iterations=15)]
KINDS = list(itertools.product(["linear", "neural"], ["joint_angles", "occluders"]))
HALF = float(np.finfo(np.float16).max)


@pytest.fixture
def given(dtype, device):
    """Inputs and targets in every precision, everywhere."""
    return lambda **options: [
        each.to(device) for each in problem(dtype=getattr(torch, dtype), **options)
    ]


@pytest.mark.parametrize("fit", FITS, ids=["linear", "neural"])
@pytest.mark.parametrize("level", [0.0, 3.5449077, 1e-20, 1e6])
def test_constant_clusters_are_left_out(fit, level, dtype, monkeypatch):
    """They predict their constant, and the others are fitted as if they were not there."""
    x, t = problem(clusters=4, dtype=getattr(torch, dtype))
    t[1] = level
    seen = []
    solve = regression.solve_ridge

    def spy(full, *rest):
        seen.append(len(full))
        return solve(full, *rest)

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # all clusters are one run
    try:
        with monkeypatch.context() as patch:
            patch.setattr(regression, "solve_ridge", spy)
            result = fit(x, t, 1e-3)
    finally:
        torch.set_num_threads(threads)
    assert max(seen) == 3
    equal(result(x)[1], t[1].mean(0).expand_as(t[1]))
    assert result.status[1] == "constant"
    assert int(result.iterations[1]) == 0
    others = [0, 2, 3]
    alone = fit(x[others], t[others], 1e-3)
    equal(result(x)[others], alone(x[others]))


@pytest.mark.parametrize("fit", FITS, ids=["linear", "neural"])
def test_nothing_varies(fit, given):
    x, t = given(clusters=2)
    result = fit(x, torch.zeros_like(t), 1e-3)
    equal(result(x), 0)
    assert result.status == ["constant"] * 2


@pytest.mark.parametrize("fit", FITS, ids=["linear", "neural"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("which", ["inputs", "targets"])
def test_numbers_that_are_not_finite_are_told(fit, bad, which, given):
    x, t = given()
    (x if which == "inputs" else t)[2, 5, 1] = bad
    with refuses(match=f"training data: cluster 2 has {which} that are not"):
        fit(x, t, 1e-3)


@pytest.mark.parametrize("fit", FITS, ids=["linear", "neural"])
def test_a_fit_that_overflows_harms_no_other_and_predicts_the_mean(fit, given, dtype):
    """Inputs whose squares are too large for the precision."""
    x, t = given()
    x[1] *= {"float32": 1e30, "float64": 1e200}[dtype]
    result = fit(x, t, 1e-3)
    assert result.status[1] == "not finite"
    close(result(x)[1], t[1].mean(0).expand_as(t[1]), {"float32": 1e-5, "float64": 1e-13}[dtype])
    others = [0, 2]
    without = x.clone()
    without[1] = 0.0
    expected = fit(without, t, 1e-3)(without)[others]
    # Batches round differently.
    close(result(x)[others], expected, atol={"float32": 1e-2, "float64": 1e-9}[dtype])


@pytest.mark.parametrize("fit", FITS, ids=["linear", "neural"])
@pytest.mark.parametrize("alpha", [0.0, 1e-3])
def test_rank_deficient_cluster_among_sound_ones(fit, alpha, given, dtype):
    """All inputs of one cluster are the same column: the others' fit is as good as alone."""
    x, t = given()
    x[0] = x[0, :, :1]
    result = fit(x, t, alpha)
    finite(result(x))
    below(result.weight.abs().max(), {"float32": 1e3, "float64": 1e6}[dtype])  # as rounding lets
    signal = (t - t.mean(1, keepdim=True)).square().sum((1, 2))
    below((result(x) - t).square().sum((1, 2)), signal)


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_a_joint_that_moves_only_in_held_out_clips(kind, features, device):
    data = memory_dataset()
    poses = data.read("pose").reshape(-1, 4, 3, 4)
    seen, unseen = data.training_poses(), data.held_out_poses()
    poses[seen, 2, :, :3] = poses[seen, 1, :, :3]  # at rest on its parent
    model = fitted(data, kind, features, device=device)
    truth = data.read("visibility", unseen)
    mean = np.broadcast_to(model.training_mean, truth.shape)
    answer = model(data.read("pose", unseen))
    below(relative_rms(answer, truth), 1.05 * relative_rms(mean, truth))
    if features == "joint_angles":
        assert model.metadata["dropped_joints"] == ["joint2"]
        still = poses[unseen].copy()
        still[:, 3, :, :3] = still[:, 2, :, :3]  # what joint 3 tells is told relative to joint 2
        moved = still.copy()
        turn = np.diag([1.0, -1.0, -1.0]).astype(np.float32)
        moved[:, 2:, :, :3] = moved[:, 2:, :, :3] @ turn
        told = [model(p.reshape(len(unseen), -1)) for p in (still, moved)]
        close(told[0], told[1], atol=1e-5)


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_lit_and_dark_clusters_beside_others(kind, features, device):
    data = memory_dataset()
    levels = {0: 3.5449, 1: 0.0}
    owner = np.arange(60) * 4 // 60
    for joint, level in levels.items():
        data.read("visibility")[:, owner == joint] = level
    model = fitted(data, kind, features, device=device)
    constant = [c for c, own in enumerate(model.latents) if own == 0]
    at_least(len(constant), 1)
    for cluster in constant:
        own = model.receivers[cluster][model.receivers[cluster] >= 0]
        predicted, truth = model(data.read("pose"))[:, own], data.read("visibility")[:, own]
        close(predicted, truth, atol=1e-5)


@pytest.mark.parametrize(("kind", "features"), KINDS)
def test_inputs_ten_times_outside_the_training_range(kind, features, device):
    data = memory_dataset()
    model = fitted(data, kind, features, device=device)
    pose = data.read("pose")
    finite(model(pose.mean(0) + 10.0 * (pose - pose.mean(0))))


@pytest.mark.parametrize(("kind", "features"), KINDS)
@pytest.mark.parametrize("extreme", [HALF, -HALF, 6e-8, 1e-40])
def test_half_precision_extremes(kind, features, extreme):
    """The largest and the subnormal numbers of float16, and a subnormal of float32."""
    data = memory_dataset()
    data.read("pose")[1::3, 7::12] = extreme
    data.read("visibility")[::2, 3] = extreme
    model = train(data, dataclasses.replace(SMALL, kind=kind, features=features))
    poses = np.concatenate([data.read("pose"), random_poses(5, 4, seed=9)])
    for storage in STORAGES:
        stored = model.stored_as(storage)
        answer = stored(poses)
        finite(answer)
        graph = OnnxModel(build_onnx(stored).SerializeToString(), threads=1)
        finite(graph(poses))


@pytest.mark.parametrize("magnitude", [6e-8, 1e-3, 65504.0, 1e8])
def test_half_precision_keeps_models_of_any_magnitude(magnitude):
    """What is stored in halves has scales beside it, so that neither end of them is reached."""
    model = random_model(receivers=300)
    rows = {name: getattr(model, name) * np.float32(magnitude) for name in ("mean", "basis")}
    model = dataclasses.replace(model, **rows)
    poses = random_poses(4, 5)
    expected, answer = model(poses), model.stored_as("float16")(poses)
    # Means are kept as deviations from a half-open hemisphere.
    bound = 3e-3 * np.linalg.norm(expected) + 1e-3 * expected.size**0.5
    below(np.linalg.norm(answer - expected), bound)


def test_restarts_keep_the_best(dtype):
    """Per cluster: each goes on from the start that was best for it."""
    x, t = problem(clusters=6, poses=40, inputs=6, latents=3, dtype=getattr(torch, dtype))
    objective = regression.projected_objective(x, t / regression.target_scale(t), 4, 1e-3)
    generator = torch.Generator().manual_seed(0)
    starts = [torch.randn(6, 28, generator=generator, dtype=x.dtype) for _ in range(4)]
    best, _ = regression.best_start(objective, starts, 10, None)
    each = [regression.minimise(objective, start, iterations=10).value for start in starts]
    everyone = torch.arange(6)
    equal(objective(best, everyone)[0], torch.stack(each).amin(0))
    above(len(torch.stack(each).argmin(0).unique()), 1)  # no one start is best for all
    short, long = (fit_neural(x, t, 4, 1e-3, count, restarts=3) for count in (1, 60))
    at_most(long.loss, short.loss)
    steps = []
    fit_neural(x, t, 4, 1e-3, 5, on_iteration=lambda i, _: steps.append(i), restarts=3)
    assert steps == list(range(20))
    assert regression.total_iterations(5, 3) == 20


@pytest.mark.parametrize(("latents", "neurons"), [(1, 0), (1, 8), (4, 1), (1, 1)])
def test_a_single_column_has_the_same_bytes_in_runs_of_any_size(latents, neurons, monkeypatch):
    """Torch rounds products of one column by how many matrices there are."""
    generator = torch.Generator().manual_seed(2)
    x = torch.randn(8, 300, 10, generator=generator)
    t = torch.tanh(x[..., :3] @ torch.randn(8, 3, latents, generator=generator))
    monkeypatch.setattr(regression, "RUN", 1)
    found = []
    for threads in (1, 2, 4, 8):
        with divided(threads):
            every = fit_neural(x, t, neurons, 1e-3, 12) if neurons else fit_linear(x, t, 1e-3)
        found.append(every)
    for other in found[1:]:
        equal(other(x), found[0](x))
        equal(other.loss, found[0].loss)
