"""Datasets of visibility over poses: a Zarr v3 group, a chunk of whose arrays is a block of poses.

One is a folder, on this machine or in a store that has a URL (:mod:`prtnet.places`). The arrays and
attributes are listed in docs/formats.md. Chunks end in their CRC-32C; the group's attributes have a
SHA-256 of themselves and of every array's header.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset_checks import (
    check_attributes,
    check_fit,
    check_folder,
    check_stored,
    honest,
    odd_header,
)
from prtnet.errors import PrtnetError
from prtnet.places import children, damage, failures, known, place, store, there

__all__ = [
    "FORMAT_VERSION",
    "SAMPLED",
    "Block",
    "Dataset",
    "Rows",
    "evenly",
    "sampled_clip",
]

FORMAT_VERSION = 1
SAMPLED = "sampled"  # the name of the clip that sampled poses belong to
MADE_WITH = "made_with"  # attribute: versions of what made it
HEADERS = "headers_sha256"  # attribute: of every array's zarr.json, and of the other attributes
SELF = "attributes"  # the name of those among HEADERS
POSE_ARRAYS = (
    "visibility", "pose", "positions", "normals", "tangents", "clip", "time", "sources",
)  # fmt: skip
FIXED_ARRAYS = (
    "faces", "receiver_of_vertex", "receiver_side",
    "rest_positions", "rest_normals", "rest_tangents", "rest_pose",
)  # fmt: skip
ATTRIBUTES = (
    "order", "rays", "seed", "two_sided", "scene_kind", "scene_name", "scene_sha256",
    "mesh_sha256", "clip_names", "held_out", "joint_names", "morph_count",
)  # fmt: skip
SKIN_ARRAYS = ("joint_weights", "joint_parents")


@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Consecutive poses with everything a dataset holds of each."""

    visibility: FloatArray  # [P, V, n²] float32, local frames
    pose: FloatArray  # [P, D] float32
    positions: FloatArray  # [P, V, 3] float32, receivers in model space
    normals: FloatArray  # [P, V, 3] float32, unit
    tangents: FloatArray  # [P, V, 3] float32, unit
    clip: IntArray  # [P] int32, index into the clip names
    time: FloatArray  # [P] float32 seconds in the clip; 0 for sampled poses
    sources: np.ndarray[Any, np.dtype[np.bool_]]  # [P, clips] which clips the pose is made of


class Rows:
    """An array of a dataset, read by pose: ``rows[3]``, ``rows[8:16]`` or ``rows[[1, 5]]``."""

    def __init__(self, array: zarr.Array[Any], path: Path, seal: bytes) -> None:
        self._array, self._path, self._seal = array, path, seal
        self.shape: tuple[int, ...] = array.shape
        self.dtype = array.dtype

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, index: int | slice | IntArray) -> Any:
        try:
            if not all(honest(self._array, block) for block in self.blocks(index)):
                raise ValueError("a file of another size")
            if isinstance(index, (int, slice)):
                found = np.asarray(self._array[index])
            else:
                found = np.asarray(self._array.oindex[np.arange(len(self))[index]])
            if sealed(self._path) != self._seal:
                raise PrtnetError(self._path, "was replaced while it was read; start again")
            return found
        except PrtnetError:
            raise
        except damage(self._path) as error:
            raise PrtnetError(self._path, self.complaint(index)) from error
        except failures(self._path) as error:
            raise out_of_reach(self._path, error) from error

    def blocks(self, index: int | slice | IntArray) -> list[int]:
        """Those that hold these poses."""
        found = np.atleast_1d(np.arange(len(self))[index]) // self._array.chunks[0]
        return [int(block) for block in np.unique(found)]

    def complaint(self, index: int | slice | IntArray) -> str:
        """Which blocks are damaged among those that hold these poses, and what to do about it."""
        lost = damage(self._path)
        bad = [block for block in self.blocks(index) if not readable(self._array, block, lost)]
        where = f" in block {', '.join(map(str, bad[:8]))}{', ...' * (len(bad) > 8)}"
        if self._array.basename not in POSE_ARRAYS or not bad:
            where = ""
        return f"array '{self._array.basename}' is damaged{where}; {MEND}"


def sealed(path: Path) -> bytes:
    """The header of a dataset, which goes first and comes last when the dataset is replaced.

    Zarr reads zeros where a chunk is gone.
    """
    header = header_of(path, "")
    return header.read_bytes() if there(header) else b""


