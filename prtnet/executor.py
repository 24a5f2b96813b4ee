"""Where independent tasks run: in threads of this process, or on the workers of a Dask cluster.

A task does one numbered piece of work and leaves its result where it was told to. So data never
travels through the scheduler, and a task that runs twice, because its worker died, writes the same
bytes in the same place.
"""

from __future__ import annotations

import contextlib
import functools
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from importlib.metadata import PackageNotFoundError
from itertools import islice
from typing import Any, Protocol

from prtnet.console import Report, silent
from prtnet.cores import use_blas_threads
from prtnet.errors import PrtnetError
from prtnet.provenance import made_with

__all__ = ["Cluster", "Local", "Task", "Tasks", "executor"]

PATIENCE = "10s"  # for an answer of the scheduler
OF_PROCESS = {"prtnet", "python", "machine"}  # facts that are no packages
LOOK = 10.0  # seconds between looks at whether there is a worker
WAITING = "waiting for a worker of the cluster"
AHEAD = 2000  # tasks the scheduler knows of at a time: it keeps each in its memory


class Task(Protocol):
    """Does a numbered piece of work; can be sent to another process."""

    def __call__(self, number: int, pool: Executor) -> None:
        """Do it.

        Args:
            number: which piece.
            pool: to run parts of it in.
        """


class Tasks(Protocol):
    """Runs tasks."""

    def run(self, task: Task, numbers: Sequence[int], ahead: int = 1) -> Iterator[int]:
        """Do all pieces, and give the number of each when it is done.

        Args:
            task: what to do.
            numbers: the pieces.
            ahead: pieces under way at a time where they share the threads of one pool.

        Raises:
            PrtnetError: whatever the task raises, and where no cluster answers.
        """


class Local:
    """Threads of this process: pieces in order, their parts side by side.

    Args:
        threads: that do the work.
    """

    def __init__(self, threads: int) -> None:
        self.threads = threads

    def run(self, task: Task, numbers: Sequence[int], ahead: int = 1) -> Iterator[int]:
        """See :class:`Tasks`."""
        # Two pools: a piece that waits for its parts must not keep them from a thread.
        with ThreadPoolExecutor(self.threads) as pool, ThreadPoolExecutor(ahead) as pieces:
            waiting: list[tuple[int, Future[None]]] = []
            try:
                for number in numbers:
                    waiting.append((number, pieces.submit(task, number, pool)))
                    if len(waiting) > ahead:
                        done, future = waiting.pop(0)
                        future.result()
                        yield done
                for done, future in waiting:
                    future.result()
                    yield done
            finally:
                for _, future in waiting:
                    future.cancel()


class Serial(Executor):
    """Runs what is submitted at once: on a worker, pieces are what runs side by side."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """The result of the call, as a future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def on_worker(task: Task, number: int, made: tuple[tuple[str, str], ...]) -> int:
    """What a worker of a cluster runs, if it has these versions."""
    require_same(made)
    use_blas_threads(1)  # a worker's threads are its tasks
    task(number, Serial())
    return number


@functools.cache
def require_same(made: tuple[tuple[str, str], ...]) -> None:
    """Refuse to work with other versions than those ``made`` by: bytes would differ.

    Raises:
        PrtnetError: one differs.
    """
    for name, wanted in made:
        try:
            own = made_with(*{name} - OF_PROCESS)[name]
        except PackageNotFoundError:
            own = "not there"
        if own != wanted:
            what = f"{name} is {own} on a worker and {wanted} here"
            raise PrtnetError("--cluster", f"{what}; make them the same")


class Cluster:
    """Workers of a Dask cluster: pieces in whatever order they are done.

    Args:
        address: of its scheduler, ``tcp://host:port``.
        packages: that decide the bytes of results, so that workers must have the same.
        report: told while there is no worker.
    """

    def __init__(self, address: str, packages: Sequence[str] = (), report: Report = silent) -> None:
        self.address, self.report = address, report
        self.made = tuple(made_with(*packages).items())

    def run(self, task: Task, numbers: Sequence[int], ahead: int = 1) -> Iterator[int]:
        """See :class:`Tasks`. A piece whose worker dies is done by another."""
        del ahead  # the scheduler keeps every thread of its workers busy
        try:
            from distributed import Client, as_completed
        except ImportError as error:
            raise PrtnetError(
                "--cluster", "needs the extra: pip install prtnet[cluster]"
            ) from error
        try:
            client = Client(self.address, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            what = f"no scheduler answers at {self.address}"
            raise PrtnetError("--cluster", f"{what}; start one with dask scheduler") from error
        left = iter(numbers)

        def submitted(number: int) -> Any:
            return client.submit(on_worker, task, number, self.made, pure=False)

        with client, watched(client, self.report):
            running = as_completed(map(submitted, islice(left, AHEAD)), loop=client.loop)
            for future in running:
                yield result(future)
                for number in islice(left, 1):
                    running.add(submitted(number))


@contextlib.contextmanager
def watched(client: Any, report: Report) -> Iterator[None]:
    """Tells when a cluster has no worker: some may be to come, or all have gone."""
    ended = threading.Event()

    def look() -> None:
        waiting = False
        with contextlib.suppress(Exception):  # who waits for results is told what is wrong
            while not ended.wait(LOOK):
                ask = client.scheduler.identity
                found = client.sync(ask, n_workers=1, callback_timeout=LOOK)["workers"]
                if waiting or not found:
                    report(WAITING, int(bool(found)), 1)
                waiting = not found

    watch = threading.Thread(target=look, name="watch", daemon=True)
    watch.start()
    try:
        yield
    finally:
        ended.set()
        watch.join(1.0)  # the scheduler may be silent


def result(future: Any) -> int:
    """Of a future that is done; what the cluster says about itself as one line."""
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError

    try:
        return int(future.result())
    except KilledWorker as error:
        what = "several workers died one after the other at the same task"
        raise PrtnetError("--cluster", f"{what}; see their logs, then start again") from error
    except (FutureCancelledError, OSError) as error:
        what = f"the scheduler is gone ({type(error).__name__})"
        raise PrtnetError("--cluster", f"{what}; start it and this again") from error


def executor(
    cluster: str | None, threads: int, packages: Sequence[str] = (), report: Report = silent
) -> Tasks:
    """Threads of this process, or the cluster of that address, as :class:`Cluster` has it."""
    return Local(threads) if cluster is None else Cluster(cluster, packages, report)
