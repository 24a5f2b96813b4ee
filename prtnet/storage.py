"""Large arrays in fewer bytes: half precision, or 8 bits with a scale for each row.

A stored array stands for ``offset + scale · values``. Scales are coarse numbers (a few bits of
mantissa), so that storing what was read back gives the same bytes and the same values again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from prtnet.arrays import FloatArray

__all__ = [
    "HALF_LIMIT",
    "MOST",
    "STORAGES",
    "Packing",
    "Storage",
    "Stored",
    "coarse",
    "pack",
    "quantise",
    "rounded",
    "unpack",
]

Storage = Literal["float32", "float16", "int8", "int4"]
STORAGES: tuple[Storage, ...] = get_args(Storage)
INTEGERS = (np.uint8, np.int16, np.int32)  # that indices are stored in
MOST = 127  # 8-bit values lie in [−MOST, MOST], as the signed normalised texels of a GPU
HALF_LIMIT = 65504.0  # the largest half
MANTISSA = 2**11  # scales are multiples of a power of two by at most this


@dataclass(frozen=True, eq=False)
class Packing:
    """How an array is stored.

    Attributes:
        kind: of its values.
        axis: the axes that share a scale, the last among them.
        period: along the last axis every period-th value shares a scale: n² for one scale a
            coefficient, 1 for one scale a row.
        offset: what stored values are deviations from, (period,); None for zero.
    """

    kind: Storage
    axis: tuple[int, ...] = (-1,)
    period: int = 1
    offset: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class Stored:
    """An array as it is stored.

    Attributes:
        values: (…, W) float32, float16 or int8.
        scale: float32, as many axes, each one long or as long as the array's; the last, its
            period, divides W and repeats along it.
        offset: (period,) float32, repeats along the last axis; None for zero.
    """

    values: Any
    scale: FloatArray
    offset: FloatArray | None = None

    def array(self) -> FloatArray:
        """``offset + scale · values``, float32."""
        period = self.scale.shape[-1]
        value = split(self.values, period).astype(np.float32) * self.scale[..., None, :]
        if self.offset is not None:
            value = value + self.offset
        return value.reshape(self.values.shape).astype(np.float32, copy=False)


def split(array: Any, period: int) -> Any:
    """(…, W) as (…, W / period, period).

    Raises:
        ValueError: the period does not divide W.
    """
    return array.reshape(*array.shape[:-1], array.shape[-1] // max(1, period), period)


def quantise(array: FloatArray, packing: Packing) -> Stored:
    """An array (…, W) as it is stored; ``array()`` of the result is the nearest there is to it."""
    value = split(array.astype(np.float32), packing.period)
    if packing.offset is not None:
        value = value - packing.offset
    shared = tuple(axis % array.ndim for axis in packing.axis)
    largest = np.abs(value).max(axis=shared, keepdims=True, initial=0.0)
    largest = np.where(largest > 0, largest, 1.0)
    if packing.kind == "int8":
        scale = coarse(largest / np.float32(MOST))
        values = np.clip(np.rint(value / scale), -MOST, MOST).astype(np.int8)
    elif packing.kind == "float16":  # a power of two: what fits in 11 bits stays as it is
        mantissa, exponent = np.frexp(largest)
        scale = np.ldexp(np.where(mantissa > 0.5, 1.0, 0.5), exponent)
        values = (value / scale).astype(np.float16)
    else:
        return Stored(array.astype(np.float32), np.ones((1,) * array.ndim, dtype=np.float32))
    squeezed = scale.squeeze(-2).astype(np.float32)
    return Stored(values.reshape(array.shape), squeezed, packing.offset)


def coarse(scale: FloatArray) -> FloatArray:
    """Scales of few bits of mantissa: products with them can be taken apart again."""
    mantissa, exponent = np.frexp(scale)
    return np.ldexp(np.rint(mantissa * MANTISSA) / MANTISSA, exponent)


def rounded(array: FloatArray, packing: Packing) -> FloatArray:
    """An array as it will be read back, float32."""
    return quantise(array, packing).array()


def pack(arrays: Mapping[str, Any], packings: Mapping[str, Packing]) -> dict[str, Any]:
    """Named arrays for a file: those with a packing stored so, with ``scale.…``, ``offset.…``.

    Integers take as many bytes as they need.
    """
    packed = {name: narrowest(array) for name, array in arrays.items()}
    for name, packing in packings.items():
        if name in arrays and packing.kind != "float32":
            stored = quantise(arrays[name], packing)
            packed |= {name: stored.values, f"scale.{name}": stored.scale}
            if stored.offset is not None:
                packed[f"offset.{name}"] = stored.offset
    return packed


def narrowest(array: Any) -> Any:
    """Integers in the smallest of uint8, int16 and int32 that holds them; others as they are."""
    if not np.issubdtype(array.dtype, np.signedinteger) or array.size == 0:
        return array
    low, high = array.min(), array.max()
    for dtype in INTEGERS:
        if low >= np.iinfo(dtype).min and high <= np.iinfo(dtype).max:
            return array.astype(dtype)
    return array


def unpack(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of :func:`pack`: float32 and int32 again, scales and offsets gone.

    Raises:
        ValueError: a scale or an offset does not fit its array, or belongs to none.
    """
    plain = {n: a for n, a in arrays.items() if not n.startswith(("scale.", "offset."))}
    for name in arrays.keys() - plain.keys():
        if name.partition(".")[2] not in plain:
            raise ValueError(f"{name} belongs to no array")
    for name in list(plain):
        scale = arrays.get(f"scale.{name}")
        if scale is not None:
            shape = plain[name].shape
            if scale.ndim != len(shape) or any(
                s not in (1, w) for s, w in zip(scale.shape[:-1], shape[:-1], strict=True)
            ):
                raise ValueError(f"scale.{name} does not fit {name}")
            plain[name] = Stored(plain[name], scale, arrays.get(f"offset.{name}")).array()
        elif plain[name].dtype in INTEGERS:
            plain[name] = plain[name].astype(np.int32)
    return plain