def out_of_reach(path: Path, error: Exception) -> PrtnetError:
    """What to say where a store's client fails in a way of its own."""
    return PrtnetError(path, f"cannot be read ({error}); check the store")


MEND = "repeat the prtnet generate that made it with --repair"


def readable(array: zarr.Array[Any], block: int, lost: tuple[type[Exception], ...]) -> bool:
    """Whether the poses of a block can be read, and have the checksum they were written with.

    Args:
        array: of a dataset.
        block: of poses.
        lost: what reading raises where it is damaged.
    """
    size = array.chunks[0]
    try:
        if honest(array, block):
            np.asarray(array[block * size : (block + 1) * size])
            return True
    except lost:
        pass
    return False


def header_sums(folder: Path, attributes: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of the headers of all arrays in a group's folder, and of its attributes."""
    names = sorted(path.name for path in children(folder) if there(header_of(path, "")))
    sums = {
        name: hashlib.sha256(header_of(folder, name).read_bytes()).hexdigest() for name in names
    }
    own = {name: value for name, value in attributes.items() if name != HEADERS}
    text = json.dumps(own, sort_keys=True)
    return {**sums, SELF: hashlib.sha256(text.encode()).hexdigest()}


def header_of(folder: Path, array: str) -> Path:
    """The file of an array's header."""
    return folder / array / "zarr.json"


def opened(path: Path) -> zarr.Group:
    """The group of a dataset, of this format version and with sound headers.

    Raises:
        PrtnetError: it is none, of another format version, or a header is damaged.
    """
    try:
        check_folder(path)
        if (odd := odd_header(path)) is not None:
            raise PrtnetError(path, f"{odd} is damaged; {MEND}")
        # Headers of arrays within the group's own have no checksum: they are not looked at.
        group = zarr.open_group(store(path), mode="r", zarr_format=3, use_consolidated=False)
        attributes: dict[str, Any] = dict(group.attrs)
    except PrtnetError:
        raise
    except damage(path) as error:
        if all(there(header_of(path, name)) for name in POSE_ARRAYS):
            raise PrtnetError(path, f"its zarr.json is damaged; {MEND}") from error
        raise PrtnetError(path, "is not a dataset; make one with prtnet generate") from error
    version = attributes.get("format_version")
    sums: Any = attributes.get(HEADERS, {})  # datasets of old have none
    if sums or MADE_WITH in attributes:
        found = header_sums(path, attributes)
        if not isinstance(sums, dict) or found[SELF] != sums.get(SELF):
            raise PrtnetError(path, f"its zarr.json is damaged; {MEND}")
    if version is None:
        raise PrtnetError(path, "is not a dataset; make one with prtnet generate")
    if version != FORMAT_VERSION:
        raise PrtnetError(
            path,
            f"is a dataset of another format version ({version}, this program reads "
            f"{FORMAT_VERSION}); generate it again",
        )
    for name in sums:
        if found.get(name) != sums[name]:
            what = "is damaged" if name in found else "is missing"
            raise PrtnetError(path, f"{name}/zarr.json {what}; {MEND}")
    return group


def array_of(group: zarr.Group, name: str) -> zarr.Array[Any]:
    """A member of a group that has to be an array."""
    with np.errstate(over="ignore"):  # what fills its holes may be too large for its type
        member = group[name]
    if not isinstance(member, zarr.Array):
        raise KeyError(name)
    return member


class Dataset:
    """A finished dataset, open for reading.

    The attributes of the Zarr group and the arrays that no pose changes are attributes here;
    arrays of poses are ``Rows``.

    Attributes:
        path: the Zarr group's folder.
        attributes: all attributes of the group.
    """

    order: int  # n of the spherical harmonics
    rays: int  # traced for each receiver, above the horizon
    seed: int
    two_sided: bool
    scene_kind: str  # "skinned" or "point_cache"
    scene_name: str
    scene_sha256: str
    mesh_sha256: str
    clip_names: list[str]  # with SAMPLED last where there are sampled poses
    held_out: list[str]
    joint_names: list[str]
    morph_count: int
    faces: IntArray  # [T, 3] over render vertices
    receiver_of_vertex: IntArray  # [V_render] front receivers
    receiver_side: IntArray  # [V] +1 front, −1 back
    rest_positions: FloatArray  # [V, 3]
    rest_normals: FloatArray  # [V, 3]
    rest_tangents: FloatArray  # [V, 3]
    rest_pose: FloatArray  # [D]
    joint_weights: FloatArray | None  # [V, J]; None for point caches
    joint_parents: IntArray | None  # [J]

    def __init__(self, path: Path, group: zarr.Group) -> None:
        self.path, self._seal = path, sealed(path)
        self.attributes: dict[str, Any] = dict(group.attrs)
        self.joint_weights = self.joint_parents = None
        for name in ATTRIBUTES:
            setattr(self, name, self.attributes[name])
        check_attributes(self.attributes)
        fixed = FIXED_ARRAYS + (SKIN_ARRAYS if self.scene_kind == "skinned" else ())
        self._arrays = {name: array_of(group, name) for name in POSE_ARRAYS + fixed}
        for array in self._arrays.values():
            check_stored(path, array)
        poses = self._arrays["visibility"].shape[:1]
        every = HEADERS in self.attributes  # datasets of old leave chunks of zeros out
        for name, array in self._arrays.items():
            by_pose = name in POSE_ARRAYS
            other = array.shape[:1] != poses if by_pose else array.nchunks > 1
            if other or ((by_pose or every) and array.nchunks_initialized != array.nchunks):
                raise PrtnetError(path, f"array '{name}' is not whole; {MEND}")
        for name in fixed:
            setattr(self, name, self.read(name))
        check_fit({**self._arrays, **vars(self)}, self.attributes)

    @classmethod
    def open(cls, path: str | Path) -> Dataset:
        """Open the dataset at ``path``.

        Raises:
            PrtnetError: there is none, it is of another format version, or it is not whole.
        """
        path = place(path)
        if not known(path):
            raise PrtnetError(path, "does not exist; make it with prtnet generate")
        try:
            return cls(path, opened(path))
        except PrtnetError:
            raise
        except KeyError as error:
            raise PrtnetError(path, f"has no {error}; generate it again") from error
        except damage(path) as error:
            raise PrtnetError(path, f"does not fit together ({error}); {MEND}") from error
        except failures(path) as error:
            raise out_of_reach(path, error) from error

    def rows(self, name: str) -> Rows:
        """One of the arrays whose leading axis is the pose."""
        return Rows(self._arrays[name], self.path, self._seal)

    def read(self, name: str, index: int | slice | IntArray | None = None) -> Any:
        """The poses ``index`` of an array, or all of it."""
        return self.rows(name)[slice(None) if index is None else index]

    @cached_property
    def visibility(self) -> Rows:
        """Local-frame visibility (P, V, n²)."""
        return self.rows("visibility")

    @cached_property
    def poses(self) -> Rows:
        """Flattened poses (P, D)."""
        return self.rows("pose")

    @cached_property
    def positions(self) -> Rows:
        """Receivers in model space (P, V, 3)."""
        return self.rows("positions")

    @cached_property
    def normals(self) -> Rows:
        """Outward unit normals (P, V, 3)."""
        return self.rows("normals")

    @cached_property
    def tangents(self) -> Rows:
        """Unit tangents (P, V, 3); the bitangent is normal × tangent."""
        return self.rows("tangents")

    @cached_property
    def clip(self) -> IntArray:
        """Index of each pose's clip in ``clip_names``, (P,)."""
        return self.read("clip")

    @cached_property
    def time(self) -> FloatArray:
        """Seconds in the clip, (P,); 0 for sampled poses."""
        return self.read("time")

    @property
    def pose_size(self) -> int:
        """Length D of a flattened pose."""
        return self.poses.shape[1]

    def __len__(self) -> int:
        return len(self.visibility)

    def held_out_poses(self) -> IntArray:
        """Indices of the poses of held-out clips."""
        held = [self.clip_names.index(name) for name in self.held_out]
        return np.flatnonzero(np.isin(self.clip, held))

    def training_poses(self) -> IntArray:
        """Indices of all other poses, sampled ones among them."""
        return np.setdiff1d(np.arange(len(self)), self.held_out_poses())

    def poses_of(self, clip: str) -> IntArray:
        """Indices of the poses of a clip."""
        return np.flatnonzero(self.clip == self.clip_names.index(clip))


def sampled_clip(names: Sequence[str]) -> int | None:
    """The index of the clip of sampled poses among a dataset's clip names, None without one."""
    return names.index(SAMPLED) if SAMPLED in names else None


def evenly(rows: IntArray, most: int) -> IntArray:
    """At most so many of some poses, evenly chosen, the first and the last among them."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).round().astype(int))]
