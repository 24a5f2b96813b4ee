"""What is made beside the frames, and fails there."""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from runtime.background import NICE, TRACERS, Background, step_back

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="no priorities of threads")


def priority() -> int:
    return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


@LINUX
@pytest.mark.parametrize("task", [Background(), Background(TRACERS)])
def test_frames_come_first(task: Background[int]) -> None:
    before = priority()
    assert task.get("a", priority, wait=True) == max(before, NICE)
    assert priority() == before
    task.release()


@LINUX
def test_threads_that_may_not_step_back_work_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refused)
    with ThreadPoolExecutor(1, initializer=step_back) as pool:
        assert pool.submit(int, "7").result() == 7


def test_what_is_not_begun_is_let_be() -> None:
    gate = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        first: Background[bool] = Background(pool)
        second: Background[bool] = Background(pool)
        first.begin("a", gate.wait)
        second.begin("b", gate.wait)
        try:
            assert [task.cancelled() for task in (first, second)] == [False, True]
            assert [task.busy for task in (first, second)] == [True, False]
        finally:
            gate.set()


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
