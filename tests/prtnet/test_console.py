from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
import rich.console

from prtnet.console import PATIENCE, SPARSE, Console, StageMonitor, silent, write_json
from prtnet.errors import PrtnetError


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


def test_results_go_to_stdout_and_talk_to_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    console = Console()
    console.message("[bold] wrote a[b]")
    console.table(["clip", "rms"], [["Walk[1]", 0.04]])
    console.facts({"order": 4, "held_out": ["Run", "Jump"]})
    out, err = capsys.readouterr()
    assert err == "[bold] wrote a[b]\n"  # names with brackets are not markup
    assert out.splitlines()[0].split() == ["clip", "rms"]
    assert out.splitlines()[1].split() == ["Walk[1]", "0.04"]
    assert out.splitlines()[2:] == ["order     4", "held out  Run, Jump"]


def test_facts_with_parts_are_tables(capsys: pytest.CaptureFixture[str]) -> None:
    facts = {
        "clips": {"Run": {"seconds": 0.5, "keys": 12}, "Walk": {"seconds": 2 / 3, "keys": 3}},
        "config": {"kind": "neural", "alpha": None},
        "empty": {},
        "two_sided": True,
        "dropped": [],
    }
    Console().facts(facts)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        ["two", "sided", "yes"], ["dropped", "none"], [],
        ["clips", "seconds", "keys"], ["Run", "0.5", "12"], ["Walk", "0.666667", "3"], [],
        ["config"], ["kind", "neural"], ["alpha", "None"],
    ]  # fmt: skip


def test_parts_of_parts_are_tables_of_their_own(capsys: pytest.CaptureFixture[str]) -> None:
    errors = [k / 20 for k in range(24)]
    Console().facts({"beside_1": {"source": "ground", "errors": errors, "sizes": {"raw": 12}}})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        [], ["beside", "1"], ["source", "ground"],
        ["errors", "24", "numbers", "from", "0", "to", "1.15"], [],
        ["beside", "1,", "sizes"], ["raw", "12"],
    ]  # fmt: skip
    Console().facts({"a": {"x": {"u": 1}, "y": {"v": 2}}})
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines == [[], ["a,", "x"], ["u", "1"], [], ["a,", "y"], ["v", "2"]]


def test_quiet_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    clock = Clock()
    console = Console(quiet=True, clock=clock)
    console.message("x")
    console.table(["a"], [["b"]])
    console.facts({"a": 1, "b": {"c": 2}})
    with console.progress() as report:
        clock.now = 1e6
        report("rays", 1, 2)
        assert report is silent
    assert capsys.readouterr() == ("", "")


def test_quick_work_without_terminal_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Console(clock=Clock()).progress() as report:
        for done in range(101):
            report("rays", done, 100)
    assert capsys.readouterr().err == ""


def test_long_work_without_terminal_says_a_line_now_and_then(
    capsys: pytest.CaptureFixture[str],
) -> None:
    clock = Clock()
    with Console(clock=clock).progress() as report:
        for done in range(101):
            clock.now = done * SPARSE / 25  # 4 · SPARSE seconds in all
            report("rays", done, 100)
    lines = capsys.readouterr().err.splitlines()
    assert 3 <= len(lines) <= 5
    assert lines[-1].startswith("rays: 100/100 (100 %), 40 s")
    assert all(line.startswith("rays: ") for line in lines)


def test_terminal_gets_a_bar_only_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, screen = Clock(), io.StringIO()
    console = Console(clock=clock)
    console._error = rich.console.Console(file=screen, force_terminal=True, width=80)
    with console.progress() as report:
        report("rays", 1, 4)
        assert screen.getvalue() == ""
        clock.now = 2 * PATIENCE
        report("rays", 2, 4)
    assert "rays" in screen.getvalue()


def test_stages_of_a_fit_are_progress() -> None:
    seen: list[tuple[str, int, int]] = []
    monitor = StageMonitor(lambda *report: seen.append(report))
    monitor.stage("clusters")
    monitor.stage("fit")
    monitor.progress(2, 2, 0.5)
    monitor.stage("error")
    assert seen == [("clusters", 0, 0), ("clusters", 1, 1), ("fit", 0, 0),
                    ("fit", 2, 2, "loss 0.5000"), ("error", 0, 0)]  # fmt: skip


def test_stage_of_unknown_length_is_shown_at_once() -> None:
    screen = io.StringIO()
    console = Console(clock=Clock())
    console._error = rich.console.Console(file=screen, force_terminal=True, width=80)
    with console.progress() as report:
        report("clusters", 0, 0)
    assert "clusters" in screen.getvalue()


def test_json_holds_arrays_and_no_nan(tmp_path: Path) -> None:
    path = tmp_path / "out.json"
    value = {"a": np.arange(3), "b": np.float32(0.5), "c": float("nan"), 1: (True, None, "é")}
    write_json(path, {**value, "path": Path("x")})
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == {
        "a": [0, 1, 2], "b": 0.5, "c": None, "1": [True, None, "é"], "path": "x",
    }  # fmt: skip
    assert text.endswith("}\n")


def test_json_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(PrtnetError, match="cannot be written"):
        write_json(tmp_path / "no" / "out.json", {})
