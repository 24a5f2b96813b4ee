"""Outputs appear under their final name only when whole; inputs are named by their hash."""

from __future__ import annotations

import contextlib
import errno
import glob
import hashlib
import os
import platform
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from prtnet.errors import PrtnetError

__all__ = ["file_sha256", "finish", "on_disk", "read_bytes", "writing"]


def read_bytes(path: str | Path, most: int) -> bytes | None:
    """A file's bytes; None where there are more than ``most``, or it is no file that has an end.

    Raises:
        OSError: it cannot be read.
    """
    if Path(path).is_fifo():
        return None  # to open one waits for who writes to it
    with open(path, "rb") as file:
        told = os.fstat(file.fileno())
        return None if told.st_size > most or stat.S_ISCHR(told.st_mode) else file.read()


def file_sha256(path: str | Path) -> str:
    """Hexadecimal SHA-256 of a file's bytes."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def remove(path: Path) -> None:
    """Delete a file or a folder; nothing happens where there is none."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def finish(partial: Path, final: Path) -> None:
    """Put a whole file or folder under its final name, replacing what stood there.

    Neither is ever deleted before the other is in place. A process killed between the two renames
    leaves both, under hidden names. What is in them is on the disk before they are renamed: a loss
    of power leaves nothing empty under a final name.
    """
    for path in (partial, *(partial.rglob("*") if partial.is_dir() else ())):
        on_disk(path)
    try:
        replace(partial, final)
    finally:
        on_disk(final.parent)


def on_disk(path: Path) -> None:
    """Wait until a file's bytes, or a folder's names, are on the disk, where a system can tell."""
    if os.name != "posix" or path.is_symlink() or not (path.is_file() or path.is_dir()):
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EBADF):  # of folders some file systems cannot
            raise
    finally:
        os.close(handle)


def replace(partial: Path, final: Path) -> None:
    """The renames of :func:`finish`."""
    if not (final.is_dir() or partial.is_dir()):
        os.replace(partial, final)
        return
    aside = final.with_name(f".{final.name}.replaced")  # a folder cannot be renamed over
    if os.path.lexists(final):
        remove(aside)
        os.replace(final, aside)
    try:
        os.replace(partial, final)
    except BaseException:
        if aside.exists():
            os.replace(aside, final)
        raise
    remove(aside)


def runs(process: str) -> bool:
    """Whether a process of this machine, by its number, may still be there."""
    if os.name != "posix" or not process.isdecimal():
        return True  # elsewhere signal 0 is no question, but the end of the process
    try:
        os.kill(int(process), 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


@contextlib.contextmanager
def writing(path: str | Path) -> Iterator[Path]:
    """A temporary path beside ``path``; renamed to it when the block ends well, deleted otherwise.

    What a process that was killed left of the same output is deleted.

    Raises:
        PrtnetError: the folder does not exist or cannot be written.
    """
    final = Path(path)
    mine = f".{final.name}.{platform.node()}-"
    partial = final.with_name(f"{mine}{os.getpid()}.partial{final.suffix}")
    if final.is_dir() and not os.access(final.parent, os.W_OK):
        raise PrtnetError(final, "is a folder that cannot be replaced; give another --out")
    try:
        if not final.parent.is_dir():
            raise FileNotFoundError(2, f"the folder {final.parent} does not exist")
        for left in final.parent.glob(f"{glob.escape(mine)}*.partial{glob.escape(final.suffix)}"):
            if not runs(left.name.removeprefix(mine).partition(".")[0]):
                remove(left)
        yield partial
        finish(partial, final)
    except OSError as error:
        remove(partial)
        reason = error.strerror or str(error)
        raise PrtnetError(final, f"cannot be written ({reason}); give another --out") from error
    except BaseException:
        remove(partial)
        raise
