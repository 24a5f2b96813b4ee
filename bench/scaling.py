"""How far commands scale over workers: real tasks on one and two, stubs for the scheduler.

    python bench/scaling.py [STUBS] [--write]

Workers are processes of one thread. Stubs do nothing: what they take is the scheduler's share. With
t seconds a block, the scheduler keeps up with t over that share workers.
"""

from __future__ import annotations

import sys
import tempfile
import time
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

from distributed import LocalCluster

from bench.tables import ROOT, publish
from data_gen.generate import GenerateConfig, generate
from data_gen.gltf_writer import write_glb
from data_gen.procedural import mannequin
from data_gen.readers import read_scene
from prtnet.cli import run
from prtnet.executor import Cluster

PAGE = ROOT / "docs" / "cluster.md"
CONFIG = GenerateConfig(count=16, rays=256, threads=1, block=4)
STUBS = 100_000
COMMANDS = {
    "train": "train {folder}/1.zarr --alpha 0.003 --clusters 48 --networks 4 --threads 1",
    "bake": "bake bumps --size 96x96 --lobes 3 --threads 1",
    "bake-all-frequency": "bake-all-frequency {folder}/mannequin.glb --vertices 2000 --texels 16",
}  # with a cluster; what it leaves to one thread is in the seconds
SMALLER = (("--size 96x96", "--size 24x24"), ("--vertices 2000", "--vertices 300"),
           ("--networks 4", "--networks 1"))  # fmt: skip


@dataclass(frozen=True)
class Stub:
    def __call__(self, number: int, pool: Executor) -> None:
        pass


def workers(count: int) -> LocalCluster:
    return LocalCluster(
        n_workers=count, threads_per_worker=1, processes=True, dashboard_address=None
    )


def traced(count: int, folder: Path) -> tuple[int, float]:
    """Blocks, and seconds they took on so many workers that know the scene already."""
    path = folder / "mannequin.glb"
    scene = read_scene(path)
    with workers(count) as cluster:
        where = {"cluster": cluster.scheduler_address, "source": path}
        generate(scene, CONFIG, folder / f"{count}.zarr", **where)
        started = time.perf_counter()
        summary = generate(scene, CONFIG, folder / f"{count}.zarr", **where)
        return -(-summary.poses // CONFIG.block), time.perf_counter() - started


def seconds_of(words: str, count: int, folder: Path) -> float:
    """Of a command on so many workers that have done a smaller one: they know the packages, and
    nothing else that would help them.
    """
    out, small = folder / "out.safetensors", words
    for whole, part in SMALLER:
        small = small.replace(whole, part)
    assert small != words
    with workers(count) as cluster:
        address = f"--out {out} --cluster {cluster.scheduler_address} --quiet"
        for each in (small, words):
            started = time.perf_counter()
            if run([*each.format(folder=folder).split(), *address.split()]) != 0:
                raise SystemExit(f"{each} failed")
            taken = time.perf_counter() - started
        return taken


def stubs(count: int, folder: Path, number: int) -> float:
    del folder
    with workers(count) as cluster:
        tasks = Cluster(cluster.scheduler_address)
        list(tasks.run(Stub(), range(100)))  # workers import
        started = time.perf_counter()
        assert sorted(tasks.run(Stub(), range(number))) == list(range(number))
        return time.perf_counter() - started


def bound(name: str, one: float, two: float) -> str:
    """How much sooner than one any number of workers is done (Amdahl), by the seconds of two."""
    own = 2.0 * two - one  # seconds that do not scale
    if own < 0.02 * one:
        return f"{name} more than 50 times"
    return f"{name} at most {one / own:.0f} times"


def main() -> None:
    number = next((int(word) for word in sys.argv[1:] if word.isdigit()), STUBS)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_glb(mannequin(), folder / "mannequin.glb")
        blocks, alone = traced(1, folder)
        _, both = traced(2, folder)
        for count, seconds in ((1, alone), (2, both)):
            each, efficiency = f"{1e3 * seconds / blocks:.1f}", alone / seconds / count
            rows.append(["generate", count, blocks, f"{seconds:.1f}", each, f"{efficiency:.0%}"])
        bounds = []
        for name, words in COMMANDS.items():
            one, two = (seconds_of(words, count, folder) for count in (1, 2))
            bounds.append(bound(name, one, two))
            for count, seconds in ((1, one), (2, two)):
                efficiency = f"{one / seconds / count:.0%}"
                rows.append([name, count, "–", f"{seconds:.1f}", "–", efficiency])
        for some in (number // 100, number // 10, number):
            seconds = stubs(2, folder, some)
            rows.append(["stubs", 2, some, f"{seconds:.1f}", f"{1e3 * seconds / some:.2f}", "–"])
    share = seconds / number
    keeps = alone / blocks / share
    note = (f"At {alone / blocks:.2f} s a block one scheduler keeps up with {keeps:.0f} workers. "
            "By what two gain, any number of workers is done sooner than one with work of this "
            f"size: {', '.join(bounds)}.")  # fmt: skip
    publish(
        "scaling",
        ("work", "workers", "blocks", "seconds", "ms a block", "efficiency"),
        rows,
        note,
        PAGE,
    )


if __name__ == "__main__":
    main()
