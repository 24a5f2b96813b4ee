"""How far commands scale over workers: real tasks on one and two, stubs for the scheduler.

    python bench/scaling.py [STUBS] [--write]

Workers are processes of one thread. Of three runs the one in the middle counts. What a command does
itself while no task is waited for bounds how much sooner any number of workers is done. Stubs do
nothing: what they take is the scheduler's share. With t seconds a task, it keeps up with t over
that share workers.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from distributed import LocalCluster

from bench.tables import ROOT, publish
from data_gen.gltf_writer import write_glb
from data_gen.procedural import mannequin
from prtnet import executor
from prtnet.cli import run
from prtnet.executor import Cluster, Task

PAGE = ROOT / "docs" / "cluster.md"
STUBS = 100_000
REPEATS = 3
COMMANDS = (
    "generate {folder}/mannequin.glb --out {out}.zarr --count 16 --rays 256 --block 4",
    "train {out}.zarr --out {out}.safetensors --alpha 0.003 --clusters 48 --networks 4 --threads 1",
    "bake bumps --out {out}.safetensors --size 96x96 --lobes 3 --threads 1",
    "bake-all-frequency {folder}/mannequin.glb --out {out}.safetensors --vertices 2000 "
    "--texels 16 --threads 1",
)
SMALLER = (("--size 96x96", "--size 24x24"), ("--vertices 2000", "--vertices 300"),
           ("--networks 4", "--networks 1"), ("--count 16", "--count 2"))  # fmt: skip


@dataclass(frozen=True)
class Stub:
    def __call__(self, number: int, pool: Executor) -> None:
        pass


def workers(count: int) -> LocalCluster:
    return LocalCluster(
        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=":0"
    )


class Watched(Cluster):
    """Counts tasks, and the seconds in which the command has nothing to do but wait for them."""

    tasks, waited = 0, 0.0

    def run(self, task: Task, numbers: Sequence[int], ahead: int = 1) -> Iterator[int]:
        found = super().run(task, numbers, ahead)
        while True:
            started = time.perf_counter()
            number = next(found, None)
            Watched.waited += time.perf_counter() - started
            if number is None:
                return
            Watched.tasks += 1
            yield number


@dataclass(frozen=True)
class Taken:
    """By a command: tasks, seconds in all, and those in which it did not wait for workers."""

    tasks: int
    seconds: float
    own: float


def taken(words: str, count: int, folder: Path) -> Taken:
    """Of a command on so many workers that have done a smaller one: they know the packages, and
    nothing else that would help them.
    """
    out, small = folder / "out", words
    for whole, part in SMALLER:
        small = small.replace(whole, part)
    assert small != words
    with workers(count) as cluster:
        address = f"--cluster {cluster.scheduler_address} --quiet"
        for each in (small, words):
            Watched.tasks, Watched.waited = 0, 0.0
            started = time.perf_counter()
            if run([*each.format(folder=folder, out=out).split(), *address.split()]) != 0:
                raise SystemExit(f"{each} failed")
            seconds = time.perf_counter() - started
        return Taken(Watched.tasks, seconds, seconds - Watched.waited)


def typical(words: str, count: int, folder: Path) -> Taken:
    """Of some runs the one in the middle."""
    runs = sorted((taken(words, count, folder) for _ in range(REPEATS)), key=lambda t: t.seconds)
    return runs[len(runs) // 2]


def stubs(count: int, folder: Path, number: int) -> float:
    del folder
    with workers(count) as cluster:
        tasks = Cluster(cluster.scheduler_address)
        list(tasks.run(Stub(), range(100)))  # workers import
        started = time.perf_counter()
        assert sorted(tasks.run(Stub(), range(number))) == list(range(number))
        return time.perf_counter() - started


def main() -> None:
    number = next((int(word) for word in sys.argv[1:] if word.isdigit()), STUBS)
    executor.Cluster = Watched  # type: ignore[misc]
    rows, lengths = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_glb(mannequin(), folder / "mannequin.glb")
        for words in COMMANDS:
            one, two = (typical(words, count, folder) for count in (1, 2))
            lengths.append((words.split()[0], (one.seconds - one.own) / one.tasks))
            for count, own in ((1, one), (2, two)):
                efficiency = f"{one.seconds / own.seconds / count:.0%}"
                most = f"{one.seconds / own.own:.0f}"
                rows.append([lengths[-1][0], count, own.tasks, f"{own.seconds:.1f}",
                             f"{own.own:.2f}", efficiency, most])  # fmt: skip
        for some in (number // 100, number // 10, number):
            seconds = stubs(2, folder, some)
            rows.append(["stubs", 2, some, f"{seconds:.1f}", "–", "–", "–"])
    share = seconds / number
    most = ", ".join(f"{name} {each / share:.0f}" for name, each in lengths)
    note = (f"A task costs the scheduler {1e3 * share:.1f} ms. With tasks as long as here it keeps "
            f"up with so many workers: {most}.")  # fmt: skip
    columns = ("work", "workers", "tasks", "seconds", "of these its own", "efficiency",
               "times as fast, at most")  # fmt: skip
    publish("scaling", columns, rows, note, PAGE)


if __name__ == "__main__":
    main()
