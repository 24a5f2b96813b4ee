"""Writes datasets block by block, and goes on where an equal run was stopped.

The group grows in a hidden folder beside its final name, where each whole block leaves an empty
marker file; the folder is renamed, or copied in a store, when all blocks are whole.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BloscCodec, BloscShuffle, Crc32cCodec

from prtnet.console import Report, silent
from prtnet.dataset import (
    FORMAT_VERSION,
    HEADERS,
    POSE_ARRAYS,
    Block,
    array_of,
    header_sums,
    readable,
)
from prtnet.dataset_checks import check_folder, chunk_key, odd_header, packed_most
from prtnet.errors import PrtnetError
from prtnet.places import (
    COPYING,
    children,
    damage,
    discard,
    failures,
    is_remote,
    place,
    publish,
    reason,
    remove_place,
    sizes,
    store,
    there,
)

__all__ = ["MARKERS", "DatasetWriter"]

MARKERS = ".whole-blocks"
READING = "blocks read back"
# Chunks of zeros are files too: one that is missing is then always a damaged copy. Of arrays, since
# what is set for all of Zarr is set for all threads.
EVERY_CHUNK: Any = {"write_empty_chunks": True}


class DatasetWriter:
    """Writes a dataset block by block; goes on where an equal run was stopped.

    Args:
        path: the final folder.
        attributes: those of the group, without the format version.
        fixed: the arrays that no pose changes, by name.
        poses: number of poses P.
        block: poses a block.
        join: an equal run that is under way, and start none.
        report: of progress, while what is there already is read.

    Raises:
        PrtnetError: the folder cannot be written, or there is no run to join.
    """

    def __init__(
        self,
        path: str | Path,
        attributes: Mapping[str, Any],
        fixed: Mapping[str, np.ndarray[Any, Any]],
        poses: int,
        block: int,
        join: bool = False,
        report: Report = silent,
    ) -> None:
        self.path = place(path).resolve()
        self.poses, self.block = poses, block
        fingerprint = fingerprint_of(attributes, fixed, poses, block)
        # Of these options alone: what another run has still under way must not end up in this one.
        self.partial = self.path.with_name(f".{self.path.name}.{fingerprint[:12]}.partial")
        self._folder = self.partial
        self._markers = self.partial / MARKERS
        self._started = self._markers / fingerprint
        with self._disk():
            if not (is_remote(self.path) or self.path.parent.is_dir()):
                raise FileNotFoundError(2, f"the folder {self.path.parent} does not exist")
            left = self._left()
            half = self._require_own(left)
            self.resumed = there(self._started) and (join or self._sound(fixed))
            if self.resumed:
                self._group = zarr.open_group(store(self.partial), mode="r+", zarr_format=3)
                if not (join or is_remote(self.path)):  # stores take files whole
                    self._forget_lost(report)
                return
            if join:
                raise PrtnetError(
                    path,
                    "is not being written as here: this machine sees another folder or scene, or "
                    "has other versions of the packages; make them the same",
                )
            if half:
                remove_place(self.path)
            for other in left:
                discard(other, MARKERS)
            self._group = create(self.partial, attributes, fixed, poses, block)
            self._markers.mkdir(exist_ok=True)
            self._started.write_text(ground_sum(self.partial, fixed), encoding="ascii")

    def _sound(self, fixed: Mapping[str, Any]) -> bool:
        """Whether what stands there before the first block is as it was written."""
        check_folder(self.partial)
        mark = sizes(self._markers).get(self._started.name)
        if mark != 2 * hashlib.sha256().digest_size or odd_header(self.partial) is not None:
            return False
        for name, value in fixed.items():
            if max(sizes(self.partial / name).values(), default=0) > packed_most(value.nbytes):
                return False
        try:
            written = self._started.read_text(encoding="ascii")
            return written == ground_sum(self.partial, fixed)
        except UnicodeDecodeError:
            return False
        except failures(self.path):
            return False

    def _forget_lost(self, report: Report) -> None:
        """Take the markers of blocks away that did not reach the disk before power was lost."""
        marked = sorted(set(range(self.blocks)) - set(self.missing()))
        for done, number in enumerate(marked, 1):
            if lost := [name for name in POSE_ARRAYS if not self._whole(name, number)]:
                self._marker(number).unlink(missing_ok=True)  # an equal run may have, too
                for name in lost:
                    make_room(self._file(name, number))
            report(READING, done, len(marked))

    def _whole(self, name: str, number: int) -> bool:
        """Whether a block of an array is there and has its checksum."""
        array, file = array_of(self._group, name), self._file(name, number)
        if not there(file) or not (is_remote(file) or file.is_file()):
            return False
        return readable(array, number, damage(self.path))

    def _file(self, name: str, number: int) -> Path:
        """Where a block of an array is."""
        return self._folder / name / chunk_key(array_of(self._group, name), number)

    def _left(self) -> list[Path]:
        """What runs of any options left that were stopped."""
        name = re.compile(rf"\.{re.escape(self.path.name)}\.[0-9a-f]{{12}}\.partial")
        return [path for path in children(self.path.parent) if name.fullmatch(path.name)]

    def _require_own(self, left: Sequence[Path]) -> bool:
        """Refuse to replace what is no dataset; whether it is one that is copied by half."""
        if not there(self.path) or there(self.path / "zarr.json"):
            return False
        if not any(there(other / MARKERS / COPYING) for other in left):
            raise PrtnetError(self.path, "exists and is not a dataset; give another --out")
        return True

    @property
    def blocks(self) -> int:
        """Number of blocks in all."""
        return -(-self.poses // self.block)

    def span(self, block: int) -> slice:
        """The poses of a block."""
        return slice(block * self.block, min((block + 1) * self.block, self.poses))

    def missing(self) -> list[int]:
        """Blocks that are not written yet."""
        with self._disk():
            written = {marker.name for marker in children(self._markers)}
        return [block for block in range(self.blocks) if str(block) not in written]

    def write(self, block: int, values: Block) -> None:
        """Write one block, and then its marker. Different blocks may be written at once.

        Raises:
            PrtnetError: it cannot be written, or another run has taken the folder's place.
        """
        with self._disk():
            if not there(self._started):
                raise self._elsewhere()
            for name in POSE_ARRAYS:
                writable(self._group, name)[self.span(block)] = getattr(values, name)
            self._marker(block).touch()

    def finish(self) -> Path:
        """Put the dataset under its final name, replacing what stood there.

        Raises:
            PrtnetError: it cannot be written, or blocks are missing.
        """
        if self.missing():
            raise self._elsewhere()
        with self._disk():
            self._clear(self.partial)
            publish(self.partial, self.path, "zarr.json", MARKERS)
        return self.path

    def _clear(self, folder: Path) -> None:
        """Delete what Zarr had begun to write when it was killed; stores take files whole."""
        for left in () if is_remote(folder) else folder.rglob("*.partial"):
            left.unlink()

    def _elsewhere(self) -> PrtnetError:
        what = "was finished or begun anew by another run meanwhile"
        return PrtnetError(self.path, f"{what}; look at it, or repeat the command")

    def _marker(self, block: int) -> Path:
        return self._markers / str(block)

    @contextlib.contextmanager
    def _disk(self) -> Iterator[None]:
        try:
            yield
        except PrtnetError:
            raise
        except failures(self.path) as error:
            told = f"cannot be written ({reason(error)}); give another --out"
            raise PrtnetError(self.path, told) from error


def create(
    folder: Path,
    attributes: Mapping[str, Any],
    fixed: Mapping[str, np.ndarray[Any, Any]],
    poses: int,
    block: int,
) -> zarr.Group:
    """A dataset without its blocks: headers, attributes, and the arrays that no pose changes.

    The header of ``visibility`` has the fingerprint of all of it, should the group's be damaged.
    """
    group = zarr.create_group(store(folder), zarr_format=3)

    def array(name: str, shape: tuple[int, ...], chunk: int, dtype: Any) -> zarr.Array[Any]:
        return group.create_array(
            name,
            shape=shape,
            chunks=tuple(max(size, 1) for size in (chunk, *shape[1:])),
            dtype=dtype,
            config=EVERY_CHUNK,
            compressors=(
                BloscCodec(cname="lz4", clevel=1, shuffle=BloscShuffle.shuffle),
                Crc32cCodec(),  # Blosc alone reads a truncated chunk as if it were whole
            ),
        )

    for name, value in fixed.items():
        solid = np.ascontiguousarray(value)
        array(name, solid.shape, solid.shape[0], solid.dtype)[...] = solid
    receivers, size = len(fixed["receiver_side"]), len(fixed["rest_pose"])
    rows: dict[str, tuple[tuple[int, ...], str]] = {
        "visibility": ((receivers, attributes["order"] ** 2), "float32"),
        "pose": ((size,), "float32"),
        "positions": ((receivers, 3), "float32"),
        "normals": ((receivers, 3), "float32"),
        "tangents": ((receivers, 3), "float32"),
        "clip": ((), "int32"),
        "time": ((), "float32"),
        "sources": ((len(attributes["clip_names"]),), "bool"),
    }
    for name, (shape, dtype) in rows.items():
        array(name, (poses, *shape), block, np.dtype(dtype))
    fingerprint = fingerprint_of(attributes, fixed, poses, block)
    array_of(group, "visibility").attrs["fingerprint"] = fingerprint
    every = {"format_version": FORMAT_VERSION, **attributes}
    group.attrs.update({**every, HEADERS: header_sums(folder, every)})
    return group


def fingerprint_of(
    attributes: Mapping[str, Any],
    fixed: Mapping[str, np.ndarray[Any, Any]],
    poses: int,
    block: int,
) -> str:
    """SHA-256 of everything that decides what a dataset will hold."""
    header = [FORMAT_VERSION, poses, block, dict(attributes)]
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in sorted(fixed):
        digest.update(name.encode())
        digest.update(np.ascontiguousarray(fixed[name]).tobytes())
    return digest.hexdigest()


def ground_sum(folder: Path, fixed: Mapping[str, Any]) -> str:
    """SHA-256 of what a dataset is begun with: headers, and arrays that no pose changes."""
    names = ["zarr.json", *(f"{name}/zarr.json" for name in POSE_ARRAYS)]
    names += [f"{name}/{file}" for name in sorted(fixed) for file in sorted(sizes(folder / name))]
    digest = hashlib.sha256()
    for name in names:
        data = (folder / name).read_bytes()
        digest.update(f"{name} {len(data)} ".encode() + data)
    return digest.hexdigest()


def make_room(file: Path) -> None:
    """Delete a folder where a file is to be; stores have none."""
    if not is_remote(file) and file.is_dir():
        remove_place(file)


def writable(group: zarr.Group, name: str) -> zarr.Array[Any]:
    """A member of a group to write to."""
    return array_of(group, name).with_config(EVERY_CHUNK)
