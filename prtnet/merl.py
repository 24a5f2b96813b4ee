"""Measured isotropic BRDFs in the ``.binary`` format of MERL (Matusik et al. 2003)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.brdf import BRDF, half_vector
from prtnet.errors import PrtnetError

__all__ = ["SHAPE", "Measured", "bins", "read_merl"]

SHAPE = (90, 90, 180)  # of half angle, difference angle, and azimuth of the difference
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0  # of red, green and blue
MOST = 1e30  # as stored: float32 holds what it is scaled to
HEADER = 12  # bytes: three int32


@dataclass(frozen=True, eq=False)
class Measured(BRDF):
    """A table of f over half vector and difference angles; the nearest bin, as it was measured.

    Attributes:
        table: (90, 90, 180, 3) float32, linear RGB.
    """

    name: ClassVar[str] = "measured"
    mirrors: ClassVar[bool] = False  # as far as it was measured
    table: FloatArray

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """The bin of both directions."""
        half, difference, azimuth = bins(light, view)
        return self.table[half, difference, azimuth].astype(np.float64)


def bins(light: FloatArray, view: FloatArray) -> tuple[IntArray, IntArray, IntArray]:
    """Indices (…) of directions (…, 3) that broadcast (Rusinkiewicz 1998)."""
    light, view = np.broadcast_arrays(light, view)
    half = half_vector(light, view)
    theta_half = np.arccos(np.clip(half[..., 2], -1.0, 1.0))
    phi_half = np.arctan2(half[..., 1], half[..., 0])
    # The light in the half vector's frame: turned by −φ_h about z, then by −θ_h about y.
    c, s = np.cos(-phi_half), np.sin(-phi_half)
    x, y = c * light[..., 0] - s * light[..., 1], s * light[..., 0] + c * light[..., 1]
    c, s = np.cos(-theta_half), np.sin(-theta_half)
    x, z = c * x + s * light[..., 2], -s * x + c * light[..., 2]
    theta = np.arccos(np.clip(z, -1.0, 1.0))
    phi = np.arctan2(y, x)
    phi = np.where(phi < 0.0, phi + math.pi, phi)  # f is reciprocal
    numbers = (
        SHAPE[0] * np.sqrt(2.0 * theta_half / math.pi),
        SHAPE[1] * 2.0 * theta / math.pi,
        SHAPE[2] * phi / math.pi,
    )
    first, second, third = (
        np.clip(value.astype(np.int64), 0, size - 1)
        for value, size in zip(numbers, SHAPE, strict=True)
    )
    return first, second, third


def read_merl(path: str | Path) -> Measured:
    """Read a ``.binary`` file; what was not measured (negative) is black.

    Raises:
        PrtnetError: the file is missing, of another layout, cut short, or holds values that are
            not finite.
    """
    file = Path(path)
    if not file.is_file():
        raise PrtnetError(path, "does not exist or is no file; give a MERL .binary")
    size = math.prod(SHAPE)
    expected = HEADER + 3 * 8 * size
    found = file.stat().st_size
    with open(file, "rb") as stream:
        header = np.frombuffer(stream.read(HEADER).ljust(HEADER, b"\0"), dtype="<i4")
    if header.tolist() != list(SHAPE):
        raise PrtnetError(path, f"is no MERL .binary of {SHAPE}: it begins with {header.tolist()}")
    if found != expected:
        raise PrtnetError(path, f"has {found} bytes, not {expected}; download it again")
    planes = np.fromfile(file, dtype="<f8", offset=HEADER).reshape(3, *SHAPE)
    if not (np.abs(planes) < MOST).all():  # so that NaN fails
        raise PrtnetError(path, "holds values that no surface has; download it again")
    table = np.moveaxis(np.maximum(planes, 0.0), 0, -1) * SCALE
    return Measured(table.astype(np.float32))
