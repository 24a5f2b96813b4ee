"""Datasets in a store: the same bytes as in a folder, whatever ends the run that writes them."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from prtnet.block_files import read_block, read_part, write_block
from prtnet.cli import run
from prtnet.dataset import POSE_ARRAYS, Dataset
from prtnet.dataset_repair import DatasetRepair
from prtnet.dataset_writer import MARKERS
from prtnet.errors import PrtnetError
from prtnet.places import children, is_remote, place, there
from tests import store as _store  # noqa: F401 - registers farm://
from tests.prtnet import test_dataset
from tests.prtnet.test_dataset import ATTRIBUTES, BLOCK, POSES, filled, fixed, part, whole, writer

pytestmark = pytest.mark.filterwarnings("ignore:UPath 'farm' filesystem")
memory = pytest.importorskip("fsspec.implementations.memory")
pytest.importorskip("upath", reason="needs the extra 'remote'")
NUMBER = itertools.count()


class Killed(BaseException):
    """No error: the process is gone."""


class GoneError(Exception):
    """Of a client that has exceptions of its own."""


@pytest.fixture
def farm() -> Iterator[Path]:
    """An empty place in a store."""
    folder = place(f"memory://farm{next(NUMBER)}/deep")
    yield folder
    memory.MemoryFileSystem.store.clear()


@pytest.fixture(params=["memory", "farm"])
def either(request: pytest.FixtureRequest, farm: Path, tmp_path: Path) -> Path:
    """The same, or one whose clients remember what they listed."""
    return farm if request.param == "memory" else place(f"farm://{tmp_path}/store")


def contents(folder: Any) -> dict[str, bytes]:
    root = f"{folder.path}/"
    found = folder.fs.find(folder.path)
    return {name.removeprefix(root): folder.fs.cat_file(name) for name in found}


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in children(folder))


def repair(path: Path, **attributes: object) -> list[str]:
    book = DatasetRepair(path, {**ATTRIBUTES, **attributes}, fixed(), POSES, BLOCK)
    filled(book).finish()
    return book.mended


def test_the_same_bytes_as_in_a_folder(either: Path, tmp_path: Path) -> None:
    far, near = test_dataset.write(either / "set.zarr"), test_dataset.write(tmp_path / "set.zarr")
    for name in POSE_ARRAYS:
        np.testing.assert_array_equal(far.read(name, slice(3, 9)), near.read(name, slice(3, 9)))
    files = (path for path in near.path.rglob("*") if path.is_file())
    own = {path.relative_to(near.path).as_posix(): path.read_bytes() for path in files}
    assert contents(far.path) == own
    assert names(either) == ["set.zarr"]


@pytest.mark.parametrize("remote", [False, True])
def test_an_equal_writer_goes_on_and_another_starts_over(
    either: Path, tmp_path: Path, remote: bool
) -> None:
    path = (either if remote else tmp_path) / "set.zarr"
    first = writer(path)
    first.write(1, part(whole(), first.span(1)))
    assert not there(path)
    assert writer(path).missing() == [0, 2]
    second = writer(path, rays=65)
    assert second.missing() == [0, 1, 2]
    with pytest.raises(PrtnetError, match="begun anew by another run"):
        first.write(0, part(whole(), first.span(0)))  # a task that nobody has told
    assert second.missing() == [0, 1, 2]


@pytest.mark.parametrize("remote", [False, True])
def test_two_equal_runs_lose_nothing(either: Path, tmp_path: Path, remote: bool) -> None:
    path = (either if remote else tmp_path) / "set.zarr"
    books = writer(path), writer(path)
    for block in books[0].missing():
        for book in books:
            book.write(block, part(whole(), book.span(block)))
    books[0].finish()
    with pytest.raises(PrtnetError, match="was finished or begun anew by another run"):
        books[1].finish()
    np.testing.assert_array_equal(Dataset.open(path).read("pose"), whole().pose)


@pytest.mark.parametrize("remote", [False, True])
def test_who_reads_a_dataset_that_is_replaced_is_told(
    either: Path, tmp_path: Path, remote: bool
) -> None:
    dataset = test_dataset.write((either if remote else tmp_path) / "set.zarr")
    assert dataset.read("pose").any()
    test_dataset.write(dataset.path, rays=65)
    with pytest.raises(PrtnetError, match="was replaced while it was read; start again"):
        dataset.read("pose")
    (dataset.path / "zarr.json").unlink()
    with pytest.raises(PrtnetError, match="was replaced while it was read; start again"):
        dataset.read("pose", slice(2))


def test_a_restart_with_other_options_that_is_killed_while_it_begins(
    farm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a run that was killed while it copied."""
    path = farm / "set.zarr"
    book = filled(writer(path))
    with monkeypatch.context() as patch:
        patch.setattr(memory.MemoryFileSystem, "_rm", gone)
        patch.setattr(memory.MemoryFileSystem, "cp_file", gone)
        with pytest.raises(PrtnetError, match="nobody answers"):
            book.finish()
    (path / "pose").mkdir(parents=True, exist_ok=True)
    (path / "pose" / "zarr.json").write_text("half")
    with monkeypatch.context() as patch:
        patch.setattr("prtnet.dataset_writer.create", killed)
        with pytest.raises(Killed):
            writer(path, rays=65)
    assert test_dataset.write(path).rays == ATTRIBUTES["rays"]
    assert names(farm) == ["set.zarr"]


