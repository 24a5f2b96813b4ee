from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
import torch
from threadpoolctl import threadpool_info, threadpool_limits

from data_gen.generate import GenerateConfig
from prtnet import cli
from prtnet.cores import core_count, in_threads


def test_every_command_starts_as_many_threads_as_it_may(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 4, 5}, raising=False)
    assert core_count() == cli.threads(None) == GenerateConfig().threads == 3
    assert cli.threads(2) == 2


def test_machine_that_does_not_tell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert core_count() == 1


PRODUCTS = """
import torch
from prtnet.cores import computing_threads, use_threads

use_threads(1)
own, other = torch.ones(1031, 640), torch.ones(640, 36)
for first in (lambda: own @ other, lambda: own.double().T @ own.double()):
    with computing_threads(2) as pool:
        pool.submit(first).result()
"""


def test_torch_computes_by_one_in_each_of_computing_threads() -> None:
    """From their first product on, and on a machine with more cores than this."""
    environment = os.environ | {
        "OMP_NUM_THREADS": "4", "MKL_VERBOSE": "1", "PYTHONPATH": os.pathsep.join(sys.path)
    }  # fmt: skip
    found = subprocess.run(
        [sys.executable, "-c", PRODUCTS],
        env=environment,
        check=True,
        capture_output=True,
        text=True,
    )
    told = re.findall(r"GEMM.*NThr:(\d+)", found.stdout)
    if not told:
        pytest.skip("this torch multiplies by something else than MKL")
    assert told.count("1") == len(told)


def test_in_threads_every_library_computes_by_one() -> None:
    def counts(_: int) -> set[int]:
        return {torch.get_num_threads(), *(own["num_threads"] for own in threadpool_info())}

    before = torch.get_num_threads()
    with threadpool_limits(3):
        torch.set_num_threads(3)
        assert counts(0) == {3}
        with in_threads(2) as each:
            assert set.union(*each(counts, range(4)), counts(0)) == {1}
        assert counts(0) == {3}
        with pytest.raises(KeyError), in_threads(2) as each:
            list(each({}.__getitem__, range(4)))
        assert counts(0) == {3}
    torch.set_num_threads(before)
