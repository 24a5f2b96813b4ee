from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch

from prtnet import cli_train, exchange
from prtnet.errors import PrtnetError
from prtnet.exchange import Given, through
from prtnet.executor import Local
from tests.training.data import memory_dataset
from training.budget import Budget
from training.config import TrainConfig
from training.regression import FitBlock, Networks, fit_neural
from training.train import train

SMALL = TrainConfig(clusters=7, latents=3, spheres=12, points=2, near=6, iterations=20, neurons=4)
NAMES = ("weight", "bias", "hidden_weight", "hidden_bias", "loss", "iterations")


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Counting(Local):
    """Threads that know what they did, and stop after so many pieces."""

    def __init__(self, most=10**6):
        super().__init__(2)
        self.done, self.most = 0, most

    def run(self, task, numbers, ahead=1):
        for number in super().run(task, numbers, ahead):
            if self.done == self.most:
                raise PrtnetError("here", "it ends; start again")
            self.done += 1
            yield number


def problem(clusters=11):
    generator = torch.Generator().manual_seed(1)
    x = torch.randn(clusters, 60, 9, generator=generator)
    t = torch.tanh(x @ torch.randn(clusters, 9, 5, generator=generator))
    t[3] = 2.0  # a cluster that does not vary
    return x, t


@pytest.mark.parametrize("threads", [1, 2])
def test_blocks_have_the_bytes_of_one_batch(tmp_path, threads):
    x, t = problem()
    told = []
    torch.set_num_threads(threads)
    wanted = fit_neural(x, t, 6, 1e-3, 10, seed=4, restarts=2)
    with through(Local(2), tmp_path / "fits"):
        found = fit_neural(x, t, 6, 1e-3, 10, 4, lambda i, losses: told.append((i, len(losses))), 2)
    assert all(torch.equal(getattr(found, name), getattr(wanted, name)) for name in NAMES)
    assert found.status == wanted.status
    assert told == [(9, 4), (19, 8), (29, 10)]  # ten clusters vary; 10 + 2 · 10 iterations
    assert list(tmp_path.iterdir()) == []


def test_a_model_with_cross_validation_has_the_same_bytes_after_an_end_in_the_middle(tmp_path):
    data = memory_dataset(per_clip=6)
    train(data, SMALL).save(tmp_path / "here")
    tasks = Counting(most=9)
    with pytest.raises(PrtnetError, match="it ends"), through(tasks, tmp_path / "fits"):
        train(data, SMALL)
    again = Counting()
    with through(again, tmp_path / "fits"):
        train(data, SMALL).save(tmp_path / "far")
    assert (tmp_path / "far").read_bytes() == (tmp_path / "here").read_bytes()
    assert 0 < again.done <= 22 - 9  # two blocks of all poses, and of two folds of five α
    assert sorted(path.name for path in tmp_path.iterdir()) == ["far", "here"]


def test_other_versions_begin_anew(tmp_path, monkeypatch):
    x, t = problem(clusters=4)
    for version, done in (("1", 1), ("1", 0), ("2", 1)):
        monkeypatch.setattr(exchange, "made_with", lambda *_, version=version: {"torch": version})
        monkeypatch.setattr(exchange, "remove_place", lambda _: None)
        tasks = Counting()
        with through(tasks, tmp_path):
            fit_neural(x, t, 3, 1e-3, 4)
        assert tasks.done == done


def test_a_machine_without_the_folder(tmp_path):
    with pytest.raises(PrtnetError, match="cannot be read; start again; on a cluster"):
        FitBlock(Networks(3, 1e-3), 4)(0, Given(tmp_path / "none"))


def test_a_cluster_that_has_nothing_to_do_is_refused():
    def check(budget=None, **options):
        told = []
        config = dataclasses.replace(SMALL, **options)
        cli_train.check_cluster("tcp://a:1", None, config, budget or Budget(), told.append)
        return told

    linear = dataclasses.replace(SMALL, kind="linear")
    cli_train.check_cluster(None, None, linear, Budget(), print)
    with pytest.raises(PrtnetError, match="--exchange: does nothing for a linear model"):
        cli_train.check_cluster(None, Path("a"), linear, Budget(), print)
    assert check() == check(kind="lobes", regressor="neural") == []
    assert check(Budget(max_error=0.1), kind="linear") == check(kind="auto") == []
    for options in ({"kind": "linear"}, {"kind": "lobes"}, {"kind": "shared", "latents": 0}):
        with pytest.raises(PrtnetError, match=r"does nothing for a .* model without networks"):
            check(**options)
    assert "what all receivers of a shared model share" in check(kind="shared")[0]
    with pytest.raises(PrtnetError, match="no say in fits that are handed over"):
        check(device="cuda")
