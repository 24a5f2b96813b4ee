"""Faults in the middle of every long command: the same command again has to mend all of it.

    python bench/faults.py [FAULTS [SEED]] [--write]

FAULTS of each kind, in every command (of pages a fifth): kill -9 at a random moment; kill -9 at a
random one of its steps on the disk, in the middle of a write where the step is one; a write that
finds no room; as root, a disk that is too small by a random amount; and, where a cluster works, a
worker killed at a random moment. In every second case an older output stands under the final name;
where one is repaired, a damaged one in every case. A fault counts where it struck, that is where
the command did not end well, or a worker was killed while it ran; another is drawn where it did
not, a few times. A case has survived where nothing but a whole output (the older or the new one)
ever stood under the final name, and an older file at any time, the same command then ended well,
its bytes are those of an undisturbed run, and it left nothing else behind.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import itertools
import logging
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.tables import ROOT, publish
from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet.cli import run
from prtnet.dataset_writer import MARKERS

DEFAULTS = (10, 0)  # faults of each kind in each command, seed
PAGE = ROOT / "docs" / "reliability.md"
STEPS = ("open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.link", "os.truncate")
NEEDS_ROOM = ("open", "os.mkdir")
MAKES = os.O_WRONLY | os.O_RDWR | os.O_CREAT
ROOM = 256 << 20  # bytes of a disk that is large enough
PAGE_BYTES = 4096  # what a file takes of tmpfs, at least
HUNG = 99  # status
SETTLED, HANGS = 30.0, 300.0  # seconds: until a cluster is whole again; of a command at most
TRIES = 4  # of faults, until one strikes
PRELOAD = ("tests.store", "upath", "prtnet.cli_bake", "prtnet.cli_bake_all_frequency",
           "training.all_frequency", "training.train", "prtnet.lobe_fit", "data_gen.generate",
           "data_gen.bake", "prtnet.report", "training.sweep", "training.export",
           "runtime.report_page", "runtime.onnx_model")  # fmt: skip


@dataclass(frozen=True)
class Job:
    """A command line with ``{inputs}``, ``{out}`` and perhaps ``{work}``, its folder, in it.

    Attributes:
        words: the command line.
        out: name of the output.
        older: words that stand there instead in a run that makes an older output.
        exact: whether the same run writes the same bytes; otherwise a page is whole at its end.
        label: what tells it from another job of the same command.
        header: the file without which what is there is no output yet.
        damaged: files of the output that are damaged, to be mended in their place.
    """

    words: str
    out: str
    older: tuple[str, str]
    exact: bool = True
    label: str = ""
    header: str = ""
    damaged: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        return self.words.split()[0] + self.label

    @property
    def far(self) -> bool:
        """Whether a cluster does it."""
        return "{cluster}" in self.words

    @property
    def kinds(self) -> list[str]:
        """Of faults."""
        moment, step, full, small, worker = KINDS
        found = [moment, step, worker] if self.far else [moment, step, full]
        return [*found, small] if os.geteuid() == 0 else found


JOBS = (
    Job("generate {inputs}/arm.glb --out {out} --count 9 --rays 32 --order 3 --block 2 "
        "--threads 2", "arm.zarr", ("--rays 32", "--rays 16")),
    Job("train {inputs}/arm.zarr --out {out} --kind linear --threads 1", "arm.safetensors",
        ("linear", "constant")),
    Job("bake bumps --out {out} --size 8x8 --rays 32 --order 3 --lobes 1 --threads 1",
        "bumps.safetensors", ("--rays 32", "--rays 16")),
    Job("train {inputs}/arm.zarr --out {out} --preset small --clusters 3 --iterations 4 "
        "--networks 1 --alpha 0.01 --threads 1", "neural.safetensors",
        ("--iterations 4", "--iterations 3"), label=" (neural)"),
    Job("bake-all-frequency {inputs}/arm.glb --out {out} --texels 8 --points-per-cluster 40 "
        "--terms 3 --rows 2 --brdf ggx:roughness=0.3", "arm-light.safetensors",
        ("--terms 3", "--terms 2")),
    Job("train {inputs}/arm.zarr --out {out} --preset best --clusters 3 --iterations 4 --steps 40 "
        "--samples 500 --networks 1 --alpha 0.01 --threads 2 --exchange {work}",
        "kept.safetensors", ("--iterations 4", "--iterations 3"), label=" (best, --exchange)"),
    Job("bake {inputs}/arm.glb --out {out} --rays 32 --order 3 --lobes 1 --threads 2 "
        "--exchange {work}", "kept-lobes.safetensors", ("--rays 32", "--rays 16"),
        label=" (--exchange)"),
    Job("bake-all-frequency {inputs}/arm.glb --out {out} --texels 8 --points-per-cluster 40 "
        "--terms 3 --rows 2 --brdf ggx:roughness=0.3 --exchange {work}",
        "kept-light.safetensors", ("--terms 3", "--terms 2"), label=" (--exchange)"),
    Job("generate {inputs}/arm.glb --out farm://{out} --count 9 --rays 32 --order 3 --block 2 "
        "--threads 2", "store.zarr", ("--rays 32", "--rays 16"),
        label=" (to a store)", header="zarr.json"),
    Job("generate {inputs}/arm.glb --out {out} --count 9 --rays 32 --order 3 --block 2 "
        "--threads 2 --repair", "hurt.zarr", (" --repair", ""), label=" (--repair)",
        damaged=("visibility/c/1/0/0", "visibility/c/3/0/0", "time/c/2", "faces/c/0/0")),
    Job("generate {inputs}/arm.glb --out {out} --count 9 --rays 32 --order 3 --block 2 "
        "--cluster {cluster}", "far.zarr", ("--rays 32", "--rays 16"), label=" (--cluster)"),
    Job("train {inputs}/arm.zarr --out {out} --preset small --clusters 3 --iterations 4 "
        "--networks 1 --alpha 0.01 --threads 1 --cluster {cluster}", "far.safetensors",
        ("--iterations 4", "--iterations 3"), label=" (--cluster)"),
    Job("bake {inputs}/arm.glb --out {out} --rays 32 --order 3 --cluster {cluster}",
        "arm-far.safetensors", ("--rays 32", "--rays 16"), label=" (--cluster)"),
    Job("bake-all-frequency {inputs}/arm.glb --out {out} --texels 8 --points-per-cluster 40 "
        "--terms 3 --rows 2 --brdf ggx:roughness=0.3 --cluster {cluster}",
        "arm-far-light.safetensors", ("--terms 3", "--terms 2"), label=" (--cluster)"),
    Job("export {inputs}/arm.safetensors --out {out}", "export",
        ("--out {out}", "--out {out} --storage int8")),
    Job("report {inputs}/arm.zarr --out {out} --quick --renderer cpu --threads 1", "arm.html",
        ("--light studio", "--light sky"), exact=False),
)  # fmt: skip


KINDS = ("kill -9 at a moment", "kill -9 at a step", "disk full", "small disk", "worker killed")


@dataclass(frozen=True)
class Fault:
    """What goes wrong.

    Attributes:
        seconds: kill after so many.
        step: at which step on the disk, from 1; 0 for none.
        full: that step finds no room; otherwise it is the last thing that happens.
        room: bytes that the disk has left.
        worker: it is a worker that is killed.
    """

    seconds: float | None = None
    worker: bool = False
    step: int = 0
    full: bool = False
    room: int | None = None


@dataclass
class Steps:
    """An audit hook: counts what a process does in a folder, and strikes at one of its steps."""

    folder: str
    fault: Fault
    count: int = 0
    busy: bool = field(default=False, repr=False)

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        if self.busy or event not in STEPS or not isinstance(arguments[0], str | os.PathLike):
            return
        path = os.fspath(arguments[0])
        inside = str(path).startswith(self.folder)
        # Trees are deleted by names relative to an open folder.
        relative = event in ("os.remove", "os.rmdir") and not os.path.isabs(path)
        if not (inside or relative) or (event == "open" and not arguments[2] & MAKES):
            return
        if self.fault.full and event not in NEEDS_ROOM:
            return
        self.count += 1
        if self.count == self.fault.step:
            if self.fault.full:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)
            if event == "open":
                self.busy = True
                with open(path, "ab") as file:
                    file.write(bytes(10))
            os.kill(os.getpid(), signal.SIGKILL)


def process(argv: list[str], told: Path, folder: Path, fault: Fault) -> None:
    """The child: one command line; its words of complaint and its steps go into ``told``."""
    with open(told, "w") as words:
        os.dup2(words.fileno(), 2)
        steps = Steps(str(folder), fault)
        sys.addaudithook(steps)
        status = run(argv)
        sys.stderr.flush()
        told.with_suffix(".steps").write_text(str(steps.count))
        os._exit(status)


@dataclass(frozen=True)
class Outcome:
    status: int  # −9 for killed
    seconds: float
    steps: int
    told: str
    struck: bool = False


class Bench:
    """A folder with inputs, and whole outputs of every job.

    Args:
        folder: an empty one.
        jobs: to make ready for.
        preload: modules that processes start with, to start faster.
    """

    def __init__(
        self, folder: Path, jobs: tuple[Job, ...] = JOBS, preload: tuple[str, ...] = PRELOAD
    ) -> None:
        self.folder, self.inputs, self.work = folder, folder / "inputs", folder / "work"
        self.told = folder / "told"
        self.inputs.mkdir()
        self.work.mkdir()
        self.context = multiprocessing.get_context("forkserver")
        self.context.set_forkserver_preload(["bench.faults", *preload])
        self.cluster = started_cluster() if any(job.far for job in jobs) else None
        self.whole: dict[str, dict[str, str]] = {}
        self.sound: dict[str, Outcome] = {}
        self.steps: dict[str, int] = {}  # of those that need room
        write_glb(arm(segments=6), self.inputs / "arm.glb")
        for job in JOBS[:2]:  # the others' inputs
            if any(job.out in other.words for other in jobs):
                self.run(self.argv(job, self.inputs / job.out))
        for job in jobs:
            self.older(job).mkdir()
            for old in (True, False):
                if job.damaged and not old:
                    copy(self.older(job) / job.out, self.work / job.out)
                self.sound[job.name] = self.run(self.argv(job, self.work / job.out, old))
                assert self.sound[job.name].status == 0, self.sound[job.name].told
                if old:
                    (self.work / job.out).rename(self.older(job) / job.out)
                    damage(self.older(job) / job.out, job.damaged)
            self.whole[job.name] = contents(self.work / job.out)
            clear(self.work)
            if job.damaged:
                copy(self.older(job) / job.out, self.work / job.out)
            counted = self.run(self.argv(job, self.work / job.out), Fault(full=True))
            self.steps[job.name] = counted.steps
            clear(self.work)

    def ready(self) -> None:
        """Wait for both workers. Dask gives one up that is killed while it starts: then a new
        cluster.
        """
        from distributed import Client

        where = Client(self.cluster.scheduler_address, set_as_default=False)
        with contextlib.suppress(TimeoutError), where as client:
            client.wait_for_workers(2, timeout=SETTLED)
            return
        self.cluster.close()
        self.cluster = started_cluster()

    def argv(self, job: Job, out: Path, older: bool = False) -> list[str]:
        """The words of a command line."""
        words = job.words.replace(*job.older) if older else job.words
        address = None if self.cluster is None else self.cluster.scheduler_address
        known = {"inputs": self.inputs, "out": out, "work": out.parent, "cluster": address}
        return [*(word.format(**known) for word in words.split()), "--quiet"]

    def older(self, job: Job) -> Path:
        return self.folder / f"older-{job.name}"

    def run(self, argv: list[str], fault: Fault | None = None) -> Outcome:
        """One run of a command line, disturbed or not."""
        arguments = (argv, self.told, self.work, fault or Fault())
        child = self.context.Process(target=process, args=arguments)
        started = time.perf_counter()
        child.start()
        child.join(HANGS if fault is None or fault.seconds is None else fault.seconds)
        struck = child.is_alive()
        if struck and (fault is None or fault.seconds is None):
            child.kill()
            child.join()
            return Outcome(HUNG, HANGS, 0, f"hangs: {argv}", struck)
        if fault is not None and fault.worker:
            if struck:
                kill_worker(self.cluster)
            child.join(HANGS)
        if child.is_alive():
            child.kill()
            child.join()
        seconds = time.perf_counter() - started
        steps = self.told.with_suffix(".steps")
        count = int(steps.read_text()) if child.exitcode in (0, 2) else 0
        assert child.exitcode is not None
        struck = struck or child.exitcode != 0
        return Outcome(child.exitcode, seconds, count, self.told.read_text(), struck)

    def fault(self, job: Job, kind: str, old: bool, rng: random.Random) -> Fault:
        """A random one of a kind."""
        sound, (moment, step, full, small, worker) = self.sound[job.name], KINDS
        if kind in (moment, worker):
            return Fault(seconds=rng.uniform(0.1, 1.0) * sound.seconds, worker=kind == worker)
        if kind in (step, full):
            steps = self.steps[job.name] if kind == full else sound.steps
            return Fault(step=rng.randint(1, steps), full=kind == full)
        assert kind == small
        pages = taken(self.older(job)) // PAGE_BYTES
        return Fault(room=PAGE_BYTES * rng.randint(0 if old else 1, max(1, pages - 1)))

    def survives(self, job: Job, fault: Fault, old: bool) -> tuple[str, bool]:
        """What was lost, an empty text where nothing was; and whether the fault has struck."""
        if job.far:
            self.ready()
        argv = self.argv(job, self.work / job.out)
        with disk(self.work, fault.room is not None) as resize, cleared(self.work):
            if old or job.damaged:
                copy(self.older(job) / job.out, self.work / job.out)
            before = contents(self.work / job.out)
            if fault.room is not None:
                resize(taken(self.work) + fault.room)
            hurt = self.run(argv, fault)
            lost = self.lost_of(job, hurt, before)
            if fault.worker and not (hurt.status == 0 and self.is_whole(job, self.work / job.out)):
                lost = f"not done without the worker: {hurt.told.strip()[-300:]}"
            resize(ROOM)
            return lost or self.lost_after(job, argv), hurt.struck

    def lost_of(self, job: Job, hurt: Outcome, before: dict[str, str]) -> str:
        """What a disturbed run lost of what stood there before."""
        out, complaint = self.work / job.out, hurt.told.strip()
        line = complaint.startswith("prtnet: error: ") and "\n" not in complaint
        if hurt.status == 2 and not line:
            return f"complaint of another kind: {complaint[-300:]}"
        if hurt.status not in (-9, 0, 2):
            return f"ended with status {hurt.status}: {complaint[-300:]}"
        found = contents(out)
        if job.header not in {*found, ""}:
            found = {}
        if not found and before.keys() == {"."}:
            return f"an older file is gone after {hurt}"
        whole = self.is_whole(job, out, marked=True)
        if job.damaged:
            # Zarr writes under a name beside each file's; nobody reads that.
            names = {name for name in found if not name.endswith(".partial")}
            own = {(name, found[name]) for name in names}
            whole = own <= before.items() | self.whole[job.name].items() and names == set(before)
        if job.damaged and not found:
            return f"what was repaired is gone after {hurt}"
        if found and found != before and not whole:
            return f"not whole under its final name after {hurt}"
        return ""

    def lost_after(self, job: Job, argv: list[str]) -> str:
        """What the same command does not mend."""
        out = self.work / job.out
        again = self.run(argv)
        if again.status != 0:
            return f"the same command again failed: {again.told.strip()[-300:]}"
        if not self.is_whole(job, out):
            return "the same command again wrote something else"
        left = [path.name for path in self.work.iterdir() if path != out]
        return f"left {left}" if left else ""

    def is_whole(self, job: Job, out: Path, marked: bool = False) -> bool:
        """Whether an output is what an undisturbed run writes; marks of blocks may lie in it."""
        if job.exact:
            found = contents(out)
            if marked:
                found = {k: v for k, v in found.items() if not k.startswith(f"{MARKERS}/")}
            return found == self.whole[job.name]
        return out.is_file() and out.read_text(encoding="utf-8").rstrip().endswith("</html>")


def started_cluster() -> Any:
    """Two workers of two threads."""
    from distributed import LocalCluster

    quiet = {"dashboard_address": ":0", "silence_logs": logging.CRITICAL}
    return LocalCluster(n_workers=2, threads_per_worker=2, **quiet)


def kill_worker(cluster: Any) -> None:
    """One of them that runs; another is started in its place."""
    pids = [worker.pid for worker in cluster.workers.values() if worker.pid is not None]
    if pids:
        os.kill(random.choice(pids), signal.SIGKILL)


def damage(folder: Path, names: tuple[str, ...]) -> None:
    """Flip a bit of files."""
    for name in names:
        data = bytearray((folder / name).read_bytes())
        data[len(data) // 2] ^= 1
        (folder / name).write_bytes(data)


def contents(path: Path) -> dict[str, str]:
    """SHA-256 of every file of a file or folder, by its name there; empty where there is none."""
    files = [path] if path.is_file() else sorted(f for f in path.rglob("*") if f.is_file())
    return {str(f.relative_to(path)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def copy(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.copytree(source, target)
    else:
        shutil.copyfile(source, target)


@contextmanager
def cleared(folder: Path) -> Iterator[None]:
    """Leave a folder empty."""
    try:
        yield
    finally:
        clear(folder)


def clear(folder: Path) -> None:
    for path in folder.iterdir():
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def taken(folder: Path) -> int:
    """Bytes of a disk that the files in a folder take."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return sum(-(-path.stat().st_size // PAGE_BYTES) * PAGE_BYTES for path in files)


