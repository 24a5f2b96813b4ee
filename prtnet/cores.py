"""How many threads are worth starting, what they share, and threads that last."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar
from typing import Protocol, TypeVar

__all__ = [
    "Each",
    "computing_threads",
    "core_count",
    "divided",
    "in_threads",
    "lasting_threads",
    "one_by_one",
    "one_thread",
    "side_by_side",
    "thread_count",
    "use_blas_threads",
    "use_threads",
]

A = TypeVar("A")
B = TypeVar("B")
COUNT: ContextVar[int | None] = ContextVar("COUNT", default=None)
DIVIDED: ContextVar[bool] = ContextVar("DIVIDED", default=False)


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


def thread_count() -> int:
    """Threads for pieces of work: as :func:`side_by_side` says; else torch's; else one a core."""
    torch = sys.modules.get("torch")
    return COUNT.get() or (core_count() if torch is None else torch.get_num_threads())


@contextlib.contextmanager
def side_by_side(count: int) -> Iterator[None]:
    """Inside, so many pieces of work are computed at a time."""
    token = COUNT.set(count)
    try:
        yield
    finally:
        COUNT.reset(token)


@contextlib.contextmanager
def divided(count: int) -> Iterator[None]:
    """Inside, only pieces of work are done side by side, so many: libraries compute by one thread.

    So no sum depends on the number of threads. In one thread of the process at a time: what
    libraries are told holds for all.
    """
    if DIVIDED.get():
        with side_by_side(count):
            yield
        return
    with contextlib.ExitStack() as stack:
        stack.callback(DIVIDED.reset, DIVIDED.set(True))
        stack.enter_context(side_by_side(count))
        torch = sys.modules.get("torch")
        if torch is not None:
            stack.callback(torch.set_num_threads, torch.get_num_threads())
        stack.enter_context(one_thread())
        if torch is not None:
            torch.set_num_threads(1)  # MKL, too, which threadpoolctl need not see
        yield


@contextlib.contextmanager
def in_threads() -> Iterator[Each]:
    """An ``Each`` of :func:`thread_count` threads, :func:`divided`."""
    import torch  # noqa: F401 - before it is told of threads

    count = thread_count()
    with divided(count), computing_threads(count) as pool:
        yield pool.map


@functools.cache
def lasting_threads(count: int) -> ThreadPoolExecutor:
    """So many threads that trace, never ended: Embree keeps a kilobyte for each that ever did.

    What they run must not wait for others of them.
    """
    return ThreadPoolExecutor(count, "tracing")
