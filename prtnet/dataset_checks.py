"""Whether a folder is a dataset as ``prtnet generate`` writes them; of any other nothing is read.

Checksums tell what has been damaged. What is here holds also where somebody made them fit.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from prtnet.errors import PrtnetError
from prtnet.limits import check_order
from prtnet.places import is_remote, sizes

__all__ = [
    "check_attributes",
    "check_fit",
    "check_folder",
    "check_stored",
    "chunk_key",
    "honest",
    "odd_header",
    "packed_most",
]

CODECS = {"BytesCodec", "BloscCodec", "Crc32cCodec"}
# LZ4 makes a run of 255 bytes at most out of each byte: no chunk that we write unpacks to more.
LARGEST_RATIO, SMALL = 256, 1 << 16
HEADER, MOST_HEADER = "zarr.json", 1 << 24  # bytes
MOST_ROWS = 1 << 31  # of a chunk
TEXTS = ("clip_names", "held_out", "joint_names")


def check_folder(path: Path) -> None:
    """Refuse a dataset with symbolic links to what lies outside it.

    Raises:
        PrtnetError: it has one.
    """
    if is_remote(path):
        return  # links are the store's affair
    root = path.resolve()
    for entry in entries(path):
        if entry.is_symlink() and not inside(Path(entry.path), root):
            name = os.path.relpath(entry.path, path)
            raise PrtnetError(path, f"{name} is a link to something outside; copy the file there")


def odd_header(path: Path) -> str | None:
    """A header of a dataset that is no file, or too large for one; None where all can be read."""
    if is_remote(path):
        return None
    for file in (path / HEADER, *sorted(path.glob(f"*/{HEADER}"))):
        fits = file.is_file() and file.stat().st_size <= MOST_HEADER
        if os.path.lexists(file) and not fits:
            return file.relative_to(path).as_posix()
    return None


def inside(link: Path, root: Path) -> bool:
    """Whether a link ends within a folder."""
    try:
        return link.resolve().is_relative_to(root)
    except (OSError, RuntimeError):  # links in a circle
        return False


def entries(path: str | Path) -> Iterator[os.DirEntry[str]]:
    """All files, folders and links in a folder and its folders; links are not followed."""
    with os.scandir(path) as found:
        for entry in found:
            yield entry
            if entry.is_dir(follow_symlinks=False):
                yield from entries(entry.path)


def chunk_bytes(array: zarr.Array[Any]) -> int:
    """Of a chunk, unpacked."""
    return math.prod(array.chunks) * array.dtype.itemsize


def packed_most(size: int) -> int:
    """Bytes of the file of a chunk of a size, at most: Blosc adds little to what is random."""
    return size + SMALL


def chunk_key(array: zarr.Array[Any], block: int) -> str:
    """The name of a block's file within the array's folder."""
    return str(array.metadata.encode_chunk_key((block, *(0,) * (array.ndim - 1))))


def honest(array: zarr.Array[Any], block: int) -> bool:
    """Whether a block, if it is there, takes no more memory than it should to be read.

    Its file is read whole, and Blosc takes memory for what the header claims to unpack to. What
    lies in a store is trusted.
    """
    root, size = getattr(array.store, "root", None), chunk_bytes(array)
    if root is None:
        return True
    file = Path(root) / array.path / chunk_key(array, block)
    if not file.is_file():
        return True
    if file.stat().st_size > packed_most(size):
        return False
    with open(file, "rb") as chunk:
        claimed = int.from_bytes(chunk.read(8)[4:], "little")
    return claimed == size or "BloscCodec" not in codecs_of(array)


def codecs_of(array: zarr.Array[Any]) -> list[str]:
    """What packs an array, by name."""
    return [type(one).__name__ for one in getattr(array.metadata, "codecs", ())]


def check_stored(path: Path, array: zarr.Array[Any]) -> None:
    """Raise ValueError where an array claims to unpack to more than its files can hold.

    Args:
        path: of the dataset.
        array: of it, of which nothing has been read yet.
    """
    name = array.basename
    codecs = codecs_of(array)
    if not set(codecs) <= CODECS or len(codecs) > len(set(codecs)):
        raise ValueError(f"{name} is packed by {', '.join(codecs)}")
    if is_remote(path):
        stored = sum(sizes(path / name).values())
    else:
        stored = sum(e.stat().st_size for e in entries(path / name) if e.is_file())
    others = tuple(max(size, 1) for size in array.shape[1:])
    if array.chunks[0] > MOST_ROWS or array.chunks[1:] != others:
        raise ValueError(f"{name} is cut into blocks of other sizes")
    claimed = chunk_bytes(array) * array.nchunks
    if claimed > LARGEST_RATIO * stored + SMALL:
        raise ValueError(f"{name} claims {claimed} bytes, in files of {stored}")


def check_attributes(found: Mapping[str, Any]) -> None:
    """Raise ValueError or TypeError where attributes are not what they are called."""
    check_order(int(found["order"]))
    for name in TEXTS:
        texts = found[name]
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            raise ValueError(f"{name} is no list of names")
        "".join(texts).encode()  # lone surrogates cannot be printed
    if not set(found["held_out"]) <= set(found["clip_names"]):
        raise ValueError("held_out names clips that are not there")
    if found["scene_kind"] not in ("skinned", "point_cache"):
        raise ValueError("scene_kind is neither 'skinned' nor 'point_cache'")


def check_fit(arrays: Mapping[str, Any], attributes: Mapping[str, Any]) -> None:
    """Raise ValueError where arrays do not fit each other.

    Args:
        arrays: those that no pose changes, and of those by pose what has their shape and type.
        attributes: of the dataset.
    """
    poses, receivers = arrays["visibility"].shape[:2]
    size, clips = len(arrays["rest_pose"]), len(attributes["clip_names"])
    triples = (receivers, 3)
    shapes: dict[str, tuple[tuple[int, ...], str]] = {
        "visibility": ((poses, receivers, int(attributes["order"]) ** 2), "f"),
        "pose": ((poses, size), "f"),
        **dict.fromkeys(("positions", "normals", "tangents"), ((poses, *triples), "f")),
        **{f"rest_{name}": (triples, "f") for name in ("positions", "normals", "tangents")},
        "clip": ((poses,), "i"),
        "time": ((poses,), "f"),
        "sources": ((poses, clips), "b"),
        "rest_pose": ((size,), "f"),
        "receiver_side": ((receivers,), "i"),
        "faces": ((len(arrays["faces"]), 3), "i"),
        "receiver_of_vertex": ((len(arrays["receiver_of_vertex"]),), "i"),
    }
    limits = {
        "faces": (0, len(arrays["receiver_of_vertex"])),
        "receiver_of_vertex": (0, receivers),
        "receiver_side": (-1, 2),
    }
    if arrays.get("joint_parents") is not None:
        joints = len(arrays["joint_parents"])
        shapes |= {"joint_weights": ((receivers, joints), "f"), "joint_parents": ((joints,), "i")}
        limits["joint_parents"] = (-1, joints)
    for name, (shape, kind) in shapes.items():
        if arrays[name].shape != shape or arrays[name].dtype.kind != kind:
            raise ValueError(f"{name} is {arrays[name].dtype} {arrays[name].shape}, not {shape}")
    for name, (least, end) in limits.items():
        if not (
            np.min(arrays[name], initial=least) >= least
            and np.max(arrays[name], initial=least) < end
        ):
            raise ValueError(f"{name} points outside its table")