@contextmanager
def disk(folder: Path, own: bool) -> Iterator[Any]:
    """The folder as a disk of its own if asked for, and a function that changes its size."""

    def mount(size: int, how: str = "") -> None:
        command = ["mount", "-t", "tmpfs", "-o", f"{how}size={size}", "tmpfs", str(folder)]
        subprocess.run(command, check=True)

    if not own:
        yield lambda _: None
        return
    mount(ROOM)
    try:
        yield lambda size: mount(size, "remount,")
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@dataclass
class Tally:
    """Of a command."""

    struck: dict[str, int]
    idle: int = 0  # faults that struck nothing
    lost: list[str] = field(default_factory=list)


def tried(bench: Bench, job: Job, number: int, rng: random.Random) -> Tally:
    """So many faults of each kind."""
    found = Tally(dict.fromkeys(KINDS, 0))
    for kind, index in itertools.product(job.kinds, range(number)):
        old = index % 2 == 1
        for _ in range(TRIES):
            fault = bench.fault(job, kind, old, rng)
            problem, struck = bench.survives(job, fault, old)
            found.struck[kind] += struck
            found.idle += not struck
            if problem:
                found.lost.append(f"{job.name}: {fault}: {problem}")
                print(found.lost[-1])
                clear(bench.work)
            if struck or problem:
                break
    return found


def main() -> None:
    given = [int(word) for word in sys.argv[1:] if word.isdigit()]
    number, seed = [*given, *DEFAULTS[len(given) :]][:2]
    rng = random.Random(seed)
    rows, lost = [], 0
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder))
        for job in JOBS:
            own = number if job.exact else -(-number // 5)  # a page takes long
            found = tried(bench, job, own, rng)
            lost += len(found.lost)
            survived = sum(found.struck.values()) - len(found.lost)
            counts = found.struck.items()
            struck = [count if kind in job.kinds else "–" for kind, count in counts]
            rows.append([f"`prtnet {job.name}`", *struck, survived, len(found.lost), found.idle])
            print(*rows[-1], flush=True)
        if bench.cluster is not None:
            bench.cluster.close()
    columns = ["command", *KINDS, "survived", "lost", "faults that struck nothing"]
    publish("faults", columns, rows, f"Seed {seed}.", PAGE)
    sys.exit(1 if lost else 0)


if __name__ == "__main__":
    main()
