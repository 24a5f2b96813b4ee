"""Where datasets are: folders of this machine, and of any store that fsspec reaches by a URL.

What a URL names has the methods of a ``pathlib.Path`` (universal_pathlib) and is called one here;
options of a store, such as keys, are fsspec's own to configure. Stores are taken to have no folders
but in the names of files, as object stores have none, and to take each file whole.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast
from urllib.parse import unquote, urlsplit

from prtnet.errors import MISFITS, PrtnetError
from prtnet.files import finish, remove

__all__ = [
    "COPYING", "children", "damage", "discard", "failures", "is_folder", "is_remote", "known",
    "place", "publish", "put", "reason", "remote", "remove_place", "sizes", "store", "there",
]  # fmt: skip

# What Zarr and Blosc make of damage: sizes below zero, or more than there is memory, among it.
DAMAGE: tuple[type[Exception], ...] = (RuntimeError, SystemError, MemoryError, *MISFITS)
COPYING = "copying"  # this file says that a folder's copy under its final name may be half there


def place(name: str | Path) -> Path:
    """What a file name or a URL (``s3://farm/robot.zarr``) names.

    Raises:
        PrtnetError: the extra or the package for this kind of URL is missing, or there is none.
    """
    if not isinstance(name, str):
        return name
    if name.startswith(("file://", "local://")):
        return Path(unquote(urlsplit(name).path))
    if "://" not in name:
        return Path(name)
    try:
        from upath import UPath
    except ImportError as error:
        raise PrtnetError(name, "needs the extra: pip install 'prtnet[remote]'") from error
    try:
        found = UPath(name)
        # Connects, or tells which package is missing. What it lists is not to be remembered: other
        # machines write there, and some clients take a file for absent that an old list has not.
        found.fs.dircache.use_listings_cache = False
        found.fs.invalidate_cache()
    except (ImportError, ValueError) as error:
        raise PrtnetError(name, f"cannot be reached ({error})") from error
    except Exception as error:  # every store has exceptions of its own
        raise PrtnetError(name, f"cannot be reached ({error}); check the address") from error
    if not found.name:
        raise PrtnetError(name, "is all of a store; name a folder in it")
    return cast(Path, found)


def is_remote(path: Path) -> bool:
    """Whether a place is in a store."""
    return not isinstance(path, Path)


def is_folder(path: Path) -> bool:
    """Whether it holds files; what is in a store is a dataset or of no use here."""
    return is_remote(path) or path.is_dir()


def remote(path: Path) -> Any:
    """A place in a store by its other type, which also has ``fs`` and the ``path`` in that."""
    return path


def store(path: Path) -> Any:
    """What Zarr opens."""
    return remote(path).fs.get_mapper(remote(path).path) if is_remote(path) else str(path)


def failures(path: Path) -> tuple[type[Exception], ...]:
    """What reading and writing there may raise; clients of stores have exceptions of their own."""
    return (Exception,) if is_remote(path) else (OSError,)


def reason(error: BaseException) -> str:
    """What an error says, without its number and file."""
    return getattr(error, "strerror", None) or str(error)


def damage(path: Path) -> tuple[type[Exception], ...]:
    """What reading raises where something is damaged: of a store no refusal, and no silence."""
    return (FileNotFoundError if is_remote(path) else OSError, *DAMAGE)


def there(path: Path) -> bool:
    """Whether there is such a file or folder; of a store no failure is taken for a no.

    Raises:
        Exception: whatever a store's client does where it cannot tell.
    """
    if not is_remote(path):
        return path.exists()
    try:
        remote(path).fs.info(remote(path).path)
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def known(path: Path) -> bool:
    """Whether there is such an input.

    Raises:
        PrtnetError: it is in a store that cannot tell.
    """
    try:
        return there(path)
    except failures(path) as error:
        raise PrtnetError(path, f"cannot be reached ({error}); check the address") from error


def children(folder: Path) -> Iterator[Path]:
    """What is in a folder; nothing where there is none."""
    return folder.iterdir() if there(folder) else iter(())


def sizes(folder: Path) -> dict[str, int]:
    """Bytes of all files below a folder, by their names within it."""
    if not is_remote(folder):
        files = (path for path in folder.rglob("*") if path.is_file())
        return {path.relative_to(folder).as_posix(): path.stat().st_size for path in files}
    root = remote(folder).path.rstrip("/") + "/"
    found = remote(folder).fs.find(root, detail=True)
    return {name.removeprefix(root): int(told["size"] or 0) for name, told in found.items()}


def remove_place(path: Path) -> None:
    """Delete a file or folder; nothing happens where there is none."""
    if not is_remote(path):
        remove(path)
    elif there(path):
        remote(path).fs.rm(remote(path).path, recursive=True)


def discard(folder: Path, marks: str) -> None:
    """Delete a folder, its marks first: nobody may go on with what is half deleted."""
    remove_place(folder / marks)
    remove_place(folder)


def put(file: Path, final: Path) -> None:
    """Move a small file; what is there is replaced."""
    if is_remote(final):
        final.write_bytes(file.read_bytes())
    else:
        os.replace(file, final)


def publish(partial: Path, final: Path, last: str, besides: str) -> None:
    """Put a whole folder under its final name, replacing what stood there.

    Stores cannot rename folders: one there is copied, ``last`` after all else, and then deleted.

    Args:
        partial: the folder.
        final: its name.
        last: the file that makes a folder what it is.
        besides: a folder in it that is left out: until nothing else is to be done, a killed run
            must find it. While a store copies there is a file ``COPYING`` in it.
    """
    if not is_remote(final):
        finish(partial, final)
        remove(final / besides)
        return
    fs, own, other = remote(final).fs, remote(partial).path, remote(final).path
    found = (name for name in sizes(partial) if not name.startswith(f"{besides}/"))
    names = [*sorted({*found} - {last}), last]
    (partial / besides / COPYING).touch()
    discard(final, last)
    for folder in sorted({os.path.dirname(name) for name in names}):
        fs.makedirs(f"{other}/{folder}".rstrip("/"), exist_ok=True)
    for some in (names[:-1], names[-1:]):
        fs.copy([f"{own}/{name}" for name in some], [f"{other}/{name}" for name in some])
    discard(partial, besides)
