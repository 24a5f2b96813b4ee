"""What a case of fuzzing puts on the disk: files, links, and files that are mostly holes."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["Files", "Holed", "Link", "Place", "target"]


@dataclass(frozen=True)
class Link:
    """A symbolic link, to a place relative to where it lies or to an absolute one."""

    to: str


@dataclass(frozen=True)
class Holed:
    """A file of any size that is zeros but for ``parts``, which begin at their keys."""

    size: int
    parts: dict[int, bytes] = field(default_factory=dict, hash=False)


Files = dict[str, "bytes | Link | Holed"]
"""By names relative to the folder of a case. The first name, or its folder, is what is read."""


def target(files: Files) -> str:
    """What of the files a reader is given."""
    return Path(next(iter(files))).parts[0]


class Place:
    """A folder that holds the files of one case after another; only what differs is written.

    Args:
        folder: empty, or to be made.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.folder.mkdir(parents=True, exist_ok=True)
        self._held: Files = {}

    def hold(self, files: Files) -> Path:
        """Make the folder hold these files and no others; the path to read."""
        for name in self._held.keys() - files.keys():
            (self.folder / name).unlink()
        for name, content in files.items():
            if self._held.get(name) != content:
                self._write(self.folder / name, content)
        self._held = dict(files)
        return self.folder / target(files)

    @staticmethod
    def _write(path: Path, content: bytes | Link | Holed) -> None:
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)  # empty ones, of another case
        path.unlink(missing_ok=True)  # rather than write through a link
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, Link):
            path.symlink_to(content.to)
        elif isinstance(content, Holed):
            with open(path, "wb") as file:
                file.truncate(content.size)
                for start, data in content.parts.items():
                    file.seek(start)
                    file.write(data)
        else:
            path.write_bytes(content)

    def copy(self, to: Path) -> None:
        """Keep the present files elsewhere, links as links."""
        shutil.rmtree(to, ignore_errors=True)
        Place(to).hold(self._held)  # holes stay holes
