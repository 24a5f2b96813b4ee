"""Distant light from all around: radiance by direction, its coefficients, and turning it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.equirectangular import Picture
from prtnet.errors import PrtnetError, nearest_name
from prtnet.exr import read_exr
from prtnet.hdr import read_hdr
from prtnet.presets import PRESETS
from prtnet.sh import window
from prtnet.sh_rotation import checked_rotation, rotate

__all__ = ["Environment", "Source", "about_up", "environment"]

HDR_SUFFIXES = (".hdr", ".pic", ".rgbe")
BRIGHTEST = 1e30  # products with transfer must still be 32-bit floats


class Source(Protocol):
    """What an environment is made of, as it stands before it is turned."""

    def radiance(self, directions: FloatArray) -> FloatArray:
        """Linear RGB at unit directions (N, 3): (N, 3)."""
        ...

    def harmonics(self, order: int) -> FloatArray:
        """Coefficients (n², 3)."""
        ...


@dataclass(frozen=True)
class Environment:
    """A source, turned.

    Attributes:
        source: a ``Preset``, a ``Picture``, or anything else with radiance and coefficients.
        rotation: R, (3, 3): the light in direction s is the source's in direction R⁻¹ s.
    """

    source: Source
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))

    def radiance(self, directions: FloatArray) -> FloatArray:
        """Linear RGB at unit directions (N, 3): (N, 3), sharp: of no order."""
        return self.source.radiance(np.asarray(directions) @ self.rotation)

    def harmonics(self, order: int, dering: float = 0.0) -> FloatArray:
        """Coefficients of radiance, (n², 3) float64, world frame.

        Args:
            order: number of bands n.
            dering: γ of ``prtnet.sh.window``: above 0 it takes the ripples off a small bright
                source, at the price of a softer light. 0.01 is mild, 0.1 strong.
        """
        turned = rotate(self.source.harmonics(order).T, self.rotation).T
        return np.asarray(turned * window(order, dering)[:, None])

    def rotated(self, rotation: FloatArray) -> Environment:
        """The light turned further, by a rotation (3, 3).

        Raises:
            ValueError: not a rotation.
        """
        return Environment(self.source, np.asarray(checked_rotation(rotation) @ self.rotation))

    def turned(self, degrees: float) -> Environment:
        """The light turned about +y: by 90 degrees, what was at +z is at +x."""
        return self.rotated(about_up(degrees))


def about_up(degrees: float) -> FloatArray:
    """The rotation (3, 3) about +y that takes +z towards +x."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def environment(name_or_path: str | Path) -> Environment:
    """The light of a name or a file.

    Args:
        name_or_path: one of ``PRESETS``, or an equirectangular picture twice as wide as high,
            Radiance ``.hdr`` or OpenEXR ``.exr``.

    Raises:
        PrtnetError: no such light, or the file cannot be used.
    """
    name = str(name_or_path)
    if name in PRESETS:
        return Environment(PRESETS[name])
    suffix = Path(name).suffix.lower()
    if suffix == ".exr":
        return Environment(Picture(checked(name, read_exr(name))))
    if suffix in HDR_SUFFIXES or Path(name).exists():
        return Environment(Picture(checked(name, read_hdr(name))))
    known = nearest_name(name, PRESETS)
    raise PrtnetError("--light", f"'{name}' is neither a file nor a preset; {known}")


def checked(path: str, texels: FloatArray) -> FloatArray:
    """The texels of a file (H, W, 3) if they are a whole sphere of numbers to compute with."""
    height, width = texels.shape[:2]
    if width != 2 * height:
        raise PrtnetError(path, f"is {width}x{height}; a light must be twice as wide as high")
    bad = ~np.isfinite(texels).all(axis=-1)
    if bad.any():
        row, column = divmod(int(bad.argmax()), width)
        value = texels[row, column][~np.isfinite(texels[row, column])][0]
        raise PrtnetError(
            path, f"holds {value} in row {row}, column {column} (from 0, top left); repair it there"
        )
    if not np.abs(texels).max() < BRIGHTEST:
        raise PrtnetError(path, "is too bright to compute with; scale it down")
    return texels
