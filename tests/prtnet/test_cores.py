from __future__ import annotations

import os
import re
import subprocess
import sys
import threading

import pytest
import torch
from threadpoolctl import threadpool_info

from data_gen.generate import GenerateConfig
from prtnet import cli
from prtnet.cores import core_count, divided, in_threads, side_by_side, thread_count


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


def counts(_: int = 0) -> set[int]:
    """Of torch here, and of NumPy's and SciPy's BLAS. (OpenMP counts for each thread, and torch is
    all that uses it in ours.)
    """
    blas = [own["num_threads"] for own in threadpool_info() if own["user_api"] == "blas"]
    return {torch.get_num_threads(), *blas}


@pytest.mark.usefixtures("three_threads")
def test_in_threads_every_library_computes_by_one() -> None:
    assert counts() == {thread_count()} == {3}
    with in_threads() as each:
        assert set.union(*each(counts, range(4)), counts()) == {1}
        assert thread_count() == 3
        with divided(2), in_threads() as again:  # within another
            assert set.union(*again(counts, range(4)), counts()) == {1}
            assert thread_count() == 2
        assert counts() == {1}
        assert list(each(lambda _: thread_count(), range(2))) == [1, 1]
    assert counts() == {3}
    with pytest.raises(KeyError), in_threads() as each:
        list(each({}.__getitem__, range(4)))
    assert counts() == {thread_count()} == {3}


def test_pieces_are_done_by_as_many_as_is_said() -> None:
    with side_by_side(2), in_threads() as each:
        ready = threading.Barrier(2, timeout=30)  # one alone would wait for ever
        list(each(lambda _: ready.wait(), range(2)))
        names = set(each(lambda _: threading.current_thread().name, range(50)))
    assert len(names) <= 2
