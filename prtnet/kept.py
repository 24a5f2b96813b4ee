"""What a process makes once for all its threads."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Generic, TypeVar, TypeVarTuple

__all__ = ["keeps_last"]

R = TypeVar("R")
Ts = TypeVarTuple("Ts")


class Kept(Generic[*Ts, R]):
    """See :func:`keeps_last`."""

    def __init__(self, make: Callable[[*Ts], R]) -> None:
        self._make = make
        self._lock = threading.Lock()
        self._kept: tuple[tuple[*Ts], R] | None = None
        functools.update_wrapper(self, make)

    def __call__(self, *arguments: *Ts) -> R:
        with self._lock:
            if self._kept is None or self._kept[0] != arguments:
                self._kept = None  # before there is another: each may take much memory
                self._kept = arguments, self._make(*arguments)
            return self._kept[1]


def keeps_last(make: Callable[[*Ts], R]) -> Kept[*Ts, R]:
    """A function that keeps what it gave last, for equal arguments.

    Threads that ask meanwhile wait; with ``functools.lru_cache`` each would make its own.
    """
    return Kept(make)
