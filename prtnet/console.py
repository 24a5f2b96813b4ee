"""What the user sees while a command works: progress, messages, tables and JSON results.

Progress and messages go to stderr, tables to stdout, so that results can be piped. Long work takes
a ``Report``, a plain function, and knows nothing of terminals.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import rich.console
import rich.markup
import rich.progress
import rich.table

from prtnet.files import writing

__all__ = ["Console", "Report", "StageMonitor", "in_per_cent", "silent", "write_json"]

PATIENCE = 1.0  # seconds before anything is shown: quick work needs no bar
LONG = 12  # numbers; of more than so many the least and the most are shown
SPARSE = 10.0  # seconds between lines where there is no terminal to redraw


class Report(Protocol):
    """Called by long work whenever it has got further."""

    def __call__(self, what: str, done: int, total: int, detail: str = "") -> None:
        """Say that ``done`` of ``total`` steps of ``what`` are behind us; 0 of 0 where unknown.

        ``detail`` is a figure to show beside, such as the loss.
        """


def silent(what: str, done: int, total: int, detail: str = "") -> None:
    """A ``Report`` that shows nothing."""


class Console:
    """Talks to the user.

    Args:
        quiet: show nothing; errors are not this class's business.
        clock: seconds, from anywhere.
    """

    def __init__(self, quiet: bool = False, clock: Callable[[], float] = time.monotonic) -> None:
        self.quiet = quiet
        self._clock = clock
        self._error = rich.console.Console(file=sys.stderr, highlight=False, soft_wrap=True)
        self._output = rich.console.Console(file=sys.stdout, highlight=False)

    def message(self, text: str) -> None:
        """One line on stderr."""
        if not self.quiet:
            self._error.print(text, markup=False)

    def table(
        self, columns: Sequence[str], rows: Sequence[Sequence[object]], title: str | None = None
    ) -> None:
        """A table on stdout; every column but the first is flush right."""
        if self.quiet:
            return
        table = rich.table.Table(title=title, title_justify="left", box=None, pad_edge=False)
        for index, column in enumerate(columns):
            table.add_column(
                rich.markup.escape(column), justify="right" if index else "left", overflow="fold"
            )
        for row in rows:
            table.add_row(*(rich.markup.escape(str(cell)) for cell in row))
        self._output.print(table)

    def facts(self, facts: Mapping[str, Any]) -> None:
        """Named values on stdout: one a line, and what has parts as tables of their own."""
        if self.quiet:
            return
        flat = {n: v for n, v in facts.items() if not isinstance(v, Mapping)}
        width = max((len(name) for name in flat), default=0)
        for name, value in flat.items():
            self._output.print(
                f"{words(name):<{width}}  {shown(value)}", markup=False, soft_wrap=True
            )
        for name, parts in facts.items():
            if isinstance(parts, Mapping):
                self._parts(words(name), parts)

    def _parts(self, name: str, parts: Mapping[str, Any]) -> None:
        """A table of parts: a row for each, with columns where all of them have the same parts."""
        inner = {n: part for n, part in parts.items() if isinstance(part, Mapping)}
        columns = [""]
        rows = [[n, shown(part)] for n, part in parts.items() if n not in inner]
        deep = any(isinstance(v, Mapping) for part in inner.values() for v in part.values())
        if inner and not (rows or deep) and len({tuple(part) for part in inner.values()}) == 1:
            columns = list(map(words, next(iter(inner.values()))))
            rows = [[key, *map(shown, part.values())] for key, part in inner.items()]
            inner = {}
        if rows:
            self._output.print()
            self.table([name, *columns], rows)
        for key, part in inner.items():
            self._parts(f"{name}, {key}", part)

    @contextlib.contextmanager
    def progress(self) -> Iterator[Report]:
        """A ``Report`` to hand to long work: a bar on a terminal, a line now and then elsewhere."""
        if self.quiet:
            yield silent
        elif self._error.is_terminal:
            bar = _Bar(self._error, self._clock)
            try:
                yield bar.report
            finally:
                bar.close()
        else:
            yield _Lines(self.message, self._clock).report


class StageMonitor:
    """Shows the stages of a fit as progress; what could be plotted is left out.

    Args:
        report: from ``Console.progress``.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._stage, self._counted = "", False

    def stage(self, text: str) -> None:
        """The stage before is done and another begins, of unknown length."""
        if self._stage and not self._counted:
            self._report(self._stage, 1, 1)
        self._stage, self._counted = text, False
        self._report(text, 0, 0)

    def progress(self, done: int, total: int, loss: float) -> None:
        """Steps done of the present stage."""
        self._counted = True
        self._report(self._stage, done, total, f"loss {loss:.4f}")

    def scalar(self, name: str, value: float, step: int) -> None:
        """Not shown."""

    def histogram(self, name: str, values: object, step: int) -> None:
        """Not shown."""


