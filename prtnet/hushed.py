"""Silence for libraries that complain of damaged files on the streams of the whole process."""

from __future__ import annotations

import contextlib
import io
import os
import threading
from collections.abc import Iterator

__all__ = ["hushed"]

LOCK = threading.RLock()


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """What C and Python write to the process's output and error streams meanwhile is lost."""
    kept: dict[int, int] = {}
    LOCK.acquire()  # the streams are the process's
    try:
        with open(os.devnull, "wb") as nothing:
            for stream in (1, 2):
                with contextlib.suppress(OSError):  # one that is closed
                    kept[stream] = os.dup(stream)
                    os.dup2(nothing.fileno(), stream)
        with contextlib.redirect_stdout(io.StringIO()):
            yield
    finally:
        for stream, own in kept.items():
            os.dup2(own, stream)
            os.close(own)
        LOCK.release()
