"""Every reader on damaged and hostile files: each case is read, or refused in one line."""

from __future__ import annotations

import collections
import os
import socket
import traceback
from pathlib import Path

import pytest

from prtnet.errors import PrtnetError
from tests.fuzzing.files import Holed, Link, Place, target
from tests.fuzzing.readers import READERS
from tests.fuzzing.watch import BreachError, bounded, outcome

CASES = 300
ROOM = 1 << 30  # bytes that a reader may take for files of a few kilobytes


@pytest.fixture
def place(tmp_path: Path) -> Place:
    (tmp_path / "outside.bin").write_bytes(bytes(4096))
    return Place(tmp_path / "case")


@pytest.mark.parametrize("name", READERS)
def test_sound_files_are_read(place: Place, name: str) -> None:
    for files in READERS[name].sound:
        if name == "picture" and files.keys() & {"GIF.png", "EPS.png", "PCX.png", "DDS.png"}:
            assert outcome(READERS[name].use, place.hold(files)) == "refused"
        else:
            assert outcome(READERS[name].use, place.hold(files)) == "read", target(files)


@pytest.mark.parametrize("name", READERS)
def test_damaged_files(place: Place, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    reader = READERS[name]
    reader.use(place.hold(reader.sound[0]))  # imports what it needs
    counts: collections.Counter[str] = collections.Counter()
    with bounded(ROOM):
        for case in range(CASES):
            path = place.hold(reader.case(f"test {name} {case}"))
            try:
                counts[outcome(reader.use, path)] += 1
            except Exception as error:
                pytest.fail(f"case {case}: {''.join(traceback.format_exception(error))[-2000:]}")
    assert counts["read"] > 0
    assert counts["refused"] > CASES // 3
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", READERS)
def test_cases_are_the_same_again(name: str) -> None:
    assert READERS[name].case(3) == READERS[name].case(3)
    assert any(READERS[name].case(3) != READERS[name].case(seed) for seed in range(4, 9))


def leave(path: Path) -> None:
    (path.parent / "../outside.bin").read_bytes()


def link(path: Path) -> None:
    (path.parent / "link").read_bytes()


def write(path: Path) -> None:
    path.write_bytes(b"")


def call(path: Path) -> None:
    with socket.socket() as made:
        made.settimeout(1.0)
        made.connect_ex(("127.0.0.1", 9))


def run(path: Path) -> None:
    os.system("true")


def lines(path: Path) -> None:
    error = PrtnetError(path, "")
    raise type("Two", (PrtnetError,), {"__str__": lambda _: "two\nlines"})(path, "") from error


@pytest.mark.parametrize("misuse", [leave, link, write, call, run, lines])
def test_what_no_reader_may_do(place: Place, misuse: object) -> None:
    path = place.hold({"a": b"x", "link": Link("../outside.bin")})
    with pytest.raises(BreachError):
        outcome(misuse, path)  # type: ignore[arg-type]
    assert outcome(Path.read_bytes, place.hold({"a": b"x"})) == "read"


def test_memory_is_bounded() -> None:
    with bounded(ROOM), pytest.raises(MemoryError):
        bytearray(2 * ROOM)
    assert len(bytearray(2 * ROOM)) == 2 * ROOM  # not written to: no memory is taken


def test_a_place_holds_one_case_after_another(place: Place) -> None:
    place.hold({"a/b": b"1", "a/c": b"2"})
    path = place.hold({"a": Holed(10**12, {5: b"x"}), "d": Link("a")})
    assert path.stat().st_size == 10**12
    assert sorted(os.listdir(place.folder)) == ["a", "d"]
    with open(place.folder / "d", "rb") as file:
        assert file.read(7) == b"\0\0\0\0\0x\0"
