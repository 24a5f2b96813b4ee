from __future__ import annotations

from typing import Any

import moderngl
import pytest

from runtime.gpu_timer import GPUTimer


def test_queries_are_used_again(context: moderngl.Context, monkeypatch: pytest.MonkeyPatch) -> None:
    """Moderngl cannot delete any: one character after another would add to them."""
    made: list[Any] = []
    query = moderngl.Context.query

    def counted(*given: Any, **named: Any) -> Any:
        made.append(query(*given, **named))
        return made[-1]

    monkeypatch.setattr(moderngl.Context, "query", counted)
    for _ in range(3):
        timers = [GPUTimer(context) for _ in range(2)]
        assert all(timer.milliseconds is None for timer in timers)
        for timer in timers * 3:
            with timer:
                pass
        assert all(timer.milliseconds is not None for timer in timers)
        for timer in timers * 2:  # a second time does nothing
            timer.release()
    assert len(made) == 4
