"""The pictures a command makes, one or many: where each is from, and the files they go to."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from prtnet.arrays import FloatArray
from runtime.movie import movie, require_movies
from runtime.picture import save_png

__all__ = ["Frame", "opened_reel", "reel", "saved_frames"]


@dataclass(frozen=True)
class Frame:
    """One of the pictures to make.

    Attributes:
        time: seconds into the clip.
        turn: how far the camera has walked around, radians.
        path: its own file; None for a picture of a movie.
    """

    time: float
    turn: float = 0.0
    path: Path | None = None


def reel(out: Path, spin: int | None, time: float, times: Sequence[float]) -> list[Frame]:
    """The pictures to make: one, all around, or one after the other.

    Args:
        out: where to, a picture or a movie.
        spin: how many all around; each has a file of its own where it is no movie.
        time: of a picture that is not of a movie of all times.
        times: of a movie that does not go around.

    Raises:
        PrtnetError: movies cannot be written.
    """
    moving = out.suffix.lower() == ".mp4"
    if moving:
        require_movies(out)
    if spin is None:
        return [Frame(each) for each in times] if moving else [Frame(time, 0.0, out)]
    width = len(str(spin - 1))
    names = [out.with_stem(f"{out.stem}_{k:0{width}}") for k in range(spin)]
    return [
        Frame(time, 2.0 * math.pi * k / spin, None if moving else name)
        for k, name in enumerate(names)
    ]


def saved_frames(frames: Sequence[Frame], out: Path) -> Path | list[Path | None]:
    """The file, or the files, that pictures go to."""
    return out if frames[0].path in (None, out) else [frame.path for frame in frames]


@contextlib.contextmanager
def opened_reel(out: Path, fps: int) -> Iterator[Callable[[Frame, FloatArray], None]]:
    """What pictures (H, W, 3) are handed to: files of their own, or a movie.

    Raises:
        PrtnetError: it cannot be written.
    """
    if out.suffix.lower() != ".mp4":
        yield lambda frame, picture: save_png(frame.path or out, picture)
        return
    with movie(out, fps) as add:
        yield lambda _, picture: add(picture)
