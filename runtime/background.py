"""What takes longer than a frame is made beside the frames, in threads that last."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from typing import Any, Generic, TypeVar

__all__ = ["TRACERS", "Background"]

T = TypeVar("T")

NICE = 10  # of 19


def step_back() -> None:
    """Let this thread, and those that it begins, have what the frames leave of the processors."""
    if sys.platform.startswith("linux"):  # elsewhere threads have no priority of this kind
        own = threading.get_native_id()
        with contextlib.suppress(OSError):  # it is not allowed everywhere
            was = os.getpriority(os.PRIO_PROCESS, own)
            os.setpriority(os.PRIO_PROCESS, own, max(was, NICE))


# More threads than a viewer makes things at once; and those that trace, which goes on for what is
# not shown any more, so that nothing else waits for them.
WORKERS = ThreadPoolExecutor(8, "background", step_back)
TRACERS = ThreadPoolExecutor(8, "truth", step_back)


class Background(Generic[T]):
    """The last thing asked for, made beside the frames; one at a time.

    Args:
        workers: threads that make it.
    """

    def __init__(self, workers: Executor = WORKERS) -> None:
        self.workers = workers
        self.key: Any = None
        self.future: Future[T] | None = None

    @property
    def busy(self) -> bool:
        """Whether something is being made."""
        return self.future is not None and not self.future.done()

    @property
    def unheard(self) -> bool:
        """Whether what was made ended in an error that nobody has been told yet."""
        done = self.future is not None and self.future.done()
        return done and self.future is not None and self.future.exception() is not None

    def get(self, key: Any, make: Callable[[], T], wait: bool = False) -> T | None:
        """What is asked for; None while it is being made, or something else still is.

        An error is raised once: what is asked for again is made again.
        """
        if wait and self.future is not None and self.key != key:
            self.future.exception()  # done with, whatever came of it
        self.begin(key, make)
        future = self.future
        if future is None or self.key != key or not (wait or future.done()):
            return None
        if future.exception() is not None:
            self.key = self.future = None
        return future.result()

    def begin(self, key: Any, make: Callable[[], T]) -> None:
        """Ask for something, unless something else is being made."""
        if self.key != key and not self.busy:
            self.key, self.future = key, self.workers.submit(make)

    def known(self, key: Any) -> T | None:
        """What was asked for under this key if it is there; nothing is begun."""
        done = self.future is not None and self.key == key and self.future.done()
        if not done or self.future is None or self.future.exception() is not None:
            return None
        return self.future.result()

    def cancelled(self) -> bool:
        """Let what is not begun be, and tell whether it was not."""
        return self.future is not None and self.future.cancel()

    def release(self) -> None:
        """Forget what was made; what is being made is waited for."""
        if self.future is not None and not self.cancelled():
            self.future.exception()
        self.key = self.future = None
