"""Damaged and hostile files against every reader: each is read, or refused in one line.

    python bench/fuzz.py [--cases N] [--seed S] [--jobs J] [READER…] [--write]
    python bench/fuzz.py --case K READER    # one of them again, with its traceback

J readers at a time; cases of one run one after the other in a process of its own with 1 GB of
address space beside what sound files take, and four seconds of processor time each. Anything else
than success or one line of error is a failure: another exception, a warning, a word on the output
streams, a file outside the folder, a step towards the network or another program, a process that
dies. Its files are kept under bench/out/fuzz.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import json
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from bench.tables import OUT, ROOT, publish
from tests.fuzzing.files import Place
from tests.fuzzing.readers import READERS, Reader
from tests.fuzzing.watch import BreachError, bounded, outcome

PAGE = ROOT / "docs" / "reliability.md"
COLUMNS = ("reader", "inputs tried", "read", "refused in one line", "crashed or other",
           "slowest, ms", "peak, MB")  # fmt: skip
ROOM = 1 << 30  # bytes of address space
CASES, WRITTEN = 100_000, 1_000  # of a reader; of one that writes as well, which takes longer
SECONDS = 4.0  # of processor time: the largest picture takes up to two
SILENCE = 600.0  # seconds of the clock without a new case: it hangs


@dataclass
class Tally:
    """What became of the cases of a reader."""

    counts: collections.Counter[str] = field(default_factory=collections.Counter)
    failures: dict[int, str] = field(default_factory=dict)
    slowest: float = 0.0  # seconds
    peak: float = 0.0  # bytes beside what sound files take

    def add(self, told: dict[str, object]) -> None:
        """What a process told of its cases."""
        self.counts.update(told["counts"])  # type: ignore[arg-type]
        self.failures.update({int(k): v for k, v in told["failures"].items()})  # type: ignore[attr-defined]
        self.slowest = max(self.slowest, told["slowest"])  # type: ignore[type-var]
        self.peak = max(self.peak, told["peak"])  # type: ignore[type-var]

    def row(self, name: str) -> list[object]:
        """A row of the table."""
        read, refused = self.counts["read"], self.counts["refused"]
        numbers = [read + refused + len(self.failures), read, refused, len(self.failures)]
        cells = [f"{number:,}" for number in numbers]
        return [name, *cells, f"{1000 * self.slowest:.0f}", f"{self.peak / 1e6:.0f}"]


class Stage:
    """A folder for cases, with a file beside it that nobody may read."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "outside.bin").write_bytes(bytes(4096))
        self.place = Place(folder / "case")

    def warmed(self, reader: Reader) -> Stage:
        """After sound files have been read: what that imports and takes is not the cases'."""
        for files in reader.sound:
            with contextlib.suppress(BreachError):  # modules are imported
                outcome(reader.use, self.place.hold(files), reader.writes)
        return self


def worked(name: str, seed: int, first: int, end: int, folder: Path) -> None:
    """The cases of a process; it leaves the number under way in ``at``, the rest in ``told``."""
    reader, stage = READERS[name], Stage(folder / name)
    tally = Tally()
    with open(folder / "at", "r+b") as file:
        at = mmap.mmap(file.fileno(), 8)
    said = os.open(folder / "said", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(said, stream)
    stage.warmed(reader)
    resident = memory("VmRSS")
    with bounded(ROOM):
        for case in range(first, end):
            at[:] = case.to_bytes(8, "little")
            path = stage.place.hold(reader.case((seed, name, case)))
            os.ftruncate(said, 0)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)  # its signal ends the process
            start = time.process_time()
            try:
                tally.counts[outcome(reader.use, path, reader.writes)] += 1
                sys.stdout.flush()
                if os.fstat(said).st_size:
                    raise BreachError(f"printed {os.pread(said, 200, 0)!r}")
            except BaseException as error:
                tally.failures[case] = f"{type(error).__name__}: {error}"[:300]
                stage.place.copy(kept(name, case))
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            tally.slowest = max(tally.slowest, time.process_time() - start)
    tally.peak = memory("VmHWM") - resident
    (folder / "told").write_text(json.dumps(vars(tally)))


def memory(kind: str) -> int:
    """Bytes of this process: ``VmRSS``, what it has now, or ``VmHWM``, the most it had."""
    words = Path("/proc/self/status").read_text().split()
    return int(words[words.index(f"{kind}:") + 1]) * 1024


