"""A few faults in the middle of commands; bench/faults.py injects many, in every command."""

from __future__ import annotations

import random

import pytest

from bench.faults import JOBS, Bench, Fault, Job, clear

QUICK = tuple(job for job in JOBS if job.name in ("generate", "bake"))
PRELOAD = ("prtnet.cli_bake", "prtnet.lobe_fit", "data_gen.generate", "data_gen.bake")
KINDS = ("kill -9 at a moment", "kill -9 at a step", "disk full")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("faults"), QUICK, PRELOAD)


@pytest.mark.parametrize("job", QUICK, ids=lambda job: job.name)
@pytest.mark.parametrize("kind", KINDS)
def test_the_same_command_again_mends_it(bench: Bench, job: Job, kind: str) -> None:
    rng = random.Random(KINDS.index(kind))
    faults = [fault for fault in bench.faults(job, 2, rng) if fault.kind == kind]
    for fault, old in zip(faults, (False, True), strict=True):
        assert bench.survives(job, fault, old) == ""


def test_a_fault_strikes(bench: Bench) -> None:
    """Killed and full runs end as such, and what is missing or other is seen."""
    job = QUICK[0]
    argv = job.argv(bench.inputs, bench.work / job.out)
    assert bench.run(argv, Fault(step=20)).status == -9
    for step in range(20, 40):  # some steps can do without room
        clear(bench.work)
        if (full := bench.run(argv, Fault(step=step, full=True))).status != 0:
            break
    assert full.status == 2
    assert not (bench.work / job.out).exists()
    assert not bench.is_whole(job, bench.older(job) / job.out)
    assert bench.run(argv).status == 0
    assert bench.is_whole(job, bench.work / job.out)
