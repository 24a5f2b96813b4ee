"""Principal components in few bits: each in as many bands and bits as it is worth.

A component (R · n²) becomes integers of 4 or 8 bits, a scale of its own, and a profile over the n²
coefficients that all components share. A trailing component explains little: 4 bits change what it
brings by a hundredth, where the leading ones need 8.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.storage import coarse

__all__ = ["BITS", "Coded", "Coding", "coding", "from_bytes", "leading_bits", "to_bytes"]

BITS = {4: 7, 8: 127}  # bits of a component, and the largest integer they hold
CLIPPED = (1.0, 0.85, 0.7, 0.55)  # parts of the range that integers may span: the best is taken
LEAST = 0.05  # quantile of components' energy that is not worth more bytes
ROUNDING = 7.0  # times that energy: on the robot more bits buy less from there on


@dataclass(frozen=True, eq=False)
class Coding:
    """How each of K components is stored.

    Attributes:
        bits: 4 or 8, (K,).
        orders: bands o that it has, (K,); its coefficients from o² on are zero.
        profile: scale of each coefficient, (n²,).
    """

    bits: IntArray
    orders: IntArray
    profile: FloatArray

    def __len__(self) -> int:
        """Number of components."""
        return len(self.bits)

    def classes(self) -> Iterator[tuple[int, int, IntArray]]:
        """Bits, bands, and the components that have them; each component once."""
        for bits in sorted(BITS):
            for order in np.unique(self.orders):
                rows = np.flatnonzero((self.bits == bits) & (self.orders == order))
                if len(rows) > 0:
                    yield bits, int(order), rows

    def encode(self, basis: FloatArray) -> Coded:
        """Components (K, R · n²) as they are stored; of what it decodes to, the same again."""
        size = len(self.profile)
        value = basis.reshape(len(self), basis.shape[1] // size, size) / self.profile
        value = np.where(np.arange(size) < self.orders[:, None, None] ** 2, value, 0.0)
        most = np.where(self.bits == 4, BITS[4], BITS[8])[:, None, None]
        largest = np.abs(value).max(axis=(1, 2), keepdims=True, initial=0.0)
        largest = np.where(largest > 0, largest, 1.0).astype(np.float32)
        codes = np.zeros(value.shape, dtype=np.int8)
        scale = np.zeros_like(largest)
        least = np.full(largest.shape, np.inf)
        for part in CLIPPED:
            step = coarse(part * largest / most)
            nearest = np.clip(np.rint(value / step), -most, most)
            error = np.square((nearest * step - value) * self.profile).sum((1, 2), keepdims=True)
            better = error < least
            codes = np.where(better, nearest.astype(np.int8), codes)
            scale, least = np.where(better, step, scale), np.minimum(error, least)
        return Coded(codes.reshape(basis.shape), scale[:, 0].astype(np.float32), self)


@dataclass(frozen=True, eq=False)
class Coded:
    """Components as they are stored.

    Attributes:
        values: integers, (K, R · n²) int8, zero beyond a component's bands.
        scale: (K, 1).
        coding: how.
    """

    values: Any
    scale: FloatArray
    coding: Coding

    def array(self) -> FloatArray:
        """``scale · profile · values``, (K, R · n²) float32."""
        slots = self.values.shape[1] // len(self.coding.profile)
        every = np.tile(self.coding.profile, slots)
        return (self.scale * (self.values.astype(np.float32) * every)).astype(np.float32)


def coding(basis: FloatArray, size: int, bits: IntArray, orders: IntArray | None = None) -> Coding:
    """With the profile that suits components (K, R · n²), ``size`` n²; all bands when not given."""
    shaped = basis.reshape(len(basis), basis.shape[1] // size, size).astype(np.float64)
    spread = np.sqrt(np.square(shaped).mean(axis=(0, 1))) if shaped.size else np.zeros(size)
    profile = coarse(np.where(spread > 0, spread, 1.0).astype(np.float32))
    full = np.full(len(basis), round(size**0.5), dtype=np.int32)
    return Coding(
        bits.astype(np.int32), full if orders is None else orders.astype(np.int32), profile
    )


def leading_bits(energy: FloatArray) -> IntArray:
    """Bits of components of so much energy each, (K,): 8 where 4 lose more than others bring.

    Those others are the twentieth part that brings least: as many bytes could buy more of them.
    """
    positive = energy[energy > 0]
    least = float(np.quantile(positive, LEAST)) if len(positive) else 0.0
    return np.where(energy > ROUNDING * least, 8, 4).astype(np.int32)


def packed(codes: Any) -> Any:
    """Integers −7 … 7, (K, W) int8, as two in a byte (K, ⌈W/2⌉): the left half plus 8, low."""
    half = -(-codes.shape[1] // 2)
    shifted = np.pad(codes, ((0, 0), (0, 2 * half - codes.shape[1]))).astype(np.int16) + 8
    return (shifted[:, :half] + 16 * shifted[:, half:]).astype(np.uint8)


def unpacked(pairs: Any, width: int) -> Any:
    """The inverse of :func:`packed`, for W ``width``."""
    return (np.concatenate([pairs % 16, pairs // 16], axis=1).astype(np.int8) - 8)[:, :width]


def blocks(coded: Coded) -> Iterator[tuple[int, int, IntArray, Any]]:
    """As :meth:`Coding.classes`, with the bytes of those components, (B, bytes) uint8."""
    size = len(coded.coding.profile)
    for bits, order, rows in coded.coding.classes():
        own = coded.values[rows].reshape(len(rows), -1, size)[..., : order**2]
        own = own.reshape(len(rows), -1)
        yield bits, order, rows, packed(own) if bits == 4 else own.view(np.uint8)


def to_bytes(coded: Coded) -> Any:
    """All bytes one after the other, class by class, (bytes,) uint8."""
    parts = [own.ravel() for *_, own in blocks(coded)]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.uint8)


def from_bytes(data: Any, scale: FloatArray, how: Coding, slots: int) -> Coded:
    """The inverse of :func:`to_bytes`, for components of R ``slots``.

    Raises:
        ValueError: there are more or fewer bytes than that.
    """
    size = len(how.profile)
    values = np.zeros((len(how), slots, size), dtype=np.int8)
    at = 0
    for bits, order, rows in how.classes():
        width = slots * order**2
        length = -(-width // 2) if bits == 4 else width
        own = data[at : at + len(rows) * length]
        if len(own) < len(rows) * length:
            raise ValueError("basis is shorter than its bits and orders say")
        own = own.reshape(len(rows), length)
        own = unpacked(own, width) if bits == 4 else own.view(np.int8)
        values[rows, :, : order**2] = own.reshape(len(rows), slots, order**2)
        at += len(rows) * length
    if at != len(data) or scale.shape != (len(how), 1):
        raise ValueError("basis does not fit its bits and orders")
    return Coded(values.reshape(len(how), slots * size), scale, how)
