"""Blocks of a long computation that other processes do, and files in a folder that pass between.

What all blocks are computed of is one file, of which a block reads its part; each result is
another. Names are hashes of all that decides what is in them, so the same work, after whatever
ended it, finds what was done before. Deep in a computation, :func:`exchange` tells whether it is
to be handed over.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from prtnet.block_files import read_block, read_part, write_block
from prtnet.console import Report
from prtnet.cores import side_by_side, thread_count
from prtnet.errors import PrtnetError
from prtnet.executor import Local, Tasks, executor
from prtnet.places import children, failures, is_remote, place, reason, remove_place
from prtnet.provenance import made_with

__all__ = ["Exchange", "Given", "Result", "Work", "elsewhere", "exchange", "in_parallel", "through"]

DIGITS = 32  # of a hash in a name
CURRENT: ContextVar[Exchange | None] = ContextVar("CURRENT", default=None)

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")
Result = tuple[dict[str, Any], dict[str, Any]]
"""What JSON can hold, and arrays by name."""


@dataclass(frozen=True)
class Given:
    """Arrays that all blocks are computed of, read when asked for; equal ones are the same.

    Attributes:
        path: of their file.
    """

    path: Path

    def __reduce__(self) -> tuple[Callable[[str], Given], tuple[str]]:
        """A name: each machine has its own way to a store."""
        return given_at, (str(self.path),)

    def __getitem__(self, name: str) -> Any:
        """A whole array; errors as of :meth:`part`."""
        return self.part(name)

    def part(self, name: str, rows: slice | None = None) -> Any:
        """Some rows of an array, as many as there are, or all of it.

        Raises:
            PrtnetError: this machine does not see the file.
        """
        return read_part(self.path, name, rows)


def given_at(name: str) -> Given:
    """What has arrived."""
    return Given(place(name))


class Work(Protocol):
    """A frozen dataclass of plain numbers that computes a block."""

    def __call__(self, number: int, given: Given) -> Result:
        """Block ``number``, by one thread."""


@dataclass(frozen=True)
class Piece:
    """The task: a block from one file to another.

    Attributes:
        work: that makes it.
        given: what of.
        result: the file of the result, before the block's number.
    """

    work: Work
    given: Given
    result: str

    def __call__(self, number: int, pool: Executor) -> None:
        """Do block ``number``; the other threads have blocks of their own."""
        del pool
        with side_by_side(1):
            write_block(self.path(number), *self.work(number, self.given))

    def path(self, number: int) -> Path:
        """Where the result of a block is."""
        return self.given.path.with_name(f"{self.result}-{number}")


@dataclass(frozen=True)
class Exchange:
    """Hands computations over.

    Attributes:
        tasks: what runs them.
        folder: that all of its machines see.
        made: by which versions.
    """

    tasks: Tasks
    folder: Path
    made: Mapping[str, Any]

    def there(self) -> set[str]:
        """Names of the files that are whole.

        Asked for one by one, a file server may remember for a while that there was none.
        """
        return {path.name for path in children(self.folder)}

    def put(self, arrays: Mapping[str, Any]) -> Given:
        """Arrays in a file that every machine sees.

        Raises:
            PrtnetError: it cannot be written.
        """
        solid = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        names = {name: [str(array.dtype), array.shape] for name, array in solid.items()}
        digest = hashlib.sha256(json.dumps(names, sort_keys=True).encode())
        for name in sorted(solid):
            digest.update(solid[name].tobytes())
        given = digest.hexdigest()[:DIGITS]
        if given not in self.there() or not whole(self.folder / given):
            write_block(self.folder / given, {}, solid)
        return Given(self.folder / given)

    def run(
        self, work: Work, arrays: Mapping[str, Any], count: int
    ) -> Iterator[tuple[int, dict[str, Any], dict[str, Any]]]:
        """Numbers and results of so many blocks, as they are done; those first that were before.

        Raises:
            PrtnetError: files cannot be written, or no cluster does the work.
        """
        given = self.put(arrays)
        text = [given.path.name, type(work).__name__, repr(work), dict(self.made)]
        result = hashlib.sha256(json.dumps(text, sort_keys=True).encode()).hexdigest()[:DIGITS]
        piece = Piece(work, given, result)
        there = self.there()
        paths = {number: piece.path(number) for number in range(count)}
        done = [number for number, path in paths.items() if path.name in there and whole(path)]
        left = sorted(set(range(count)) - set(done))
        for numbers in (done, self.tasks.run(piece, left, ahead=thread_count())):
            for number in numbers:
                yield number, *read_block(piece.path(number))

    def ordered(
        self,
        work: Work,
        arrays: Mapping[str, Any],
        count: int,
        told: Callable[[int], None] | None = None,
    ) -> Iterator[Result]:
        """The results of all blocks in their order; ``told`` how many are done, in any order."""
        waiting: dict[int, Result] = {}
        given = 0
        for done, (number, header, own) in enumerate(self.run(work, arrays, count), 1):
            waiting[number] = header, own
            if told is not None:
                told(done)
            while given in waiting:
                yield waiting.pop(given)
                given += 1


def exchange() -> Exchange | None:
    """What to hand blocks to here; None where they are to be computed in this process."""
    return CURRENT.get()


@contextlib.contextmanager
def through(tasks: Tasks, folder: Path, packages: Sequence[str] = ()) -> Iterator[None]:
    """Inside, blocks are handed to tasks.

    What that leaves in the folder is deleted if all ends well, else a next time goes on with it.

    Args:
        tasks: what runs them.
        folder: that all machines of theirs see by this name; made where there is none.
        packages: that decide the bytes of results.

    Raises:
        PrtnetError: the folder cannot be made.
    """
    folder = folder.resolve()
    try:
        folder.mkdir(exist_ok=True)
    except failures(folder) as error:
        told = f"cannot be made ({reason(error)}); give another --out or --exchange"
        raise PrtnetError(folder, told) from error
    token = CURRENT.set(Exchange(tasks, folder, made_with(*packages)))
    try:
        yield
    finally:
        CURRENT.reset(token)
    with contextlib.suppress(*failures(folder)):  # a file server may hold a name for a while
        remove_place(folder)


def whole(path: Path) -> bool:
    """Whether a file can be read: one that cannot, after a loss of power, is deleted."""
    try:
        read_block(path)
    except PrtnetError:
        if not is_remote(path):
            path.unlink(missing_ok=True)
        return False
    return True


def elsewhere(
    address: str | None,
    out: Path,
    packages: Sequence[str],
    threads: int,
    report: Report,
    where: Path | None = None,
    data: Path | None = None,
) -> contextlib.AbstractContextManager[None]:
    """What is handed over, as :func:`through`, to a Dask cluster; without one, but with a folder,
    to our own threads; nothing without either.

    Args:
        address: of the cluster.
        out: what is to be written.
        packages: that decide its bytes.
        threads: of this process.
        report: told while there is no worker.
        where: holds the hidden folder. Where none is named it lies beside ``out``, or beside
            ``data`` where that is in a store. Not beside ``out`` its name tells outputs of the same
            name apart, and beside ``data`` those of machines as well.
        data: what is read.
    """
    if address is None and where is None:
        return contextlib.nullcontext()
    tasks = executor(address, threads, packages, report)
    if where is None and data is not None and is_remote(data):
        where, owner = data.parent, f"{platform.node()}:{out.resolve()}"
    elif where is None:
        return through(tasks, out.with_name(f".{out.name}.blocks"), packages)
    else:
        owner = str(out.resolve())
    own = hashlib.sha256(owner.encode()).hexdigest()[:8]
    return through(tasks, where / f".{out.name}.{own}.blocks", packages)


def in_parallel(function: Callable[[Item], Outcome], items: Sequence[Item]) -> list[Outcome]:
    """The function of all items: in turn, or at once where it hands blocks to a cluster."""
    place = exchange()
    if place is None or isinstance(place.tasks, Local) or len(items) < 2:
        return [function(item) for item in items]
    contexts = [copy_context() for _ in items]
    with ThreadPoolExecutor(len(items)) as pool:
        return list(pool.map(lambda context, item: context.run(function, item), contexts, items))
