"""Radiance .hdr pictures (RGBE): a reader.

A reader of our own: the libraries that read this format need a binary fetched at run time or bring
a whole vision toolkit. The format is Greg Ward's [1]: text lines, an empty line, the resolution,
then scanlines of four bytes a pixel (mantissas and a shared exponent), either flat or with each of
the four components run-length coded.

[1] Ward, "Real Pixels", Graphics Gems II, 1991; Radiance file formats, radsite.lbl.gov/radiance.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.files import read_bytes

__all__ = ["read_hdr"]

PIXEL_LIMIT = 1 << 26  # 11585 x 5792 panoramas; 800 MB as floats
MOST_BYTES = 5 * PIXEL_LIMIT  # run-length codes are not longer
ROW_BLOCK = 64


def read_hdr(path: str | Path) -> FloatArray:
    """Linear RGB (H, W, 3) float32, top row first, in the file's unit (W/m²/sr where absolute).

    Raises:
        PrtnetError: not such a file, cut short, or damaged.
    """
    try:
        data = read_bytes(path, MOST_BYTES)
    except OSError as error:
        reason = error.strerror or str(error)
        raise PrtnetError(path, f"cannot be read ({reason}); check the name") from error
    if data is None:
        raise PrtnetError(path, f"has over {MOST_BYTES} bytes; use at most 11585x5792 pixels")
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise PrtnetError(path, "is not a Radiance .hdr picture; convert the light to that format")
    header, _, body = data.partition(b"\n\n")
    line, newline, pixels = body.partition(b"\n")
    size = re.fullmatch(rb"([-+])Y (\d{1,6}) ([-+])X (\d{1,6})\s*", line)
    if not newline or size is None:
        raise PrtnetError(path, "has no '-Y height +X width' line; convert it to that orientation")
    if re.search(rb"^FORMAT=(?!32-bit_rle_rgbe\s*$)", header, re.MULTILINE):
        raise PrtnetError(path, "is not in RGB (FORMAT=32-bit_rle_rgbe); convert it to that")
    height, width = int(size[2]), int(size[4])
    if not 0 < height * width <= PIXEL_LIMIT:
        raise PrtnetError(path, f"is {width}x{height}; use at least one pixel, at most 11585x5792")
    picture = np.empty((height, width, 3), dtype=np.float32)
    position, view = 0, memoryview(pixels)
    for first in range(0, height, ROW_BLOCK):
        rows = min(ROW_BLOCK, height - first)
        rgbe = np.empty((rows, width, 4), dtype=np.uint8)
        for row in range(rows):
            position = read_scanline(path, view, position, rgbe[row])
        picture[first : first + rows] = decode(rgbe)
    picture /= exposure(path, header)
    return picture[:: 1 if size[1] == b"-" else -1, :: 1 if size[3] == b"+" else -1]


def exposure(path: str | Path, header: bytes) -> np.float32:
    """Product of the header's EXPOSURE lines, by which the pixels were multiplied."""
    product = 1.0
    for value in re.findall(rb"^EXPOSURE\s*=\s*(.*)$", header, re.MULTILINE):
        try:
            product *= float(value)
        except ValueError:
            product = 0.0
    if not 1e-30 < product < 1e30:
        raise PrtnetError(path, "has an EXPOSURE that is no positive number; remove that line")
    return np.float32(product)


def decode(rgbe: IntArray) -> FloatArray:
    """RGBE bytes (..., 4) to linear RGB (..., 3) float32; exponent 0 is black."""
    exponent = rgbe[..., 3].astype(np.int32)
    scale = np.where(exponent > 0, np.ldexp(np.float32(1.0), exponent - 136), np.float32(0.0))
    return np.asarray(rgbe[..., :3] * scale[..., None], dtype=np.float32)


def read_scanline(path: str | Path, data: memoryview, position: int, row: IntArray) -> int:
    """Fill one scanline (W, 4) from ``data`` at ``position``; where the next one starts."""
    width = len(row)
    start = bytes(data[position : position + 4])
    if start[:2] == b"\2\2" and 8 <= width < 1 << 15 and start[2:] == width.to_bytes(2, "big"):
        planes, position = read_runs(path, data, position + 4, 4 * width, width)
        row[:] = np.frombuffer(planes, dtype=np.uint8).reshape(4, width).T
        return position
    flat = np.frombuffer(data[position : position + 4 * width], dtype=np.uint8)
    if len(flat) < 4 * width:
        raise PrtnetError(path, "ends before its last pixel; fetch or write it again")
    row[:] = flat.reshape(width, 4)
    if (row[:, :3] == 1).all(axis=1).any():
        # No number is written with such a mantissa: these four bytes mean "repeat".
        raise PrtnetError(path, "uses the run-length code of before 1991; save it again")
    return position + 4 * width


def read_runs(
    path: str | Path, data: memoryview, position: int, count: int, width: int
) -> tuple[bytearray, int]:
    """``count`` bytes of run-length code in planes of ``width``; no run may cross planes."""
    out = bytearray()
    limit = len(data)
    while len(out) < count:
        code = data[position] if position < limit else 1
        length, size = (code - 128, 1) if code > 128 else (code, code)
        values = data[position + 1 : position + 1 + size]
        if len(values) < size:
            raise PrtnetError(path, "ends before its last pixel; fetch or write it again")
        start = len(out)
        if length == 0 or start // width != (start + length - 1) // width:
            raise PrtnetError(path, "is damaged: a run is empty or too long; fetch it again")
        out += bytes(values) * length if code > 128 else values
        position += 1 + size
    return out, position