def kept(name: str, case: int) -> Path:
    """Where the files of a failure stay."""
    return OUT / "fuzz" / f"{name}-{case}"


def tried(name: str, seed: int, cases: int, folder: Path) -> Tally:
    """All cases of a reader; after one that ends its process another process goes on."""
    folder.mkdir()
    tally, first = Tally(), 0
    while first < cases:
        (folder / "at").write_bytes(first.to_bytes(8, "little"))
        (folder / "told").unlink(missing_ok=True)
        # Short runs, so that little is lost to a case that ends one.
        end = min(first + 5000, cases)
        words = [name, "--seed", str(seed), "--work", str(first), str(end), str(folder)]
        process = subprocess.Popen([sys.executable, __file__, *words])
        try:
            watched(process, lambda: (folder / "at").read_bytes())
        finally:
            process.kill()
        if process.wait() == 0 and (folder / "told").exists():
            tally.add(json.loads((folder / "told").read_text()))
            first = end
            continue
        case = int.from_bytes((folder / "at").read_bytes(), "little")
        why = {-signal.SIGPROF: f"over {SECONDS:g} s", -signal.SIGKILL: "hung or killed"}
        reason = why.get(process.returncode, f"exit {process.returncode}")
        tally.failures[case] = reason
        dead = Stage(folder / "dead").place
        dead.hold(READERS[name].case((seed, name, case)))
        dead.copy(kept(name, case))
        if case > first:  # those before it again, since their process told nothing
            tally.add(vars(tried_alone(name, seed, first, case, folder)))
        first = case + 1
    return tally


def tried_alone(name: str, seed: int, first: int, end: int, folder: Path) -> Tally:
    """Cases that are known to end well."""
    words = [name, "--seed", str(seed), "--work", str(first), str(end), str(folder)]
    subprocess.run([sys.executable, __file__, *words], check=True)
    tally = Tally()
    tally.add(json.loads((folder / "told").read_text()))
    return tally


def watched(process: subprocess.Popen[bytes], state: Callable[[], bytes]) -> None:
    """Wait for a process, or until it has shown nothing new for long."""
    last, since = state(), time.monotonic()
    while process.poll() is None:
        time.sleep(0.2)
        if state() != last:
            last, since = state(), time.monotonic()
        elif time.monotonic() - since > SILENCE:
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("readers", nargs="*", metavar="READER", help=", ".join(READERS))
    parser.add_argument("--cases", type=int, help=f"{CASES:,}; {WRITTEN:,} where it writes")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="readers at a time")
    parser.add_argument("--case", type=int, help="repeat one")
    parser.add_argument("--write", action="store_true", help="put the table into the docs")
    parser.add_argument("--work", nargs=3, help=argparse.SUPPRESS)
    words = parser.parse_args()
    names = words.readers or list(READERS)
    if unknown := set(names) - READERS.keys():
        parser.error(f"no reader is called {', '.join(sorted(unknown))}")
    if words.work:
        worked(names[0], words.seed, int(words.work[0]), int(words.work[1]), Path(words.work[2]))
        return
    with tempfile.TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None) as made:
        if words.case is not None:
            reader = READERS[names[0]]
            stage = Stage(Path(made)).warmed(reader)
            path = stage.place.hold(reader.case((words.seed, names[0], words.case)))
            with bounded(ROOM):
                print(outcome(reader.use, path, reader.writes))
            return
        start, rows, failed = time.perf_counter(), [], 0

        def cases(name: str) -> int:
            return words.cases or (WRITTEN if READERS[name].writes else CASES)

        with ThreadPoolExecutor(words.jobs) as pool:
            every = pool.map(
                lambda name: tried(name, words.seed, cases(name), Path(made) / name), names
            )
            for name, tally in zip(names, every, strict=True):
                rows.append(tally.row(name))
                failed += len(tally.failures)
                print(*rows[-1], sep="  ", flush=True)
                for case, what in sorted(tally.failures.items())[:20]:
                    print(f"  case {case}: {what}", flush=True)
    minutes = (time.perf_counter() - start) / 60
    publish("inputs", COLUMNS, rows, f"Seed {words.seed}, {minutes:.0f} minutes.", PAGE)
    sys.exit(failed > 0)


if __name__ == "__main__":
    main()
