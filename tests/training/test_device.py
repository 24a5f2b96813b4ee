"""The fit on another device: simulated everywhere, real where there is one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from tests.other_device import Foreign, OtherDevice
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training import regression
from training.train import train


def outcomes(**options):
    """The same training twice, on the CPU and on "cuda"."""
    config = dataclasses.replace(SMALL, features="joint_angles", **options)
    data = memory_dataset()
    data.read("visibility")[:, :15] = 1.0  # a cluster that does not vary
    return data, train(data, config), train(data, dataclasses.replace(config, device="cuda"))


OPTIONS = [
    {"kind": "constant"},
    {"kind": "linear"},  # α by cross-validation
    {"kind": "neural", "alpha": 1e-2, "restarts": 2, "iterations": 5},
    {"kind": "shared", "alpha": 1e-2, "iterations": 5, "steps": 20, "width": 6, "codes": 3,
     "patches": 9, "near_patches": 5, "near_spheres": 5, "samples": 300},
]  # fmt: skip


@pytest.mark.parametrize("options", OPTIONS, ids=lambda o: o["kind"])
def test_simulated_device_gives_what_the_cpu_gives(options, monkeypatch):
    seen = []
    fit_varying = regression.fit_varying

    def spy(inputs, targets, fit):
        seen.append(type(inputs))
        return fit_varying(inputs, targets, fit)

    monkeypatch.setattr(regression, "fit_varying", spy)
    with OtherDevice():
        data, ours, theirs = outcomes(**options)
    assert {torch.Tensor, Foreign} == set(seen)
    assert np.array_equal(ours(data.read("pose")), theirs(data.read("pose")))
    assert ours.metadata["fits"] == theirs.metadata["fits"]


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
@pytest.mark.parametrize("options", OPTIONS, ids=lambda o: o["kind"])
def test_real_device_gives_what_the_cpu_gives(options):
    data, ours, theirs = outcomes(**options)
    assert np.allclose(ours(data.read("pose")), theirs(data.read("pose")), atol=0.02)


def generator_of_the_other(x):
    torch.randn(3, generator=torch.Generator(), device="cuda")


@pytest.mark.parametrize(
    "mistake",
    [
        lambda x: x + torch.ones(3),
        lambda x: torch.ones(3).mul_(x),
        lambda x: torch.where(torch.tensor([True, False, True]), x, 0.0),
        lambda x: torch.cat([x, torch.ones(1)]),
        lambda x: x[:, None] @ torch.ones(1, 3),
        lambda x: torch.linalg.solve(torch.eye(3), x),
        lambda x: torch.cholesky_solve(x[:, None], torch.eye(3)),
        lambda x: torch.ones(3)[x.long()],
        lambda x: torch.ones(3).index_put_((x.long(),), torch.ones(3)),
        lambda x: torch.isin(x, torch.ones(2)),
        lambda x: torch.addcmul(x, torch.ones(3), x),
        lambda x: torch.zeros(3).copy_(x) + x,
        generator_of_the_other,
    ],
)
def test_simulation_refuses_what_cuda_refuses(mistake):
    with OtherDevice(), pytest.raises(RuntimeError, match=r"cuda"):
        mistake(torch.zeros(3, device="cuda"))


def test_simulation_allows_what_cuda_allows():
    with OtherDevice():
        x = torch.arange(3.0).to("cuda")
        assert isinstance(x, Foreign)
        assert x.device.type == "cuda"
        assert isinstance(x + torch.tensor(1.0), Foreign)
        assert x[torch.tensor([2])].cpu().tolist() == [2.0]
        assert x[torch.tensor([True, False, True])].tolist() == [0.0, 2.0]
        assert float(x.sum()) == 3.0
        assert isinstance(torch.zeros_like(x), Foreign)
        assert isinstance(torch.arange(3, device=x.device), Foreign)
        assert not isinstance(x.cpu(), Foreign)
        assert isinstance(torch.ones(2, dtype=torch.float64).to(x), Foreign)
        for read in (x.numpy, lambda: np.asarray(x)):
            with pytest.raises(TypeError, match="cuda:0"):
                read()
    assert not isinstance(torch.zeros(3), Foreign)
