from __future__ import annotations

import os
import subprocess
import sys

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


SUMS = """
import torch
from prtnet.cores import computing_threads, use_threads

use_threads(1)
others = []
for seed, (count, dims, width) in enumerate([(1031, 640, 36), (1031, 160, 12), (200, 900, 48)] * 8):
    torch.manual_seed(seed)
    own, other = torch.randn(count, dims), torch.randn(dims, width)
    for work in (lambda: own.T @ (own @ other), lambda: own.double().T @ own.double()):
        alone = work()
        with computing_threads(2) as pool:
            shared = pool.submit(work).result()
        others += [seed] * (not torch.equal(shared, alone))
assert others == [], others
"""


def test_what_computing_threads_add_up_is_what_one_would() -> None:
    """Their first products, too, on a machine with more cores than this."""
    environment = os.environ | {"OMP_NUM_THREADS": "4", "PYTHONPATH": os.pathsep.join(sys.path)}
    subprocess.run([sys.executable, "-c", SUMS], env=environment, check=True)
