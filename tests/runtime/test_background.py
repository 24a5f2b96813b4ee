"""What is made beside the frames, and fails there."""

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


def test_what_is_given_back_is_forgotten_and_waited_for():
    begun, gate, made = threading.Event(), threading.Event(), []

    def make() -> str:
        begun.set()
        gate.wait(5.0)
        made.append("a")
        return "a"

    task: Background[str] = Background()
    task.begin("a", make)
    task.begin("b", lambda: made.append("b") or "b")  # one at a time
    begun.wait()
    threading.Timer(0.1, gate.set).start()
    task.release()
    assert made == ["a"]
    assert task.known("a") is None
    assert task.get("a", lambda: "anew", wait=True) == "anew"
    task.release()
    task.release()
