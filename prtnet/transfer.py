"""Local transfer: how every texel of a patch, or vertex of a mesh, answers distant light.

"LDPRT" (Sloan, Luna and Snyder 2005) section 3.2. A matte point has one vector T: it sends
Σ_j T_j L_j in all directions, for light with the coefficients L_j in the point's own frame. A
glossy one has a row for each factor of its BRDF: it sends Σ_b u_b(view) Σ_j M'_bj L_j [eq. 16].
What is simulated, and who fits lobes to it, is not this module's business.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.array_file import TRANSFER, read_arrays, write_arrays
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.sh import order_of

__all__ = ["FORMAT_VERSION", "Patch", "Surface", "TransferField"]

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
        patch = isinstance(self.layout, Patch)
        shape: dict[str, Any] = {"points": len(self), "order": self.order, "rows": self.rows}
        if isinstance(self.layout, Patch):
            height, width = self.layout.heights.shape
            shape |= {"texels": [width, height], "metres": list(self.layout.size),
                      "tiles": list(self.layout.tiles)}  # fmt: skip
        return {"layout": "patch" if patch else "mesh", **shape, **self.metadata}

    def save(self, path: str | Path) -> None:
        """Write one ``.safetensors`` file.

        Raises:
            PrtnetError: it cannot be written.
        """
        kind = "patch" if isinstance(self.layout, Patch) else "mesh"
        header: dict[str, Any] = {"format_version": FORMAT_VERSION, "layout": kind}
        if isinstance(self.layout, Patch):
            header |= {"size": list(self.layout.size), "tiles": list(self.layout.tiles)}
        arrays = {"transfer": self.transfer}
        arrays |= {name: getattr(self.layout, name) for name in ARRAYS[kind]}
        if self.view is not None:
            arrays["view"] = self.view
        write_arrays(path, {**header, "metadata": dict(self.metadata)}, arrays, TRANSFER)

    @classmethod
    def load(cls, path: str | Path) -> TransferField:
        """Read such a file.

        Raises:
            PrtnetError: it is missing, damaged, of another kind or of another format version.
        """
        header, arrays = read_arrays(path, TRANSFER)
        version = header.get("format_version")
        if version != FORMAT_VERSION:
            known = f"this prtnet reads {FORMAT_VERSION}; bake it anew"
            raise PrtnetError(path, f"has format version {version}, {known}")
        try:
            kind = str(header["layout"])
            own = {name: arrays[name] for name in ARRAYS[kind]}
            if kind == "patch":
                width, height = (float(one) for one in header["size"])
                across, along = (bool(one) for one in header["tiles"])
                layout: Patch | Surface = Patch(**own, size=(width, height), tiles=(across, along))
            else:
                layout = Surface(**own)
            return cls(
                arrays["transfer"], layout, arrays.get("view"), dict(header.get("metadata", {}))
            )
        except (KeyError, TypeError, ValueError, IndexError) as error:
            what = f"is not a whole prtnet transfer field ({error}); bake it anew"
            raise PrtnetError(path, what) from error


def check(found: TransferField) -> None:
    """Raise ValueError where arrays do not fit each other, or are not finite."""
    layout = found.layout
    arrays = {"transfer": found.transfer}
    if found.view is not None:
        arrays["view"] = found.view
    kind = "patch" if isinstance(layout, Patch) else "mesh"
    arrays |= {name: getattr(layout, name) for name in ARRAYS[kind]}
    for name, array in arrays.items():
        if array.dtype != (np.int32 if name == "faces" else np.float32):
            raise ValueError(f"{name} has type {array.dtype}")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds values that are not finite")
    if found.transfer.ndim != 3 or 0 in found.transfer.shape:
        raise ValueError(f"transfer has shape {found.transfer.shape}, expected (K, R, n²)")
    order_of(found.transfer)
    if isinstance(layout, Patch):
        fits = layout.heights.ndim == 2 and layout.normals.shape == (*layout.heights.shape, 3)
        if not all(0 < one < np.inf for one in layout.size):
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
    if not fits or len(layout) != len(found.transfer):
        raise ValueError("the layout does not fit the transfer")
    if found.view is None and found.rows != 1:
        raise ValueError("rows without view factors")
    if found.view is not None:
        size = round(found.view.shape[1] ** 0.5) if found.view.ndim == 3 else 0
        if found.view.shape != (found.rows, size * size, 3):
            raise ValueError("view factors do not fit the rows")
