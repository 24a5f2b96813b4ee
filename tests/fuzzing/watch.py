"""What a reader may do with a file: read it and what lies beside it, or refuse it in one line.

An audit hook sees every file that Python opens and every step towards the network, other programs
and pickles. Nothing else of Python can be watched from inside: memory and time have limits of the
process (``bounded``), and ``bench/fuzz.py`` ends processes.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from prtnet.errors import PrtnetError

__all__ = ["WATCH", "BreachError", "bounded", "outcome"]

FORBIDDEN = (
    "socket.connect", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto",
    "urllib.Request", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork",
    "pickle.find_class",
)  # fmt: skip
CHANGES = ("os.remove", "os.rmdir", "os.rename", "os.mkdir", "os.truncate", "os.symlink", "os.link",
           "os.chmod", "os.chown", "shutil.copyfile")  # fmt: skip
FOLLOWED = ("open", "os.truncate", "os.chmod", "os.chown")  # to where a link leads
MODULES = (".py", ".pyc", ".so")  # that are imported late
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
LONGEST = 2000  # characters of a line that somebody reads


class BreachError(Exception):
    """A reader did what no file may make it do."""


class Watch:
    """The audit hook; a process has one, since none can be taken out again."""

    def __init__(self) -> None:
        self.folder: str | None = None
        self.writable = False
        self.opened: list[str] = []
        self.breaches: list[str] = []

    def __call__(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note what is out of bounds while a folder is watched."""
        if self.folder is None:
            return
        if event in FORBIDDEN or (event in CHANGES and not self.may_change(event, arguments)):
            self.breaches.append(f"{event} {arguments!r:.200}")
        elif event == "open" and isinstance(arguments[0], (str, bytes)):
            name, flags = os.fsdecode(arguments[0]), arguments[2]
            if "\0" in name or name == os.devnull or name.endswith(MODULES):
                return
            self.opened.append(name)
            roots = tuple(f"{root}/" for root in (self.folder, sys.prefix, sys.base_prefix))
            # A folder that is deleted, of one that was opened.
            deleted = self.writable and "/" not in name and not flags & WRITES
            inside = deleted or f"{os.path.realpath(name)}/".startswith(roots)
            if not inside or (flags & WRITES and not self.may_change("open", (name,))):
                self.breaches.append(f"open {name[:200]}")

    def may_change(self, event: str, arguments: tuple[Any, ...]) -> bool:
        """Whether the files that an event names may change: those in the folder, of a writer.

        Trees are deleted by names relative to a folder that was opened, which was looked at then.
        """
        if not self.writable:
            return False
        names = [one for one in arguments if isinstance(one, (str, bytes, os.PathLike))]
        names = [os.fsdecode(one) for one in names[event == "os.symlink" :]]
        if event in ("os.remove", "os.rmdir") and arguments[-1] != -1:
            return "/" not in names[0]
        if event not in FOLLOWED:  # a link itself, or a new name
            names = [os.path.dirname(name) for name in names]
        places = [os.path.realpath(name) for name in names]
        return all(f"{place}/".startswith(f"{self.folder}/") for place in places)


WATCH = Watch()
sys.addaudithook(WATCH)


@contextlib.contextmanager
def watched(folder: Path, writable: bool = False) -> Iterator[None]:
    """Only files of a folder may be opened, to be written only where it is ``writable``.

    Raises:
        BreachError: something else was done.
    """
    WATCH.breaches.clear()
    WATCH.opened.clear()
    WATCH.folder, WATCH.writable = os.path.realpath(folder), writable
    try:
        yield
    finally:
        WATCH.folder = None
        if WATCH.breaches:
            raise BreachError("; ".join(WATCH.breaches[:3]))


@contextlib.contextmanager
def bounded(room: int) -> Iterator[None]:
    """No more address space than is taken now and ``room`` bytes."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + room, most))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (before, most))


def outcome(use: Callable[[Path], object], path: Path, writes: bool = False) -> str:
    """``read`` or ``refused``; what else a reader does passes through.

    Args:
        use: the reader.
        path: of its file.
        writes: whether it may change files beside that one.

    Raises:
        BreachError: it left the file's folder, its refusal is no line that can be printed, or it
            asked for more memory than there is.
        Exception: any other that it raised, or any warning.
    """
    with watched(path.parent, writes), warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            use(path)
        except PrtnetError as error:
            words = str(error)
            words.encode()
            if "\n" in words or len(words) > LONGEST:
                raise BreachError(f"a refusal of {len(words)} characters: {words:.200}") from error
            if any(isinstance(cause, MemoryError) for cause in causes(error)):
                raise BreachError(f"out of memory, and then: {words:.200}") from error
            return "refused"
    return "read"


def causes(error: BaseException) -> Iterator[BaseException]:
    """What an error was raised for, and that for."""
    while (cause := error.__cause__ or error.__context__) is not None:
        yield cause
        error = cause
