from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from prtnet import executor as module
from prtnet.errors import PrtnetError
from prtnet.executor import Cluster, Local, Serial, executor


@dataclass(frozen=True)
class Write:
    """Writes a file; two parts of it in the pool."""

    folder: Path

    def __call__(self, number: int, pool: Executor) -> None:
        if number == 13:
            raise PrtnetError("block 13", "brings bad luck; leave it out")
        parts = pool.map(str, [number, number * number])
        (self.folder / str(number)).write_text(" ".join(parts))


class Slow(Write):
    """Long enough to be looked at."""

    def __call__(self, number: int, pool: Executor) -> None:
        time.sleep(0.4)
        super().__call__(number, pool)


def written(folder: Path) -> dict[int, str]:
    return {int(path.name): path.read_text() for path in folder.iterdir()}


def wanted(numbers: range) -> dict[int, str]:
    return {number: f"{number} {number * number}" for number in numbers}


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("ahead", [1, 2, 50])
def test_threads_do_all_pieces_in_order(tmp_path: Path, threads: int, ahead: int) -> None:
    numbers = list(Local(threads).run(Write(tmp_path), range(11), ahead))
    assert numbers == list(range(11))
    assert written(tmp_path) == wanted(range(11))


def test_no_more_pieces_than_asked_for_are_under_way(tmp_path: Path) -> None:
    """Each waits for its two parts; memory is bounded by the pieces under way."""
    now, most, lock = 0, 0, threading.Lock()

    def task(number: int, pool: Executor) -> None:
        nonlocal now, most
        with lock:
            now, most = now + 1, max(most, now + 1)
        list(pool.map(str, range(3)))
        with lock:
            now -= 1

    assert len(list(Local(4).run(task, range(40), 2))) == 40
    assert most <= 2


def test_an_error_of_a_piece_ends_the_rest(tmp_path: Path) -> None:
    with pytest.raises(PrtnetError, match="block 13: brings bad luck"):
        list(Local(1).run(Write(tmp_path), range(10, 100)))
    assert set(range(10, 13)) <= written(tmp_path).keys() <= set(range(10, 17))


def test_serial_runs_at_once() -> None:
    pool = Serial()
    assert list(pool.map(str, [1, 2])) == ["1", "2"]
    with pytest.raises(ZeroDivisionError):
        pool.submit(lambda: 1 // 0).result()


def test_threads_are_the_default(tmp_path: Path) -> None:
    assert isinstance(executor(None, 2), Local)
    assert isinstance(executor("tcp://127.0.0.1:1", 2), Cluster)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0"
    ) as cluster:
        yield cluster


def test_a_cluster_does_the_same(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "AHEAD", 4)
    numbers = list(Cluster(cluster.scheduler_address).run(Write(tmp_path), range(12)))
    assert sorted(numbers) == list(range(12))
    assert written(tmp_path) == wanted(range(12))
    assert list(Cluster(cluster.scheduler_address).run(Write(tmp_path), [])) == []


def test_an_error_on_a_worker_is_told_as_it_was(cluster: Any, tmp_path: Path) -> None:
    with pytest.raises(PrtnetError, match="brings bad luck") as caught:
        list(Cluster(cluster.scheduler_address).run(Write(tmp_path), range(10, 15)))
    assert (caught.value.subject, caught.value.message) == (
        "block 13", "brings bad luck; leave it out",
    )  # fmt: skip


def test_a_cluster_without_workers_is_waited_for_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    monkeypatch.setattr(module, "LOOK", 0.05)
    told: list[tuple[str, int, int]] = []
    with distributed.LocalCluster(n_workers=0, processes=False, dashboard_address=":0") as empty:

        def report(what: str, done: int, total: int, _: str = "") -> None:
            told.append((what, done, total))
            if len(told) == 2:
                empty.scale(1)

        tasks = Cluster(empty.scheduler_address, report=report)
        late = threading.Timer(20.0, lambda: empty.scale(1))  # where nobody tells
        late.start()
        assert sorted(tasks.run(Slow(tmp_path), range(3))) == [0, 1, 2]
        late.cancel()
    assert {what for what, *_ in told} == {"waiting for a worker of the cluster"}
    assert [done for _, done, _ in told[:2]] == [0, 0]
    assert [done for _, done, _ in told].count(1) == 1
    assert told[-1][1] == 1


def test_no_scheduler_answers(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra 'cluster'")
    monkeypatch.setattr(module, "PATIENCE", "1s")
    with pytest.raises(PrtnetError, match="no scheduler answers at tcp://127"):
        list(Cluster("tcp://127.0.0.1:1").run(Write(tmp_path), [0]))
    with pytest.raises(PrtnetError, match="no scheduler answers at nonsense"):
        list(Cluster("nonsense").run(Write(tmp_path), [0]))
