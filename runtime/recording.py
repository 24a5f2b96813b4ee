"""What a viewer saves: a picture, a turntable as pictures or a movie, a movie of what moves.

Each is made a picture a step, so that the window goes on answering; the view is then as it was.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from runtime.movie import movie
from runtime.picture import save_png

if TYPE_CHECKING:
    from runtime.base_viewer import BaseViewer

    AnyViewer = BaseViewer[Any, Any, Any]

__all__ = ["clip_movie", "free_name", "picture", "turntable", "turntable_movie"]

TURNTABLE = 36  # pictures
MOVIE_TURN = 120  # pictures of a movie around: four seconds
FPS = 30


def free_name(folder: Path, kind: str, suffix: str) -> Path:
    """A file that is not there yet, nor any that begins like it."""
    number = 0
    while any(folder.glob(f"{kind}_{number:03d}*{suffix}")):
        number += 1
    return folder / f"{kind}_{number:03d}{suffix}"


def picture(viewer: AnyViewer) -> Iterator[str]:
    """One picture of the view as it is."""
    path = free_name(viewer.desk.out, "picture", ".png")
    save_png(path, viewer.pixels())
    yield f"saved {path}"


def turns(viewer: AnyViewer, count: int) -> Iterator[int]:
    """The view from all around, a step at a time; it is then where it was."""
    start = viewer.view.azimuth
    try:
        for number in range(count):
            viewer.view.azimuth = (start + 2.0 * math.pi * number / count) % (2.0 * math.pi)
            yield number
    finally:
        viewer.view.azimuth = start


def turntable(viewer: AnyViewer) -> Iterator[str]:
    """Pictures from all around."""
    first = free_name(viewer.desk.out, "turn", ".png")
    for number in turns(viewer, TURNTABLE):
        path = first.with_name(f"{first.stem}_{number:02d}.png")
        save_png(path, viewer.pixels())
        yield f"saved {path}"


def turntable_movie(viewer: AnyViewer) -> Iterator[str]:
    """The same as a movie."""
    path = free_name(viewer.desk.out, "turn", ".mp4")
    with movie(path, FPS) as add:
        for number in turns(viewer, MOVIE_TURN):
            add(viewer.pixels())
            yield f"{number + 1} of {MOVIE_TURN} pictures (Esc: stop)"
    yield f"saved {path}"


def clip_movie(viewer: AnyViewer) -> Iterator[str]:
    """All that moves, from its start to its end."""
    path = free_name(viewer.desk.out, "clip", ".mp4")
    with movie(path, FPS) as add:
        for number, count in viewer.show.through(viewer.view, FPS):
            add(viewer.pixels())
            yield f"{number + 1} of {count} pictures (Esc: stop)"
    yield f"saved {path}"
