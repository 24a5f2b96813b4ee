"""How long the GPU draws, told without waiting for it: of the picture before."""

from __future__ import annotations

import contextlib
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
        # Those of timers that were given back: moderngl cannot delete any while a context lasts.
        self._spare: list[list[Any]] = vars(context).setdefault("_spare_queries", [])
        if not self._spare:
            with contextlib.suppress(Exception):  # whatever a driver without them says
                self._spare.append([context.query(time=True) for _ in range(2)])
        self._queries: list[Any] = self._spare.pop() if self._spare else []
        self._drawn = 0
        self.milliseconds: float | None = None

    def release(self) -> None:
        """Leave the queries to another timer."""
        if self._queries:
            self._spare.append(self._queries)
            self._queries = []

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
