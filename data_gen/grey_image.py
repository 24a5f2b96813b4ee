"""Greyscale pictures as height fields and maps: PNG, JPEG, TIFF, ... of 8 or 16 bits, and EXR."""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.exr import read_exr
from prtnet.hushed import hushed
from prtnet.luminance import REC709

__all__ = ["PICTURES", "read_grey"]

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".tga", ".pgm", ".exr")
LARGEST = 1 << 26  # pixels
MOST_BYTES = 16 * LARGEST  # of a file
STRIP = 1 << 20  # pixels at a time
SHARES = np.arange(256) / 255.0  # of white, of a byte
# Of all that Pillow knows: for some others it runs programs (Ghostscript for EPS).
FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP", "TGA", "PPM")


def read_grey(path: str | Path, texels: tuple[int, int] | None = None) -> FloatArray:
    """Grey values (H, W) float64, **bottom row first**: 0 is black, 1 white.

    The numbers of the file as they are, neither gamma nor colour space undone: they stand for
    heights or shares. An ``.exr`` may have any numbers, −∞ among them.

    Args:
        path: of the picture.
        texels: W and H to resample to; as many as there are when not given.

    Raises:
        PrtnetError: it is no picture, too large, or holds NaN or +∞.
    """
    path = Path(path)
    with np.errstate(invalid="ignore"):  # what is no number is told below
        if path.suffix.lower() == ".exr":
            grey = np.ascontiguousarray((read_exr(path) @ REC709)[::-1])
        else:
            grey = decoded(path)
    # By one number alone: to go through a large picture again and again takes long.
    highest = grey.max(initial=-np.inf)
    if np.isnan(highest):
        count = int(np.isnan(grey).sum())
        raise PrtnetError(path, f"holds {count} values that are not numbers (NaN); repair it")
    if highest == np.inf:
        raise PrtnetError(path, "holds heights that are infinite upwards; repair it")
    if highest == -np.inf:
        raise PrtnetError(path, "has no finite height; give a picture of a surface")
    if texels is not None and texels != grey.shape[::-1]:
        if not np.isfinite(grey).all():
            raise PrtnetError(path, "has pits without floor and cannot be resampled; leave --size")
        grey = np.ascontiguousarray(resampled(grey[::-1], texels)[::-1])
    return grey


class Bounded(io.BufferedReader):
    """A file's bytes; however many are asked for, no more room is made than there are."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._end = os.fstat(self.fileno()).st_size

    def read(self, size: int | None = -1, /) -> bytes:
        """The next bytes, all of them for a negative size."""
        left = max(self._end - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


def decoded(path: Path) -> FloatArray:
    """Grey values (H, W) of a picture that Pillow reads, bottom row first."""
    try:
        if path.stat().st_size > MOST_BYTES:
            raise PrtnetError(path, "is larger than any picture here; resample it first")
        with warnings.catch_warnings(), hushed():  # libtiff prints lines of its own
            warnings.simplefilter("error")
            with Bounded(path) as file, Image.open(file, formats=FORMATS) as picture:
                if picture.width * picture.height > LARGEST:
                    raise PrtnetError(path, "has too many pixels; resample it first")
                return grey_of(picture)
    except PrtnetError:
        raise
    except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
        raise PrtnetError(path, "has too many pixels; resample it first") from error
    except Exception as error:  # a damaged file can break its parsers in any way
        known = "it is no picture" if isinstance(error, UnidentifiedImageError) else str(error)
        reason = known[:120] or type(error).__name__
        raise PrtnetError(path, f"cannot be read ({reason}); give a greyscale picture") from error


def grey_of(picture: Image.Image) -> FloatArray:
    """Grey values (H, W) of one picture, bottom row first; by strips, for memory's sake."""
    width, height = picture.size
    grey, rows = np.empty((height, width)), max(1, STRIP // width)
    for top in range(0, height, rows):
        end = min(top + rows, height)
        strip = grey_strip(picture.crop((0, top, width, end)))
        grey[height - end : height - top] = strip[::-1]
    return grey


def grey_strip(picture: Image.Image) -> FloatArray:
    """The same of a few rows, top first: 8 and 16 bits over their most, floats as they are."""
    if picture.mode == "F":
        return np.asarray(picture, dtype=np.float64)
    if picture.mode.startswith("I"):
        whole = np.asarray(picture)
        if whole.max(initial=0) > 65535 or whole.min(initial=0) < 0:
            raise ValueError("whole numbers beyond 16 bits; save it with 16 bits or as floats")
        return np.asarray(whole / 65535.0)
    if picture.mode == "L":
        return np.asarray(SHARES[np.asarray(picture)])
    colour = np.asarray(picture.convert("RGB"))
    grey = (REC709[0] * SHARES)[colour[..., 0]]
    for channel in (1, 2):
        grey += (REC709[channel] * SHARES)[colour[..., channel]]
    return np.asarray(grey)


def resampled(grey: FloatArray, texels: tuple[int, int]) -> FloatArray:
    """The picture (H, W) with other texels: means where there are fewer, lines where more."""
    fewer = texels[0] <= grey.shape[1] and texels[1] <= grey.shape[0]
    how = Image.Resampling.BOX if fewer else Image.Resampling.BILINEAR
    picture = Image.fromarray(grey.astype(np.float32))
    return np.asarray(picture.resize(texels, how), dtype=np.float64)
