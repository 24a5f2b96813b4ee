"""Mends a dataset that is damaged on the disk: only what does not have its checksum is written.

The one who repairs knows how the dataset was made. Headers and the arrays that no pose changes are
made anew and compared byte by byte; blocks of poses whose checksums fail, or that are missing, are
for the caller to compute again.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from prtnet.console import Report, silent
from prtnet.dataset import (
    HEADERS,
    POSE_ARRAYS,
    SELF,
    Block,
    header_of,
    header_sums,
)
from prtnet.dataset_checks import check_folder, odd_header
from prtnet.dataset_writer import READING, DatasetWriter, create, make_room, writable
from prtnet.errors import PrtnetError
from prtnet.places import damage, is_remote, place, put, remove_place, sizes, store, there

__all__ = ["DatasetRepair"]


class DatasetRepair(DatasetWriter):
    """A writer of the blocks of a finished dataset that are damaged.

    Args:
        path: the dataset.
        attributes, fixed, poses, block: as they were given to the writer that made it.
        report: of progress, while what is there is read.

    Attributes:
        mended: what was damaged: files, and blocks of arrays.

    Raises:
        PrtnetError: there is none, it was made otherwise, or it cannot be written.
    """

    def __init__(
        self,
        path: str | Path,
        attributes: Mapping[str, Any],
        fixed: Mapping[str, np.ndarray[Any, Any]],
        poses: int,
        block: int,
        report: Report = silent,
    ) -> None:
        self.path = self._folder = place(path).resolve()
        self.poses, self.block = poses, block
        self.mended: list[str] = []
        with self._disk():
            known = there(header_of(self.path, ""))
        if not known:
            raise PrtnetError(path, "is no dataset to repair; leave out --repair to make it")
        check_folder(self.path)
        sound = self.path.with_name(f".{self.path.name}.repair")
        with self._disk():
            remove_place(sound)
            try:
                create(sound, attributes, fixed, poses, block)
                self._require_same(sound)
                self._mend(sound)
            finally:
                remove_place(sound)
            self._group = zarr.open_group(store(self.path), mode="r+", zarr_format=3)
        self.bad: dict[int, list[str]] = {}
        for number in range(self.blocks):
            if names := [name for name in POSE_ARRAYS if not self._whole(name, number)]:
                self.bad[number] = names
            report(READING, number + 1, self.blocks)

    def _require_same(self, sound: Path) -> None:
        """Refuse a dataset that was made with other options or versions than are given now."""
        wanted = dict(zarr.open_group(store(sound), mode="r").attrs)
        try:
            if odd_header(self.path) is not None:
                raise ValueError("a header that is none")
            group = zarr.open_group(store(self.path), mode="r", zarr_format=3)
            found: dict[str, Any] = dict(group.attrs)
            known = header_sums(self.path, found)[SELF]
            intact = found[HEADERS][SELF] == known
        except damage(self.path):
            intact = False
        if intact:
            other = sorted(
                name
                for name in {*wanted, *found} - {HEADERS}
                if wanted.get(name) != found.get(name)
            )
            if other:
                what = ", ".join(f"{name} {found.get(name)}" for name in other[:3])
                raise PrtnetError(
                    self.path, f"was made with {what}; repeat the command line that made it"
                )
        # The header of this array has the fingerprint of everything that decides the content.
        told = header_of(self.path, "visibility")
        same = self._same(told, header_of(sound, "visibility"))
        if not (intact or same):
            raise PrtnetError(
                self.path, "was made with other options, or too much is damaged; generate it again"
            )

    def _mend(self, sound: Path) -> None:
        """Put the headers and fixed arrays of ``sound`` where the dataset's differ from them."""
        for name in sorted(sizes(sound)):
            file, own = sound / name, self.path / name
            if not self._same(own, file):
                own.parent.mkdir(parents=True, exist_ok=True)
                make_room(own)
                put(file, own)
                self.mended.append(name)

    def _same(self, own: Path, sound: Path) -> bool:
        """Whether a file of the dataset is as it should be; one of another size is not read."""
        if not is_remote(own) and not (
            own.is_file() and own.stat().st_size == sound.stat().st_size
        ):
            return False
        return there(own) and own.read_bytes() == sound.read_bytes()

    def missing(self) -> list[int]:
        """Blocks of which an array is damaged or missing."""
        return list(self.bad)

    def write(self, block: int, values: Block) -> None:
        """Write the damaged arrays of a block again."""
        with self._disk():
            for name in self.bad[block]:
                make_room(self._file(name, block))
                writable(self._group, name)[self.span(block)] = getattr(values, name)
                self.mended.append(f"block {block} of {name}")

    def finish(self) -> Path:
        """Clear away what Zarr had begun to write when it was killed."""
        with self._disk():
            self._clear(self.path)
        return self.path
