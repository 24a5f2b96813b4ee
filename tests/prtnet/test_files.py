from __future__ import annotations

import errno
import hashlib
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from prtnet.errors import PrtnetError
from prtnet.files import file_sha256, finish, on_disk, writing


def write(final: Path, text: str, error: BaseException | None = None) -> None:
    """Write a file the way the house does, and fail half-way if asked to."""
    with writing(final) as partial:
        partial.write_text(text)
        if error:
            raise error


def test_sha256_is_of_the_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"abc" * 100_000)
    assert file_sha256(path) == hashlib.sha256(b"abc" * 100_000).hexdigest()


def test_file_appears_whole(tmp_path: Path) -> None:
    final = tmp_path / "out.txt"
    with writing(final) as partial:
        partial.write_text("half")
        assert not final.exists()
        assert partial.parent == final.parent  # a rename across file systems is a copy
        assert partial.suffix == final.suffix  # writers that go by suffix choose the same format
    assert final.read_text() == "half"
    assert list(tmp_path.iterdir()) == [final]


def test_old_file_survives_a_failure(tmp_path: Path) -> None:
    final = tmp_path / "out.txt"
    final.write_text("old")
    with pytest.raises(ZeroDivisionError):
        write(final, "half", ZeroDivisionError())
    assert final.read_text() == "old"
    assert list(tmp_path.iterdir()) == [final]


def test_interrupt_leaves_nothing(tmp_path: Path) -> None:
    def stopped() -> None:
        with writing(tmp_path / "out") as partial:
            partial.mkdir()
            (partial / "chunk").write_text("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert list(tmp_path.iterdir()) == []


def test_what_killed_processes_left_is_deleted(tmp_path: Path) -> None:
    """And nothing of those that run, of other machines, or of other outputs."""
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    names = {
        f".out.txt.{platform.node()}-{ended.pid}.partial.txt": False,
        f".out.txt.{platform.node()}-{os.getppid()}.partial.txt": True,
        f".out.txt.another-{ended.pid}.partial.txt": True,
        f".my.out.txt.{platform.node()}-{ended.pid}.partial.txt": True,
        f".out.txt.{platform.node()}-mine.partial.txt": True,
    }
    for name in names:
        (tmp_path / name).touch()
    write(tmp_path / "out.txt", "x")
    assert {name: (tmp_path / name).exists() for name in names} == names


def test_folder_replaces_folder(tmp_path: Path) -> None:
    final = tmp_path / "out.zarr"
    final.mkdir()
    (final / "stale").write_text("x")
    with writing(final) as partial:
        partial.mkdir()
        (partial / "fresh").write_text("y")
    assert [path.name for path in final.iterdir()] == ["fresh"]


def test_old_folder_survives_a_failed_rename(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    final, partial = tmp_path / "a", tmp_path / "b"
    for folder in (final, partial):
        folder.mkdir()
        (folder / folder.name).touch()
    rename = os.replace

    def full(source: Path, target: Path) -> None:
        if source == partial:
            raise OSError(28, "No space left on device")
        rename(source, target)

    monkeypatch.setattr("prtnet.files.os.replace", full)
    with pytest.raises(OSError, match="No space"):
        finish(partial, final)
    assert (final / "a").exists()
    assert (partial / "b").exists()


def test_missing_folder_is_one_line(tmp_path: Path) -> None:
    final = tmp_path / "nowhere" / "out.txt"
    with pytest.raises(PrtnetError, match=r"does not exist.*give another --out") as caught:
        write(final, "x")
    assert caught.value.subject == str(final)
    assert "\n" not in str(caught.value)


def test_operating_system_error_names_the_final_file(tmp_path: Path) -> None:
    final = tmp_path / "out.txt"
    with pytest.raises(PrtnetError, match="No space left") as caught:
        write(final, "x", OSError(28, "No space left on device", str(tmp_path / "partial")))
    assert caught.value.subject == str(final)
    assert list(tmp_path.iterdir()) == []


def test_finish_replaces_a_file_by_a_folder(tmp_path: Path) -> None:
    final, partial = tmp_path / "a", tmp_path / "b"
    final.write_text("old")
    partial.mkdir()
    finish(partial, final)
    assert final.is_dir()
    assert not partial.exists()


@pytest.mark.parametrize("folder", [False, True])
def test_what_is_renamed_is_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: bool
) -> None:
    """A loss of power leaves nothing empty under a final name."""
    done: list[Path | str] = []
    monkeypatch.setattr("prtnet.files.on_disk", done.append)
    replace = os.replace
    monkeypatch.setattr(os, "replace", lambda a, b: (done.append("renamed"), replace(a, b)))
    with writing(tmp_path / "out") as partial:
        if folder:
            partial.mkdir()
            (partial / "a").write_text("1")
        else:
            partial.write_text("1")
    inside = [partial / "a"] if folder else []
    assert done == [partial, *inside, "renamed", tmp_path]


def test_files_and_folders_are_synced_where_that_is_possible(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[int] = []
    monkeypatch.setattr(os, "fsync", done.append)
    (tmp_path / "a").write_text("1")
    (tmp_path / "link").symlink_to("nowhere")
    for name in ("a", "link", "."):
        on_disk(tmp_path / name)
    assert len(done) == 2

    def fails(number: int) -> None:
        raise OSError(number, "")

    monkeypatch.setattr(os, "fsync", lambda _: fails(errno.EINVAL))
    on_disk(tmp_path)
    monkeypatch.setattr(os, "fsync", lambda _: fails(errno.EIO))
    with pytest.raises(OSError, match="Errno 5"):
        on_disk(tmp_path)
