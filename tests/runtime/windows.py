"""Windows on a virtual screen, and the events that a person would send them."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["SIZE", "drag", "press", "read", "save", "send", "sized"]

SIZE = (160, 120)
Viewer = Any  # any ``runtime.base_viewer.BaseViewer``


def sized(window: Any) -> None:
    """As it was opened."""
    window.use()
    window._window.set_size(*SIZE)
    window._window.dispatch_events()


def send(viewer: Viewer, *event: Any) -> None:
    """An event through the window's queue."""
    viewer.window._window.dispatch_event(*event)
    viewer.window._window.dispatch_events()


def press(viewer: Viewer, *names: str) -> None:
    """As the window system tells of keys."""
    from pyglet.window import key

    for name in names:
        for kind in ("on_key_press", "on_key_release"):
            send(viewer, kind, getattr(key, name), 0)


def drag(viewer: Viewer, button: str, right: int, up: int) -> None:
    """As the window system tells of a mouse, away from the panel."""
    from pyglet.window import mouse

    pressed = getattr(mouse, button)
    for kind, rest in (
        ("on_mouse_press", (pressed, 0)),
        ("on_mouse_drag", (right, up, pressed, 0)),
        ("on_mouse_release", (pressed, 0)),
    ):
        send(viewer, kind, 150, 10, *rest)


def read(viewer: Viewer) -> np.ndarray:
    return viewer.pixels().astype(int)


def save(viewer: Viewer, name: str) -> None:
    """Press a key that saves and go on until it is done."""
    press(viewer, name)
    viewer.step(0.0)
    while viewer.saving is not None:
        viewer.step(0.0)