def killed(*_: Any) -> Any:
    raise Killed


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("survived", [0, 1, 2, 5, 20, 21, 40, 60])
def test_a_run_killed_while_it_finishes_loses_nothing(
    farm: Path, monkeypatch: pytest.MonkeyPatch, survived: int, old: bool
) -> None:
    """After so many files copied or deleted nothing happens any more."""
    path = farm / "set.zarr"
    if old:
        test_dataset.write(path, rays=1)
    book = filled(writer(path))
    left = iter(range(survived))
    system = memory.MemoryFileSystem

    def mortal(step: Any) -> Any:
        def tried(*arguments: Any, **options: Any) -> Any:
            if next(left, None) is None:
                raise Killed
            return step(*arguments, **options)

        return tried

    with monkeypatch.context() as patch:
        patch.setattr(system, "cp_file", mortal(system.cp_file))
        patch.setattr(system, "_rm", mortal(system._rm))
        patch.setattr(system, "rm_file", mortal(system.rm_file), raising=False)
        try:
            book.finish()
            ended = True
        except Killed:
            ended = False
    if (path / "zarr.json").is_file():
        assert Dataset.open(path).rays in (1, ATTRIBUTES["rays"])
        Dataset.open(path).read("visibility")
    assert ended or writer(path).missing() == [] or Dataset.open(path).rays == ATTRIBUTES["rays"]
    assert test_dataset.write(path).rays == ATTRIBUTES["rays"]
    assert names(farm) == ["set.zarr"]
    assert MARKERS not in names(path)


def test_damage_is_named_and_mended(farm: Path) -> None:
    path = test_dataset.write(farm / "set.zarr").path
    before = contents(path)
    assert repair(path) == []
    (path / "pose/c/1/0").write_bytes(b"nothing")
    with pytest.raises(PrtnetError, match="'pose' is damaged in block 1; repeat"):
        Dataset.open(path).read("pose")
    (path / "rest_pose/c/0").unlink()
    (path / "time/zarr.json").write_bytes(b"{}")
    with pytest.raises(PrtnetError, match=r"time/zarr.json is damaged; repeat"):
        Dataset.open(path)
    with pytest.raises(PrtnetError, match="was made with rays 64"):
        repair(path, rays=65)
    assert set(repair(path)) == {"block 1 of pose", "rest_pose/c/0", "time/zarr.json"}
    assert contents(path) == before
    (path / "pose/c/1/0").unlink()
    with pytest.raises(PrtnetError, match="'pose' is not whole"):
        Dataset.open(path)


