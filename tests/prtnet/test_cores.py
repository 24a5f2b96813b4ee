from __future__ import annotations

import os

import pytest

from data_gen.generate import GenerateConfig
from prtnet import cli
from prtnet.cores import core_count


def test_every_command_starts_as_many_threads_as_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 4, 5}, raising=False)
    assert core_count() == cli.threads(None) == GenerateConfig().threads == 3
    assert cli.threads(2) == 2


def test_machine_that_does_not_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert core_count() == 1
