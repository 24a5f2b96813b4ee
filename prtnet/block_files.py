"""Files that pass between machines: one of ours in a folder, the same bytes in a store.

A store's are read in parts by the layout of safetensors: eight bytes of length, a JSON header with
the type, shape and place of each array, their bytes.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import safetensors
import safetensors.numpy

from prtnet.array_file import BLOCK, LONGEST, PREFIX, array_bytes, read_arrays, write_arrays
from prtnet.errors import MISFITS, PrtnetError
from prtnet.places import failures, is_remote, remote

__all__ = ["read_block", "read_part", "write_block"]


def write_block(path: Path, header: Mapping[str, Any], arrays: Mapping[str, Any]) -> None:
    """Write arrays and a header that JSON can hold.

    Raises:
        PrtnetError: the file cannot be written.
    """
    if not is_remote(path):
        write_arrays(path, header, arrays, BLOCK)
        return
    try:
        path.write_bytes(array_bytes(header, arrays, BLOCK))
    except failures(path) as error:
        raise PrtnetError(path, f"cannot be written ({error}); see the store") from error


def read_block(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays.

    Raises:
        PrtnetError: the file is missing or damaged.
    """
    if not is_remote(path):
        return read_arrays(path, BLOCK)
    try:
        content = remote(path).fs.cat_file(remote(path).path)
        told = json.loads(content[PREFIX : PREFIX + int.from_bytes(content[:PREFIX], "little")])
        return json.loads(told["__metadata__"][BLOCK]), safetensors.numpy.load(content)
    except (FileNotFoundError, *MISFITS) as error:
        raise PrtnetError(path, f"is missing or damaged ({error}); start again") from error
    except failures(path) as error:
        raise PrtnetError(path, f"cannot be read ({error}); check the store") from error


def read_part(path: Path, name: str, rows: slice | None = None) -> Any:
    """Some rows of an array, as many as there are, or all of it.

    Raises:
        PrtnetError: this machine does not see the file.
    """
    try:
        if is_remote(path):
            return remote_part(path, name, rows)
        with safetensors.safe_open(path, framework="numpy") as file:
            if rows is None:
                return file.get_tensor(name)
            own = file.get_slice(name)
            first, last, _ = rows.indices(own.get_shape()[0])
            # It refuses to slice nothing.
            return own[first:last] if first < last else file.get_tensor(name)[:0]
    except (*failures(path), safetensors.SafetensorError) as error:
        told = "start again; on a cluster have --out or --exchange where every machine sees it"
        if is_remote(path):
            told = f"check the store ({error})"
        raise PrtnetError(path.parent, f"cannot be read; {told}") from error


def remote_part(path: Any, name: str, rows: slice | None) -> Any:
    """The same of a file in a store, of which no more than that is read."""

    def span(begin: int, end: int) -> bytes:
        return path.fs.cat_file(path.path, start=begin, end=end) if end > begin else b""

    length = int.from_bytes(span(0, PREFIX), "little")
    if not 0 < length <= LONGEST:
        raise OSError("is no file of arrays")
    told = json.loads(span(PREFIX, PREFIX + length))[name]
    (begin, end), shape = told["data_offsets"], told["shape"]
    if rows is not None:
        first, last, _ = rows.indices(shape[0])
        width = (end - begin) // max(shape[0], 1)
        begin, end = begin + first * width, begin + max(first, last) * width
        shape = [max(last - first, 0), *shape[1:]]
    content = span(PREFIX + length + begin, PREFIX + length + end)
    own = {"dtype": told["dtype"], "shape": shape, "data_offsets": [0, len(content)]}
    header = json.dumps({name: own}).encode()
    return safetensors.numpy.load(len(header).to_bytes(PREFIX, "little") + header + content)[name]
