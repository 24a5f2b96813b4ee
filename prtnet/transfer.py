"""Local transfer: how every texel of a patch, or vertex of a mesh, answers distant light.

"LDPRT" (Sloan, Luna and Snyder 2005) section 3.2. A matte point has one vector T: it sends
Σ_j T_j L_j in all directions, for light with the coefficients L_j in the point's own frame. A
glossy one has a row for each factor of its BRDF: it sends Σ_b u_b(view) Σ_j M'_bj L_j [eq. 16].
What is simulated, and who fits lobes to it, is not this module's business.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.array_file import TRANSFER, read_arrays, write_arrays
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import MISFITS, PrtnetError
from prtnet.limits import LARGEST, check_field_limits
from prtnet.sh import order_of

__all__ = [
    "FORMAT_VERSION",
    "Patch",
    "Surface",
    "TransferField",
    "check_field",
    "layout_facts",
    "layout_from",
    "layout_parts",
    "texels_of",
    "whole",
    "wrapped",
]

FORMAT_VERSION = 1


@dataclass(frozen=True, eq=False)
class Patch:
    """A texture: texel (row r, column c) is receiver r · W + c.

    Its frame is that of the surface it is laid on, before any relief: x along the columns, the
    tangent; y along the rows, the bitangent; z up, the normal. Row 0 is at y = 0.

    Attributes:
        heights: of the relief along z, metres, (H, W) float32.
        normals: of the relief in the patch's frame, (H, W, 3) float32: a normal map.
        size: metres along x and along y.
        tiles: whether it repeats along x and along y; where not, its border goes on outwards.
    """

    heights: FloatArray
    normals: FloatArray
    size: tuple[float, float]
    tiles: tuple[bool, bool] = (True, True)

    def __len__(self) -> int:
        return int(self.heights.size)


def wrapped(index: IntArray, count: int, tiles: bool) -> IntArray:
    """Texels 0 … count − 1 that indices along a side of a patch stand for, beyond its border too.

    Args:
        index: whole numbers (…).
        count: of texels along that side.
        tiles: whether it repeats; otherwise its border goes on outwards.
    """
    return np.asarray(index % count if tiles else np.clip(index, 0, count - 1))


@dataclass(frozen=True, eq=False)
class Surface:
    """The vertices of a mesh, each with a frame of its own: tangent, normal × tangent, normal.

    Attributes:
        positions: metres, (K, 3) float32.
        normals: unit, (K, 3) float32.
        tangents: unit and perpendicular to the normals, (K, 3) float32.
        faces: triangles (T, 3) int32, counter-clockwise from outside.
    """

    positions: FloatArray
    normals: FloatArray
    tangents: FloatArray
    faces: IntArray

    def __len__(self) -> int:
        return len(self.positions)


ARRAYS = {
    "patch": ("heights", "normals"),
    "mesh": ("positions", "normals", "tangents", "faces"),
}


@dataclass(frozen=True, eq=False)
class TransferField:
    """Transfer of K points, R rows each: vectors are matrices of one row.

    Attributes:
        transfer: (K, R, n²) float32, from radiance of distant light to exit radiance.
        layout: where the points are.
        view: of glossy transfer the factors u_b of view directions, linear RGB, (R, S, 3) float32
            over the S = size² cells of ``prtnet.hemisphere``'s concentric map, in the frame of the
            relief's normal (``Patch.normals``; the tangent is the patch's, made perpendicular).
            None for matte transfer.
        metadata: what was simulated, as JSON can hold it.
    """

    transfer: FloatArray
    layout: Patch | Surface
    view: FloatArray | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError where arrays do not fit each other."""
        check(self)

    def __len__(self) -> int:
        return len(self.transfer)

    @property
    def order(self) -> int:
        """Bands n."""
        return order_of(self.transfer)

    @property
    def rows(self) -> int:
        """Rows R of every point."""
        return self.transfer.shape[1]

    @property
    def vectors(self) -> FloatArray:
        """Of matte transfer the vectors (K, n²).

        Raises:
            ValueError: it is glossy.
        """
        if self.view is not None:
            raise ValueError("glossy transfer has matrices, not vectors")
        return self.transfer[:, 0]

    def facts(self) -> dict[str, Any]:
        """What there is to say about it, as JSON can hold it."""
        shape = {"points": len(self), "order": self.order, "rows": self.rows}
        return {**layout_facts(self.layout), **shape, **self.metadata}

    def save(self, path: str | Path) -> None:
        """Write one ``.safetensors`` file.

        Raises:
            PrtnetError: it cannot be written.
        """
        header, arrays = layout_parts(self.layout)
        arrays["transfer"] = self.transfer
        if self.view is not None:
            arrays["view"] = self.view
        header |= {"format_version": FORMAT_VERSION, "metadata": dict(self.metadata)}
        write_arrays(path, header, arrays, TRANSFER)

    @classmethod
    def load(cls, path: str | Path) -> TransferField:
        """Read such a file.

        Raises:
            PrtnetError: it is missing, damaged, of another kind or of another format version.
        """
        header, arrays = read_arrays(path, TRANSFER)
        with whole(path, header, FORMAT_VERSION, "transfer field"):
            layout = layout_from(header, arrays)
            told = dict(header.get("metadata", {}))
            found = cls(arrays["transfer"], layout, arrays.get("view"), told)
            check_field_limits(found.order, found.rows, None, texels_of(layout))
            return found


