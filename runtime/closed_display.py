"""What happens when the display goes away under a window: X11 ends the program, but asks first."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

__all__ = ["on_closed_display"]

held: list[Any] = []  # what C calls must not be collected


def on_closed_display(leave: Callable[[], None]) -> None:
    """Call this when the X server is gone, in place of Xlib's own last words.

    Nothing happens on systems without X11.

    Args:
        leave: must end the process, and may not use the window: Xlib would end it itself.
    """
    try:
        from pyglet.libs.x11 import xlib
    except Exception:  # whatever a library that is not there is told by
        return

    def gone(_display: Any) -> int:
        with contextlib.suppress(Exception):
            leave()
        return 0

    held.append(xlib.XIOErrorHandler(gone))
    xlib.XSetIOErrorHandler(held[-1])
