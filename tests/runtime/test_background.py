"""What is made in a thread of its own, and fails there."""

from __future__ import annotations

import threading

import pytest

from runtime.background import Background


def test_an_error_is_told_once_and_what_is_wanted_again_is_made_again():
    made: list[int] = []

    gate = threading.Event()

    def make() -> int:
        gate.wait()
        made.append(len(made))
        if len(made) == 1:
            raise ValueError("not today")
        return made[-1]

    task: Background[int] = Background()
    assert task.get("a", make) is None
    gate.set()
    assert task.future is not None
    task.future.exception()
    assert task.unheard
    assert task.known("a") is None
    with pytest.raises(ValueError, match="not today"):
        task.get("a", make)
    assert not task.unheard
    assert task.get("a", make, wait=True) == 1
    assert task.get("a", make) == 1
    assert made == [0, 1]
    task.release()
