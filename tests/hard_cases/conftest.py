"""Gathers what hard cases measure: ``--hard-table FILE`` writes the page of all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.hard_cases.measured import CHECKS, Check
from tests.hard_cases.table import Result, page

RESULTS: list[Result] = []
DEVICES = ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]


@pytest.fixture(params=["float32", "float64"])
def dtype(request: pytest.FixtureRequest) -> str:
    """Both precisions, one after the other."""
    return str(request.param)


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> str:
    """Every device that is there."""
    return str(request.param)


@pytest.fixture
def put(dtype: str, device: str) -> Callable[[Any], Any]:
    """Brings numbers to a precision and a device: a NumPy array, on a GPU a tensor."""

    def there(numbers: Any) -> Any:
        typed = np.asarray(numbers, dtype=dtype)
        return typed if device == "cpu" else torch.from_numpy(typed).to(device)

    return there


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--hard-table", metavar="FILE", help="write what hard cases measured")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """What a test measures goes with its report, which may come from another process."""
    CHECKS.clear()
    yield
    item.user_properties.append(("checks", [list(check) for check in CHECKS.values()]))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Iterator[None]:
    """In which precision and where it ran, also of what was skipped."""
    given = getattr(getattr(item, "callspec", None), "params", {})
    kind = " ".join(given[name] for name in ("dtype", "device") if given.get(name, "cpu") != "cpu")
    if ("type", kind) not in item.user_properties:
        item.user_properties.append(("type", kind))
    return (yield)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Every test tells once: when it has run, or that it was skipped before."""
    kept = dict(report.user_properties)
    if "type" in kept and (report.when == "call" or (report.when == "setup" and report.skipped)):
        path, line, name = report.location
        checks = tuple(Check(*check) for check in kept.get("checks", ()))
        module = Path(path).stem.removeprefix("test_")
        name = name.partition("[")[0].removeprefix("test_")
        RESULTS.append(Result(module, name, line or 0, str(kept["type"]), checks, report.passed))


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """A page is written by one process, and of a run without failures alone."""
    file = session.config.getoption("--hard-table", None)
    if file and exitstatus == 0 and not hasattr(session.config, "workerinput"):
        Path(file).write_text(page(RESULTS), encoding="utf-8")
