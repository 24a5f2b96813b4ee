"""How long the GPU draws, told without waiting for it: of the picture before."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

import moderngl

__all__ = ["GPUTimer"]


class GPUTimer:
    """Times what is drawn inside ``with``; where OpenGL has no timers it draws all the same.

    Args:
        context: that is drawn on.

    Attributes:
        milliseconds: of the drawing before the last; None as long as there is none.
    """

    def __init__(self, context: moderngl.Context) -> None:
        try:
            self._queries: list[Any] = [context.query(time=True) for _ in range(2)]
        except Exception:  # whatever a driver without them says
            self._queries = []
        self._drawn = 0
        self.milliseconds: float | None = None

    def __enter__(self) -> Self:
        if self._queries:
            self._queries[self._drawn % 2].__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if not self._queries:
            return
        self._queries[self._drawn % 2].__exit__(kind, error, trace)
        self._drawn += 1
        if self._drawn > 1:  # the one before: this one is still being drawn
            self.milliseconds = self._queries[self._drawn % 2].elapsed / 1e6
