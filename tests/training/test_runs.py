"""Runs of clusters beside each other, told of as one."""

from __future__ import annotations

import threading
from typing import Any

import pytest
import torch

from training.runs import OnIteration, in_runs


def counted(first: int, end: int, told: OnIteration) -> tuple[int, int, int]:
    """A fit of as many iterations as its last cluster's number."""
    for number in range(end):
        told(number, torch.arange(first, end).float())
    return first, end, torch.get_num_threads()


@pytest.mark.parametrize("threads", [1, 2, 3, 9])
def test_every_cluster_is_fitted_once_by_one_thread(threads: int) -> None:
    before, told = torch.get_num_threads(), []
    found = in_runs(counted, 7, threads, lambda number, values: told.append((number, values)))
    assert [cluster for first, end, _ in found for cluster in range(first, end)] == list(range(7))
    assert len(found) == min(threads, 7)
    assert {count for *_, count in found} == {1}
    assert torch.get_num_threads() == before
    numbers = [number for number, _ in told]
    assert numbers == sorted(set(numbers))  # each is behind all runs
    assert all(len(values) == 7 for _, values in told)
    assert in_runs(counted, 7, threads) == found


def test_a_run_that_fails_ends_the_others() -> None:
    began = threading.Barrier(2)

    def fit(first: int, _: int, told: OnIteration) -> None:
        began.wait(10.0)
        for number in range(10**9 if first == 0 else 3):
            told(number, torch.zeros(1))
        raise ValueError("no fit today")

    with pytest.raises(ValueError, match="no fit today"):
        in_runs(fit, 2, 2)


def test_who_is_told_may_end_it() -> None:
    def stop(number: int, _: Any) -> None:
        if number == 0:  # the only one that is sure to be told
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        in_runs(counted, 4, 2, stop)
