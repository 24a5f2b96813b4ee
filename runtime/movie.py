"""Pictures in a row as one file: H.264 in MP4, by PyAV.

Needs PyAV, of the extra ``viewer``.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from prtnet.files import writing

__all__ = ["movie", "require_movies"]

CODECS = {"libx264": {"crf": "18"}, "mpeg4": {"qscale": "3"}}
"""The first that PyAV was built with, and its quality."""


def require_movies(path: Path) -> Any:
    """PyAV.

    Raises:
        PrtnetError: it is not installed.
    """
    try:
        import av
    except ImportError as error:
        raise PrtnetError(
            path, "needs PyAV to be written: pip install 'prtnet[viewer]', or write pictures (.png)"
        ) from error
    return av


@contextlib.contextmanager
def movie(path: Path, fps: int) -> Iterator[Callable[[FloatArray], None]]:
    """A movie that pictures (H, W, 3) uint8 sRGB of one size are added to by calling what is given.

    The file appears when the block ends well, or not at all. A last odd row or column is doubled:
    colour is stored for 2 x 2 pixels.

    Raises:
        PrtnetError: PyAV is not installed, or the file cannot be written.
    """
    av = require_movies(path)
    codec = next((name for name in CODECS if name in av.codecs_available), None)
    if codec is None:
        known = " or ".join(CODECS)
        raise PrtnetError(path, f"needs a PyAV with {known}; install another, or save pictures")
    options = {"movflags": "faststart"}  # plays before it is all there
    with writing(path) as partial, av.open(str(partial), "w", "mp4", options=options) as file:
        stream = file.add_stream(codec, rate=fps, options=CODECS[codec])
        stream.pix_fmt = "yuv420p"  # what every player knows
        sizes: list[tuple[int, ...]] = []

        def add(picture: FloatArray) -> None:
            height, width = picture.shape[:2]
            even = np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            if not sizes:
                stream.height, stream.width = even.shape[:2]
                sizes.append(picture.shape)
            if sizes[0] != picture.shape:
                raise PrtnetError(path, "wants pictures of one size; leave the window as it is")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(even), format="rgb24")
            file.mux(stream.encode(frame))

        yield add
        file.mux(stream.encode(None))
