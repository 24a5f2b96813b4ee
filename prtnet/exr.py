"""OpenEXR pictures: a reader of what a light needs, on top of the format's own library."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.hdr import PIXEL_LIMIT
from prtnet.hushed import hushed

__all__ = ["read_exr"]

DAMAGED = "is damaged or cut short; fetch or write it again"
MAGIC = b"\x76\x2f\x31\x01"


def read_exr(path: str | Path) -> FloatArray:
    """Linear RGB (H, W, 3) float32, top row first, of the first part of a file.

    Channels R, G and B, or Y alone for a grey picture; half or float, flat (not deep). Numbers
    that are not finite are passed on.

    Raises:
        PrtnetError: not such a file, damaged, or without these channels.
    """
    try:
        with Path(path).open("rb") as file:
            start = file.read(len(MAGIC))
    except OSError as error:
        reason = error.strerror or str(error)
        raise PrtnetError(path, f"cannot be read ({reason}); check the name") from error
    if start != MAGIC:
        raise PrtnetError(path, "is not an OpenEXR picture; convert the light to that format")
    header = opened(path, header_only=True).header
    try:
        known = {channel.name: channel for channel in header["channels"]}
    except (KeyError, UnicodeDecodeError) as error:
        raise PrtnetError(path, DAMAGED) from error
    names = ["Y"] * 3 if "Y" in known and not {"RY", "BY"} & set(known) else ["R", "G", "B"]
    if missing := [name for name in names if name not in known]:
        raise PrtnetError(
            path,
            f"has no channel {missing[0]} (it has {', '.join(sorted(known)) or 'none'}); "
            "save it as plain RGB",
        )
    if any((known[name].xSampling, known[name].ySampling) != (1, 1) for name in names):
        raise PrtnetError(path, "has channels of fewer pixels than others; save it as plain RGB")
    check_window(path, header)
    channels = opened(path, header_only=False).channels
    pixels = [channels[name].pixels for name in names]
    if any(channel.ndim != 2 or channel.dtype.kind != "f" for channel in pixels):
        raise PrtnetError(path, "is deep or of whole numbers; save it as flat half or float RGB")
    return np.stack(pixels, axis=-1).astype(np.float32)


def check_window(path: str | Path, header: dict[str, Any]) -> None:
    """Whether pixels are there for all of the picture, and not too many."""
    (left, top), (right, bottom) = (corner.tolist() for corner in header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    if not 0 < height * width <= PIXEL_LIMIT:
        raise PrtnetError(path, f"is {width}x{height}; use at least one pixel, at most 11585x5792")
    shown = [corner.tolist() for corner in header["displayWindow"]]
    if shown != [[left, top], [right, bottom]]:
        raise PrtnetError(path, "is cropped (data and display window differ); save all of it")


def opened(path: str | Path, header_only: bool) -> Any:
    """The first part of a file."""
    import OpenEXR

    try:
        with hushed():
            return OpenEXR.File(str(path), separate_channels=True, header_only=header_only).parts[0]
    except (RuntimeError, ValueError, TypeError, IndexError, MemoryError) as error:
        raise PrtnetError(path, DAMAGED) from error
