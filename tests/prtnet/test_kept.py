from __future__ import annotations

import threading
import time
import weakref
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from prtnet.kept import keeps_last


def test_threads_share_what_is_made_once() -> None:
    made: list[int] = []
    ready = threading.Barrier(4)

    @keeps_last
    def slow(number: int) -> list[int]:
        """What it says."""
        time.sleep(0.05)
        made.append(number)
        return [number]

    def ask(number: int) -> list[int]:
        ready.wait()
        return slow(number)

    assert slow.__doc__ == "What it says."
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(ask, [7] * 4))
    assert made == [7]
    assert all(one is found[0] for one in found)
    slow(8)
    assert slow(8) is not slow(7)  # one is kept at a time
    assert made == [7, 8, 7]


def test_what_was_kept_goes_before_another_is_made() -> None:
    class Large:
        """Something that can be watched."""

    left: list[Any] = []

    @keeps_last
    def large(number: int) -> Large:
        left.append([one() for one, _ in left])
        left[-1] = (weakref.ref(made := Large()), left[-1])
        return made

    large(1)
    large(2)
    assert left[1][1] == [None]


def test_what_fails_is_tried_again() -> None:
    left = [OSError("no disk"), None]

    @keeps_last
    def shaky() -> str:
        if error := left.pop(0):
            raise error
        return "made"

    with pytest.raises(OSError, match="no disk"):
        shaky()
    assert shaky() == shaky() == "made"
