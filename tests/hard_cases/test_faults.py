"""A few faults in the middle of commands; bench/faults.py injects many, in every command."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator

import pytest

from bench.faults import JOBS, Bench, Fault, Job, Outcome, clear, contents
from bench.faults import KINDS as FAULTS

QUICK = tuple(
    job for job in JOBS if job.name in ("generate", "bake", "generate (--repair)") or job.far
)
PRELOAD = ("prtnet.cli_bake", "prtnet.lobe_fit", "data_gen.generate", "data_gen.bake")
CASES = [
    pytest.param(job, kind, id=f"{kind}-{job.name}")
    for job in QUICK
    for kind in job.kinds
    # On a cluster each takes seconds.
    if kind != "small disk" and (not job.far or kind == "worker killed")
]


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    made = Bench(tmp_path_factory.mktemp("faults"), QUICK, PRELOAD)
    yield made
    made.cluster.close()


@pytest.mark.parametrize(("job", "kind"), CASES)
def test_the_same_command_again_mends_it(bench: Bench, job: Job, kind: str) -> None:
    rng = random.Random(FAULTS.index(kind))
    for old in (False, True):
        outcomes = [bench.survives(job, bench.fault(job, kind, old, rng), old)]
        while not outcomes[-1][1] and len(outcomes) < 4:  # it came too late
            outcomes.append(bench.survives(job, bench.fault(job, kind, old, rng), old))
        assert {lost for lost, _ in outcomes} == {""}
        assert outcomes[-1][1]


def test_a_fault_strikes(bench: Bench) -> None:
    """Killed and full runs end as such, and what is missing or other is seen."""
    job = QUICK[0]
    argv = bench.argv(job, bench.work / job.out)
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


def test_an_older_file_that_is_gone_is_seen(bench: Bench) -> None:
    job, killed = QUICK[1], Outcome(-9, 1.0, 0, "")
    before = {".": "the hash of a file"}
    assert "an older file is gone" in bench.lost_of(job, killed, before)
    assert bench.lost_of(job, killed, {}) == ""
    (bench.work / job.out).write_bytes(b"half")
    assert "not whole" in bench.lost_of(job, killed, before)
    clear(bench.work)


def test_what_a_repair_leaves_half_done_is_no_loss(bench: Bench) -> None:
    """A file is as it was or as it should be; any other is seen."""
    job = next(job for job in QUICK if job.damaged)
    out, killed = bench.work / job.out, Outcome(-9, 1.0, 0, "")
    shutil.copytree(bench.older(job) / job.out, out)
    before = contents(out)
    assert not bench.is_whole(job, out)
    assert bench.lost_of(job, killed, before) == ""
    assert bench.run(bench.argv(job, out)).status == 0
    mended = (out / job.damaged[0]).read_bytes()
    clear(bench.work)
    assert "gone" in bench.lost_of(job, killed, before)
    shutil.copytree(bench.older(job) / job.out, out)
    (out / job.damaged[0]).write_bytes(mended)
    assert contents(out) != before
    assert bench.lost_of(job, killed, before) == ""
    (out / job.damaged[1]).write_bytes(b"half")
    assert "not whole" in bench.lost_of(job, killed, before)
    clear(bench.work)
