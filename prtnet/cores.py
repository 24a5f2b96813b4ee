"""How many threads are worth starting, what they share, and threads that last."""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, TypeVar

__all__ = [
    "Each",
    "computing_threads",
    "core_count",
    "in_threads",
    "lasting_threads",
    "one_by_one",
    "one_thread",
    "use_blas_threads",
    "use_threads",
]

A = TypeVar("A")
B = TypeVar("B")


class Each(Protocol):
    """Does the same to every piece, and gives what comes of each in order.

    ``computing_threads(n).map`` does it in threads. Where pieces do not hang on how many there
    are of these, results do not either.
    """

    def __call__(self, work: Callable[[A], B], pieces: Iterable[A], /) -> Iterable[B]:
        """See above."""


def one_by_one(work: Callable[[A], B], pieces: Iterable[A], /) -> Iterable[B]:
    """An ``Each`` of the thread that asks."""
    return map(work, pieces)


def core_count() -> int:
    """Cores this process may use: in a container or a batch job, fewer than the machine has."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def use_threads(count: int) -> None:
    """Have torch, NumPy and SciPy compute by so many threads from now on.

    How many add up a product decides its last bits: it must be the number that was asked for, and
    that a file says it was made with, rather than the machine's.
    """
    import torch

    torch.set_num_threads(count)
    use_blas_threads(count)


def use_blas_threads(count: int) -> None:
    """The same of NumPy and SciPy alone."""
    import scipy.linalg  # noqa: F401 - brings a BLAS of its own
    from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

    threadpool_limits(count, user_api="blas")


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Have every library that is there compute by one thread: where rounding decides who wins."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


def computing_threads(count: int) -> ThreadPoolExecutor:
    """So many threads; torch computes by one in each, as NumPy and SciPy after ``use_threads(1)``.

    What torch was told in another thread, MKL heeds in a new one only after its first products.
    """
    import torch

    return ThreadPoolExecutor(count, "computing", torch.set_num_threads, (1,))


@contextlib.contextmanager
def in_threads(count: int) -> Iterator[Each]:
    """An ``Each`` of so many threads: every library computes by one in each, and beside them."""
    import torch

    before = torch.get_num_threads()
    try:
        with one_thread(), computing_threads(count) as pool:
            yield pool.map
    finally:
        torch.set_num_threads(before)


@functools.cache
def lasting_threads(count: int) -> ThreadPoolExecutor:
    """So many threads that trace, never ended: Embree keeps a kilobyte for each that ever did.

    What they run must not wait for others of them.
    """
    return ThreadPoolExecutor(count, "tracing")
