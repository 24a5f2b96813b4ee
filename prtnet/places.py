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

from prtnet.errors import PrtnetError
from prtnet.files import finish, remove

__all__ = [
    "children", "failures", "is_folder", "is_remote", "place", "publish", "put", "remove_place",
    "sizes", "store",
]  # fmt: skip


def place(name: str | Path) -> Path:
    """What a file name or a URL (``s3://farm/robot.zarr``) names.

    Raises:
        PrtnetError: the extra or the package for this kind of URL is missing, or there is none.
    """
    if not isinstance(name, str):
        return name
    if "://" not in name:
        return Path(name)
    try:
        from upath import UPath
    except ImportError as error:
        raise PrtnetError(name, "needs the extra: pip install 'prtnet[remote]'") from error
    try:
        own: Any = {"auto_mkdir": True} if name.startswith(("file:", "local:")) else {}
        found = UPath(name, **own)
        found.fs  # noqa: B018 - connects, or tells which package is missing
    except (ImportError, ValueError) as error:
        raise PrtnetError(name, f"cannot be reached ({error})") from error
    except Exception as error:  # every store has exceptions of its own
        raise PrtnetError(name, f"cannot be reached ({error}); check the address") from error
    return cast(Path, found)


def is_remote(path: Path) -> bool:
    """Whether a place is named by a URL."""
    return not isinstance(path, Path)


def is_folder(path: Path) -> bool:
    """Whether it holds files; what has a URL is a dataset or of no use here."""
    return is_remote(path) or path.is_dir()


def remote(path: Path) -> Any:
    """A place by its other type."""
    return path


def store(path: Path) -> Any:
    """What Zarr opens."""
    return remote(path).fs.get_mapper(remote(path).path) if is_remote(path) else str(path)


def failures(path: Path, besides: tuple[type[Exception], ...] = ()) -> tuple[type[Exception], ...]:
    """What reading and writing there may raise; clients of stores have exceptions of their own."""
    return (Exception,) if is_remote(path) else (OSError, *besides)


def fresh(path: Path) -> Path:
    """The same place, where what other machines did meanwhile is seen."""
    if is_remote(path):
        remote(path).fs.invalidate_cache()
    return path


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
    elif fresh(path).exists():
        remote(path).fs.rm(remote(path).path, recursive=True)


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
            must find it.
    """
    if not is_remote(final):
        finish(partial, final)
        remove(final / besides)
        return
    fs, own, other = remote(final).fs, remote(partial).path, remote(final).path
    found = (name for name in sizes(fresh(partial)) if not name.startswith(f"{besides}/"))
    names = [*sorted({*found} - {last}), last]
    (final / last).unlink(missing_ok=True)
    remove_place(final)
    for folder in sorted({os.path.dirname(name) for name in names}):
        fs.makedirs(f"{other}/{folder}".rstrip("/"), exist_ok=True)
    for some in (names[:-1], names[-1:]):
        fs.copy([f"{own}/{name}" for name in some], [f"{other}/{name}" for name in some])
    remove_place(partial / besides)  # nobody goes on with what is half deleted
    remove_place(partial)


def children(folder: Path) -> Iterator[Path]:
    """What is in a folder, as it is now; nothing where there is none."""
    return fresh(folder).iterdir() if folder.exists() else iter(())
