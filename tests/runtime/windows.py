"""Windows on a virtual screen, and the events that a person would send them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

__all__ = ["SIZE", "choose", "click", "drag", "noted", "press", "read", "save", "send", "sized"]

SIZE = (160, 120)
Viewer = Any  # any ``runtime.base_viewer.BaseViewer``


def sized(window: Any) -> None:
    """As it was opened, and current: other tests have contexts without a window."""
    window._window.switch_to()
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
    send(viewer, "on_mouse_motion", 150, 10, 0, 0)  # the pointer of the display may be anywhere
    viewer.step(0.0)
    for kind, rest in (
        ("on_mouse_press", (pressed, 0)),
        ("on_mouse_drag", (right, up, pressed, 0)),
        ("on_mouse_release", (pressed, 0)),
    ):
        send(viewer, kind, 150, 10, *rest)


def click(viewer: Viewer, x: float, y: float) -> None:
    """Press and release the left button at a place from the top left; frames in between."""
    from pyglet.window import mouse

    up = viewer.window.size[1] - 1 - round(y)
    send(viewer, "on_mouse_motion", round(x), up, 0, 0)
    viewer.step(0.02)
    for kind in ("on_mouse_press", "on_mouse_release"):
        send(viewer, kind, round(x), up, mouse.LEFT, 0)
        viewer.step(0.02)


def noted(viewer: Viewer, patch: pytest.MonkeyPatch, *kinds: str) -> dict[str, Any]:
    """Where in the panel its items of some kinds are by their labels, from now on.

    Left and right end and the middle of the height, from the top left of the window.
    """
    imgui, places = viewer.imgui, dict[str, Any]()

    def noting(draw: Any) -> Any:
        def drawn(label: str, *given: Any) -> Any:
            found = draw(label, *given)
            low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
            places[label] = low.x, high.x, 0.5 * (low.y + high.y)
            return found

        return drawn

    for kind in kinds:
        patch.setattr(imgui, kind, noting(getattr(imgui, kind)))
    for _ in range(3):  # until the panel has its size
        viewer.step(0.02)
    return places


def choose(viewer: Viewer, place: Any, line: int) -> None:
    """Open the list that is at a place and click on one of its lines."""
    imgui = viewer.imgui
    click(viewer, place[0] + 10, place[2])
    opened, style = imgui.internal.find_window_by_name("##Combo_00"), imgui.get_style()
    assert opened.active
    top = opened.pos.y + style.window_padding.y
    click(viewer, opened.pos.x + 20, top + (line + 0.4) * imgui.get_text_line_height_with_spacing())
    viewer.step(0.02)
    assert not opened.active


def choose_from_lists(
    viewer: Viewer,
    patch: pytest.MonkeyPatch,
    choices: Sequence[tuple[str, int, dict[str, Any]]],
    settle: Callable[[], object] = lambda: None,
) -> dict[str, Any]:
    """Lists by label, the line that is clicked in each, and what that must change of the view.

    All of it and nothing else, and the picture with it, once that has settled. Gives the places of
    the lists.
    """
    size = (400, 700)  # the panel fits
    viewer.show.screen.samples = 0
    viewer.window._window.set_size(*size)
    send(viewer, "on_resize", *size)
    places = noted(viewer, patch, "combo")
    settle()
    before, picture = dataclasses.asdict(viewer.view), read(viewer)
    for label, line, changes in choices:
        choose(viewer, places[label], line)
        settle()
        after, seen = dataclasses.asdict(viewer.view), read(viewer)
        assert after == before | changes, label
        assert np.abs(seen - picture).max() > 5, label
        before, picture = after, seen
    return places


def read(viewer: Viewer) -> np.ndarray:
    return viewer.pixels().astype(int)


def save(viewer: Viewer, name: str) -> None:
    """Press a key that saves and go on until it is done."""
    press(viewer, name)
    viewer.step(0.0)
    while viewer.saving is not None:
        viewer.step(0.0)
