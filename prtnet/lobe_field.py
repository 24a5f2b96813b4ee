"""Local transfer as zonal lobes, which turn with a surface that deforms.

"LDPRT" (Sloan, Luna and Snyder 2005), section 3.2: every row of a field of transfer is a sum of N
lobes, its lowest bands as they are. A renderer turns axes instead of harmonics [eq. 10].
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.array_file import LOBES, read_arrays, write_arrays
from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.limits import check_field_limits
from prtnet.transfer import (
    Patch,
    Surface,
    check_field,
    layout_facts,
    layout_from,
    layout_parts,
    texels_of,
    whole,
)
from prtnet.zh import Lobes, LobesApart, bands_apart

__all__ = ["FORMAT_VERSION", "LobeField", "halved"]

FORMAT_VERSION = 1
HALF = float(np.finfo(np.float16).max)


@dataclass(frozen=True, eq=False)
class LobeField:
    """Lobes of K points, R rows each; in memory float32, in a file half precision.

    Attributes:
        low: the lowest bands, (K, R, 4); see ``prtnet.zh.LobesApart``.
        axes: of N lobes, unit, in the point's frame, (K, R, N, 3).
        coefficients: g*_l, (K, R, N, n); of the bands that are apart zero.
        layout: where the points are.
        coherent: whether lobe i of a point goes with lobe i of its neighbours, so that lobes may
            be interpolated. Otherwise only the lowest bands may.
        view: factors of view directions, as of a ``prtnet.transfer.TransferField``.
        metadata: what was simulated and how well lobes fit it, as JSON can hold it.
    """

    low: FloatArray
    axes: FloatArray
    coefficients: FloatArray
    layout: Patch | Surface
    coherent: bool = False
    view: FloatArray | None = None
    metadata: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Raise ValueError where arrays do not fit each other."""
        arrays = {"low": self.low, "axes": self.axes, "coefficients": self.coefficients}
        shapes = {name: array.shape for name, array in arrays.items()}
        count = self.axes.shape[2:3]
        trails = {"low": (4,), "axes": (*count, 3), "coefficients": (*count, self.order)}
        for name, trail in trails.items():
            if len(shapes[name]) != 2 + len(trail) or shapes[name][2:] != trail or 0 in trail:
                raise ValueError(f"{name} has shape {shapes[name]}")
        check_field(arrays, self.layout, self.view)
        if np.any(self.coefficients[..., : bands_apart(self.count)]):
            raise ValueError("lobes have bands that are stored apart")
        if np.abs(np.linalg.norm(self.axes, axis=-1) - 1.0).max() > 1e-3:
            raise ValueError("axes are no unit vectors")

    def __len__(self) -> int:
        return len(self.axes)

    @property
    def order(self) -> int:
        """Bands n."""
        return int(self.coefficients.shape[-1])

    @property
    def rows(self) -> int:
        """Rows R of every point."""
        return int(self.axes.shape[1])

    @property
    def count(self) -> int:
        """Lobes N of every row."""
        return int(self.axes.shape[2]) if self.axes.ndim == 4 else 0

    @property
    def lobes(self) -> LobesApart:
        """All of them, (K, R, N)."""
        return LobesApart(self.low, Lobes(self.axes, self.coefficients))

    def facts(self) -> dict[str, Any]:
        """What there is to say about it, as JSON can hold it."""
        shape = {"points": len(self), "order": self.order, "rows": self.rows, "lobes": self.count,
                 "coherent": self.coherent}  # fmt: skip
        return {**layout_facts(self.layout), **shape, **self.metadata}

    def save(self, path: str | Path) -> None:
        """Write one ``.safetensors`` file.

        Raises:
            PrtnetError: it cannot be written.
        """
        header, arrays = layout_parts(self.layout)
        for name in ("low", "axes", "coefficients"):
            arrays[name] = getattr(self, name).astype(np.float16)
        arrays["coefficients"] = arrays["coefficients"][..., bands_apart(self.count) :]
        if self.view is not None:
            arrays["view"] = self.view
        header |= {"format_version": FORMAT_VERSION, "coherent": self.coherent,
                   "order": self.order, "metadata": dict(self.metadata)}  # fmt: skip
        write_arrays(path, header, arrays, LOBES)

    @classmethod
    def load(cls, path: str | Path) -> LobeField:
        """Read such a file.

        Raises:
            PrtnetError: it is missing, damaged, of another kind or of another format version.
        """
        header, arrays = read_arrays(path, LOBES)
        with whole(path, header, FORMAT_VERSION, "field of lobes"):
            low, axes, stored = (
                arrays[name].astype(np.float32) for name in ("low", "axes", "coefficients")
            )
            _, rows, count, _ = axes.shape
            order, first = int(header["order"]), bands_apart(count)
            layout = layout_from(header, arrays)
            check_field_limits(order, rows, count, texels_of(layout))
            if stored.shape[-1] != max(order - first, 0):
                raise ValueError(f"coefficients have shape {stored.shape}")
            coefficients = np.zeros((*stored.shape[:-1], order), dtype=np.float32)
            coefficients[..., first:] = stored
            return cls(
                low, unit_axes(axes), coefficients, layout,
                bool(header["coherent"]), arrays.get("view"), dict(header.get("metadata", {})),
            )  # fmt: skip


def halved(name: str | Path, lobes: LobesApart) -> LobesApart:
    """Lobes (…, N) as a file holds and a shader sees them, in float32.

    Raises:
        PrtnetError: a coefficient is larger than half precision holds.
    """
    parts = [lobes.low, lobes.lobes.axes, lobes.lobes.coefficients]
    if not all(np.abs(part).max(initial=0.0) <= HALF for part in parts):
        raise PrtnetError(name, "is too bright for lobes in half precision; bake it darker")
    low, axes, coefficients = (part.astype(np.float16).astype(np.float32) for part in parts)
    return LobesApart(low, Lobes(unit_axes(axes), coefficients))


def unit_axes(axes: FloatArray) -> FloatArray:
    """Axes that were rounded, as long as one again."""
    length = np.linalg.norm(axes, axis=-1, keepdims=True)
    return np.asarray(axes / np.maximum(length, np.float32(1e-6)), dtype=np.float32)