@contextlib.contextmanager
def whole(path: str | Path, header: Mapping[str, Any], version: int, kind: str) -> Iterator[None]:
    """Takes a file's header and arrays apart: of a file that has not all of them, one line.

    Raises:
        PrtnetError: it is of another version, or something is missing or does not fit.
    """
    found = header.get("format_version")
    if found != version:
        known = f"this prtnet reads {version}; bake it anew"
        raise PrtnetError(path, f"has format version {found}, {known}")
    try:
        with np.errstate(all="ignore"):  # what overflows is not finite, which is refused
            yield
    except (*MISFITS, MemoryError) as error:
        what = f"is not a whole prtnet {kind} ({error}); bake it anew"
        raise PrtnetError(path, what) from error


def layout_facts(layout: Patch | Surface) -> dict[str, Any]:
    """What there is to say about a layout."""
    if not isinstance(layout, Patch):
        return {"layout": "mesh", "triangles": len(layout.faces)}
    height, width = layout.heights.shape
    return {"layout": "patch", "texels": [width, height], "metres": list(layout.size),
            "tiles": list(layout.tiles)}  # fmt: skip


def texels_of(layout: Patch | Surface) -> tuple[int, ...] | None:
    """Rows and columns of a patch, None of a mesh."""
    return layout.heights.shape if isinstance(layout, Patch) else None


def layout_parts(layout: Patch | Surface) -> tuple[dict[str, Any], dict[str, Any]]:
    """What a header and the arrays of a file hold of a layout."""
    kind = kind_of(layout)
    header: dict[str, Any] = {"layout": kind}
    if isinstance(layout, Patch):
        header |= {"size": list(layout.size), "tiles": list(layout.tiles)}
    return header, {name: getattr(layout, name) for name in ARRAYS[kind]}


def layout_from(header: Mapping[str, Any], arrays: Mapping[str, Any]) -> Patch | Surface:
    """A layout of a file's header and arrays; ``whole`` reports what they lack."""
    kind = str(header["layout"])
    own = {name: arrays[name] for name in ARRAYS[kind]}
    if kind != "patch":
        return Surface(**own)
    width, height = (float(one) for one in header["size"])
    across, along = (bool(one) for one in header["tiles"])
    return Patch(**own, size=(width, height), tiles=(across, along))


def kind_of(layout: Patch | Surface) -> str:
    """The name of its kind."""
    return "patch" if isinstance(layout, Patch) else "mesh"


def check(found: TransferField) -> None:
    """Raise ValueError where arrays do not fit each other, or are not finite."""
    if found.transfer.ndim != 3 or 0 in found.transfer.shape:
        raise ValueError(f"transfer has shape {found.transfer.shape}, expected (K, R, n²)")
    check_field({"transfer": found.transfer}, found.layout, found.view)
    order_of(found.transfer)


def check_field(
    points: Mapping[str, FloatArray], layout: Patch | Surface, view: FloatArray | None
) -> None:
    """Raise ValueError where arrays of points (K, R, …) do not fit a layout or view factors."""
    check_arrays(points, layout, view)
    check_layout(layout)
    sizes = {array.shape[:2] for array in points.values()}
    if len(sizes) != 1:
        raise ValueError("arrays are of different numbers of points or rows")
    (count, rows), *_ = sizes
    if len(layout) != count:
        raise ValueError("the layout does not fit the transfer")
    if view is None and rows != 1:
        raise ValueError("rows without view factors")
    if view is not None:
        size = round(view.shape[1] ** 0.5) if view.ndim == 3 else 0
        if view.shape != (rows, size * size, 3):
            raise ValueError("view factors do not fit the rows")


def check_arrays(
    points: Mapping[str, FloatArray], layout: Patch | Surface, view: FloatArray | None
) -> None:
    """Raise ValueError where an array is of a wrong type, or not finite."""
    arrays = {**points, **layout_parts(layout)[1]}
    if view is not None:
        arrays["view"] = view
    for name, array in arrays.items():
        if array.dtype != (np.int32 if name == "faces" else np.float32):
            raise ValueError(f"{name} has type {array.dtype}")
        check_numbers(name, array)


def check_numbers(name: str, numbers: FloatArray | IntArray) -> None:
    """Raise ValueError for numbers that are not finite, or larger than any simulation gives."""
    if not (np.abs(numbers) <= LARGEST).all():
        raise ValueError(f"{name} holds values that are not finite, or above {LARGEST:g}")


def check_layout(layout: Patch | Surface) -> None:
    """Raise ValueError where a layout's arrays do not fit each other."""
    if isinstance(layout, Patch):
        fits = layout.heights.ndim == 2 and layout.normals.shape == (*layout.heights.shape, 3)
        if not all(1.0 / LARGEST <= one <= LARGEST for one in layout.size):
            raise ValueError("size is no length")
    else:
        shape = (len(layout.positions), 3)
        places = (layout.positions, layout.normals, layout.tangents)
        fits = all(one.shape == shape for one in places)
        fits &= layout.faces.ndim == 2 and layout.faces.shape[1] == 3
        if fits and layout.faces.size and not (
            layout.faces.min() >= 0 and layout.faces.max() < len(layout)
        ):  # fmt: skip
            raise ValueError("faces name vertices that are not there")
    if not fits:
        raise ValueError("the layout does not fit the transfer")
