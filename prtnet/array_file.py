"""Files of named arrays with a header: safetensors whose metadata hold one JSON object.

Reading one runs no code of the file, and ends with arrays or with one line.
"""

from __future__ import annotations

import errno
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import safetensors
import safetensors.numpy

from prtnet.errors import MISFITS, PrtnetError
from prtnet.files import writing

__all__ = [
    "ALL_FREQUENCY",
    "BLOCK",
    "LOBES",
    "LONGEST",
    "MODEL",
    "PREFIX",
    "TRANSFER",
    "array_bytes",
    "header_key",
    "kind_named",
    "read_arrays",
    "untimed",
    "write_arrays",
]

# The metadata key of each kind of file: whose header it is.
MODEL, TRANSFER, LOBES = "prtnet", "prtnet-transfer", "prtnet-lobes"
ALL_FREQUENCY = "prtnet-all-frequency"
BLOCK = "prtnet-block"  # of a larger work, from one machine to another
PREFIX = 8  # bytes of the header's length
LONGEST = 100_000_000  # bytes of a header, as safetensors has it
UNREADABLE = (OSError, MemoryError, RecursionError, safetensors.SafetensorError)
MADE_BY = {
    MODEL: ("model", "train one first"),
    TRANSFER: ("transfer field", "bake one first"),
    LOBES: ("field of lobes", "bake one with --lobes first"),
    BLOCK: ("block of data", "start the command again"),
    ALL_FREQUENCY: ("field of all-frequency transfer", "bake one with bake-all-frequency first"),
}


def write_arrays(
    path: str | Path, header: Mapping[str, Any], arrays: Mapping[str, Any], key: str
) -> None:
    """Write arrays and a header that JSON can hold; the file is whole or absent.

    Seconds that the work took are not written: the same work gives the same bytes.

    Raises:
        PrtnetError: the file cannot be written.
    """
    content = array_bytes(header, arrays, key)
    with writing(path) as partial:
        # ``save_file`` would make a file that nobody else may read.
        partial.write_bytes(content)


def array_bytes(header: Mapping[str, Any], arrays: Mapping[str, Any], key: str) -> bytes:
    """The content of such a file."""
    solid = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    return safetensors.numpy.save(solid, {key: json.dumps(untimed(header))})


def untimed(header: Mapping[str, Any]) -> dict[str, Any]:
    """A header without its ``seconds``, at any depth of objects."""
    return {
        name: untimed(value) if isinstance(value, Mapping) else value
        for name, value in header.items()
        if name != "seconds"
    }


def read_arrays(path: str | Path, key: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Header and arrays of a file of this kind.

    Raises:
        PrtnetError: it is missing, damaged, or of another kind.
    """
    kind, make = MADE_BY[key]
    if not Path(path).is_file():
        raise PrtnetError(path, f"does not exist or is no file; give a .safetensors {kind}")
    try:
        check_size(Path(path))
        with safetensors.safe_open(path, framework="numpy") as file:
            text = (file.metadata() or {}).get(key)
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        header = json.loads(text) if text else None
        json.dumps(header, ensure_ascii=False).encode()  # lone surrogates cannot be printed
    except (*UNREADABLE, *MISFITS) as error:
        raise PrtnetError(path, f"is damaged or no safetensors file ({error})") from error
    if not isinstance(header, dict):
        other = header_key(path)
        if other in MADE_BY and other != key:
            raise PrtnetError(path, f"is a prtnet {MADE_BY[other][0]}, not a {kind}; {make}")
        raise PrtnetError(path, f"is a safetensors file but no prtnet {kind}; {make}")
    return header, arrays


def check_size(path: Path) -> None:
    """Raise ValueError where a file has not as many bytes as its arrays, before it is mapped."""
    if not path.is_file():  # to open a pipe waits for who writes to it
        raise FileNotFoundError(errno.ENOENT, "no such file")
    size = path.stat().st_size
    with open(path, "rb") as file:
        length = int.from_bytes(file.read(PREFIX), "little")
        if length > min(LONGEST, size):
            raise ValueError(f"a header of {length} bytes")
        told = json.loads(file.read(length))
    ends = [int(one["data_offsets"][1]) for name, one in told.items() if name != "__metadata__"]
    whole = PREFIX + length + max(ends, default=0)
    if size != whole:
        raise ValueError(f"{size} bytes, where its arrays take {whole}")


def header_key(path: str | Path) -> str | None:
    """Which kind of file this is; None where it is none of ours, or no safetensors file."""
    try:
        check_size(Path(path))
        with safetensors.safe_open(path, framework="numpy") as file:
            known = file.metadata() or {}
    except (*UNREADABLE, *MISFITS):
        return None
    return next((key for key in MADE_BY if key in known), None)


def kind_named(words: Sequence[str]) -> str | None:
    """The kind of the first file of ours that a command line names; None where it names none."""
    keys = [header_key(word) for word in words if word.endswith(".safetensors")]
    return next((key for key in keys if key is not None), None)