def words(name: str) -> str:
    """A name of code as it reads in a sentence."""
    return name.replace("_", " ")


def shown(value: object) -> str:
    """A value as a person would write it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, list | tuple):
        if len(value) > LONG and all(isinstance(one, int | float) for one in value):
            return f"{len(value)} numbers from {shown(min(value))} to {shown(max(value))}"
        return ", ".join(map(shown, value)) if value else "none"
    return str(value)


def in_per_cent(results: Mapping[str, Any]) -> dict[str, Any]:
    """Results with their errors as a person reads them, without the list of poses."""
    fractions = {"rms", "p99", "max", "signal", "nearest", "pca_floor"}
    shown: dict[str, Any] = {}
    for name, value in results.items():
        if name.endswith("distance"):
            shown[name] = "–" if value is None else f"{value['mean']:.3f}"
        elif name == "coherence":
            shown[name] = "–" if value is None else f"{value:.2f}"
        elif isinstance(value, Mapping):
            shown[name] = in_per_cent(value)
        elif name in fractions and value is not None:
            shown[name] = f"{100 * value:.2f} %"
        elif name != "poses":
            shown[name] = value
    return shown


class _Bar:
    """One bar a task, drawn once the work has taken ``PATIENCE``."""

    def __init__(self, console: rich.console.Console, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._start = clock()
        self._shown = False
        self._lock = threading.Lock()
        self._tasks: dict[str, rich.progress.TaskID] = {}
        self._progress = rich.progress.Progress(
            rich.progress.TextColumn("{task.description} {task.fields[detail]}", markup=False),
            rich.progress.BarColumn(),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TimeRemainingColumn(),
            console=console,
            transient=True,
        )

    def report(self, what: str, done: int, total: int, detail: str = "") -> None:
        with self._lock:  # several threads may tell
            if what not in self._tasks:
                self._tasks[what] = self._progress.add_task(what, total=None, detail=detail)
            task = self._tasks[what]
        self._progress.update(task, completed=done, total=total or None, detail=detail)
        if not self._shown and (not total or self._clock() - self._start > PATIENCE):
            self._shown = True
            self._progress.start()

    def close(self) -> None:
        if self._shown:
            self._progress.stop()


class _Lines:
    """At most a line every ``SPARSE`` seconds, and one when long work is done."""

    def __init__(self, write: Callable[[str], None], clock: Callable[[], float]) -> None:
        self._write = write
        self._clock = clock
        self._start = self._last = clock()

    def report(self, what: str, done: int, total: int, detail: str = "") -> None:
        now = self._clock()
        finished = 0 < total <= done and now - self._start > SPARSE
        if now - self._last > SPARSE or finished:
            self._last = now
            share = f" {done}/{total} ({100.0 * done / total:.0f} %)," if total else ""
            detail = f", {detail}" if detail else ""
            self._write(f"{what}:{share} {now - self._start:.0f} s{detail}")


def plain(value: Any) -> Any:
    """``value`` as JSON can hold it: lists for arrays, null for what is not a finite number."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def write_json(path: str | Path, value: Any) -> None:
    """Write machine-readable results; the file is whole or absent.

    Raises:
        PrtnetError: the file cannot be written.
    """
    text = json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False)
    with writing(path) as partial:
        partial.write_text(text + "\n", encoding="utf-8")
