"""Fits of many clusters in threads, a run of clusters each, told of as if they were one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TypeVar

import torch
from torch import Tensor

from prtnet.cores import computing_threads

__all__ = ["OnIteration", "in_runs"]

R = TypeVar("R")
OnIteration = Callable[[int, Tensor], None]
ENDED = 1 << 62  # iterations: more than any fit has


class StoppedError(Exception):
    """Another run has failed, or nobody waits any more."""


class Teller:
    """Tells of an iteration when every run has it behind it.

    Args:
        on_iteration: is told its number, and the objective of every cluster as it is then.
        runs: how many there are.
    """

    def __init__(self, on_iteration: OnIteration | None, runs: int) -> None:
        self.on_iteration = on_iteration
        self.stopped = False
        self._lock = threading.Lock()
        self._behind = [-1] * runs
        self._values: list[Tensor] = [torch.zeros(0)] * runs
        self._told = -1

    def iteration(self, run: int, number: int, values: Tensor) -> None:
        """One is behind a run.

        Raises:
            StoppedError: it is to end.
        """
        if self.stopped:
            raise StoppedError
        with self._lock:
            self._values[run] = values
            self._advance(run, number)

    def ended(self, run: int) -> None:
        """A run has no more of them."""
        with self._lock:
            self._advance(run, ENDED)

    def _advance(self, run: int, number: int) -> None:
        self._behind[run] = number
        least = min(self._behind)
        if self._told < least < ENDED and self.on_iteration is not None:
            self._told = least
            self.on_iteration(least, torch.cat(self._values))


def in_runs(
    fit: Callable[[int, int, OnIteration], R],
    clusters: int,
    threads: int,
    on_iteration: OnIteration | None = None,
) -> list[R]:
    """Fit as many runs of clusters as there are threads, each computing by itself alone.

    So the bytes of a cluster do not depend on the number of threads, where they do not depend on
    the clusters that are fitted beside it.

    Args:
        fit: clusters from a first to before another; it calls what it is given every iteration.
        clusters: in all.
        threads: at a time.
        on_iteration: told of all of them; see :class:`Teller`.
    """
    runs = min(threads, clusters)
    ends = [clusters * run // runs for run in range(runs + 1)]
    teller, before = Teller(on_iteration, runs), torch.get_num_threads()

    def one(run: int) -> R:
        try:
            return fit(ends[run], ends[run + 1], lambda *told: teller.iteration(run, *told))
        except BaseException:
            teller.stopped = True
            raise
        finally:
            teller.ended(run)

    try:
        with computing_threads(runs) as pool:
            futures = [pool.submit(one, run) for run in range(runs)]
            try:
                found = [future.result() for future in futures]
            except BaseException as error:
                teller.stopped = True
                first = [future.exception() for future in futures]
                told = [one for one in first if not isinstance(one, StoppedError | None)]
                raise (told[0] if told and isinstance(error, StoppedError) else error) from None
    finally:
        torch.set_num_threads(before)
    return found