def test_an_array_that_claims_more_than_its_files_hold(
    farm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = test_dataset.write(farm / "set.zarr").path
    monkeypatch.setattr("prtnet.dataset_checks.SMALL", 0)
    monkeypatch.setattr("prtnet.dataset_checks.LARGEST_RATIO", 1)
    Dataset.open(path)
    for name in [name for name in contents(path) if name.startswith("visibility/c/")]:
        (path / name).write_bytes(b"")
    with pytest.raises(PrtnetError, match=r"visibility claims 1152 bytes, in files of \d+"):
        Dataset.open(path)


def test_what_is_no_dataset_is_left_alone(farm: Path) -> None:
    (farm / "set.zarr").mkdir(parents=True)
    (farm / "set.zarr" / "diary.txt").write_text("dear diary")
    with pytest.raises(PrtnetError, match="is not a dataset; make one"):
        Dataset.open(farm / "set.zarr")
    with pytest.raises(PrtnetError, match="exists and is not a dataset; give another --out"):
        writer(farm / "set.zarr")
    with pytest.raises(PrtnetError, match=r"none.zarr: does not exist; make it"):
        Dataset.open(farm / "none.zarr")
    with pytest.raises(PrtnetError, match="is no dataset to repair"):
        repair(farm / "none.zarr")


@pytest.mark.parametrize("kind", [GoneError, PermissionError, TimeoutError])
@pytest.mark.parametrize("steps", ["cat_file", "info", "find", "cat_file info find exists _open"])
def test_a_store_that_fails_when_read_says_so_in_a_line(
    farm: Path, monkeypatch: pytest.MonkeyPatch, steps: str, kind: type[Exception]
) -> None:
    """And not that something was damaged."""

    def fails(*_: Any, **__: Any) -> Any:
        raise kind("nobody answers")

    dataset = test_dataset.write(farm / "set.zarr")
    for step in steps.split():
        monkeypatch.setattr(memory.MemoryFileSystem, step, fails)
    told = r"set.zarr: cannot be re(ad|ached) \(nobody answers\); check the"
    with pytest.raises(PrtnetError, match=told):
        Dataset.open(dataset.path)
    monkeypatch.setattr(zarr.Array, "__getitem__", fails)
    with pytest.raises(PrtnetError, match=told):
        dataset.read("pose")


@pytest.mark.parametrize("step", ["pipe_file", "info", "find", "cp_file", "_open"])
def test_a_store_that_fails_when_written_says_so_in_a_line(
    farm: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    monkeypatch.setattr(memory.MemoryFileSystem, step, gone)
    with pytest.raises(PrtnetError, match=r"set.zarr: cannot be written \(nobody answers\)"):
        test_dataset.write(farm / "set.zarr")


def gone(*_: Any, **__: Any) -> Any:
    raise GoneError("nobody answers")


def test_addresses_that_lead_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(PrtnetError, match=r"nope://x/a.zarr: cannot be reached"):
        place("nope://x/a.zarr")
    monkeypatch.setitem(sys.modules, "upath", None)
    with pytest.raises(PrtnetError, match=r"memory://x: needs the extra: pip install"):
        place("memory://x")
    assert not is_remote(place("a/b.zarr"))
    assert place("file:///a%20b/c.zarr") == Path("/a b/c.zarr")


def test_all_of_a_store_is_no_dataset() -> None:
    with pytest.raises(PrtnetError, match="memory://: is all of a store; name a folder in it"):
        place("memory://")


@pytest.mark.parametrize("rows", [None, slice(None), slice(2, 5), slice(4, 99), slice(7, 7)])
def test_blocks_are_read_in_parts(farm: Path, tmp_path: Path, rows: slice | None) -> None:
    rng = np.random.default_rng(3)
    arrays = {"a": rng.normal(size=(7, 3)).astype(np.float32), "b": np.arange(5),
              "none": np.zeros((0, 4), np.float16), "flags": rng.random((9, 2)) > 0.5}  # fmt: skip
    for folder in (farm, tmp_path):
        folder.mkdir(parents=True, exist_ok=True)
        write_block(folder / "x", {"seen": 3}, arrays)
        header, found = read_block(folder / "x")
        assert header == {"seen": 3}
        assert {name: array.tolist() for name, array in found.items()} == {
            name: array.tolist() for name, array in arrays.items()
        }
        for name, array in arrays.items():
            own = read_part(folder / "x", name, rows)
            assert own.dtype == array.dtype
            np.testing.assert_array_equal(own, array if rows is None else array[rows])
        with pytest.raises(PrtnetError, match="cannot be read; "):
            read_part(folder / "y", "a")
    assert (farm / "x").read_bytes() == (tmp_path / "x").read_bytes()
    (farm / "x").write_bytes(b"\xff" * 30)
    with pytest.raises(PrtnetError, match="cannot be read; "):
        read_part(farm / "x", "a")
    with pytest.raises(PrtnetError, match="is missing or damaged"):
        read_block(farm / "x")


def test_models_are_not_written_to_a_store(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = test_dataset.write(tmp_path / "set.zarr").path
    assert run(["train", str(data), "--out", "s3://farm/model.safetensors"]) == 2
    assert "only datasets may be in a store" in capsys.readouterr().err
