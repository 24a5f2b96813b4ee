"""What a process makes once for all its threads."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["keeps_last"]

R = TypeVar("R")


def keeps_last(make: Callable[..., R]) -> Callable[..., R]:
    """A function that keeps what it gave last, for the same arguments.

    Threads that ask while it is made wait for it; ``functools.lru_cache`` has each make its own.
    """
    made = functools.lru_cache(maxsize=1)(make)
    lock = threading.Lock()

    @functools.wraps(make)
    def get(*arguments: Any) -> R:
        with lock:
            return made(*arguments)

    return get
