"""The window of ``prtnet view``: a :class:`runtime.show.Show` with mouse, keys and a panel.

Needs the extra ``viewer`` (moderngl-window, imgui-bundle).
"""

from __future__ import annotations

import contextlib
import time as clock
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.errors import PrtnetError
from runtime.picture import save_png
from runtime.show import MODES, Show, View

__all__ = ["Viewer", "open_window"]

HELP = (
    ("drag", "walk around"),
    ("right drag", "turn the light"),
    ("middle drag", "move the picture"),
    ("wheel", "come closer"),
    ("Space", "play or pause"),
    ("Left, Right", "step a frame"),
    ("1 to 5", "prediction, truth, open, ambient, error"),
    ("C", "compare: split the picture"),
    ("S", "save a picture"),
    ("T", "save a turntable of pictures"),
    ("R", "back to the first view"),
    ("H", "this help"),
    ("Esc", "leave"),
)
FRAME = 1.0 / 30.0  # seconds of a step of the arrow keys
TURNTABLE = 36  # pictures


def open_window(title: str, size: tuple[int, int], visible: bool = True) -> Any:
    """A window with OpenGL 3.3.

    Raises:
        PrtnetError: the extra is not installed, or there is no display.
    """
    try:
        import imgui_bundle  # noqa: F401
        import moderngl_window
    except ImportError as error:
        raise PrtnetError(
            "prtnet view", "needs its extra: pip install 'prtnet[viewer]'; prtnet render draws "
            "without a window"
        ) from error  # fmt: skip
    try:
        kind = moderngl_window.get_local_window_cls("pyglet")
        return kind(
            title=title, size=size, gl_version=(3, 3), resizable=True, vsync=True, visible=visible
        )
    except Exception as error:  # every platform has errors of its own
        reason = " ".join(str(error).split()) or type(error).__name__
        raise PrtnetError(
            "prtnet view", f"cannot open a window ({reason}); use prtnet render, or give it a "
            "display (xvfb-run)"
        ) from error  # fmt: skip


class Viewer:
    """A window and what it shows.

    Args:
        window: from :func:`open_window`.
        show: what is drawn, on the window's context.
        view: where it starts.
        lights, brdfs: names to choose from.
        out: folder of saved pictures.
        say: is told what was saved.
    """

    def __init__(
        self,
        window: Any,
        show: Show,
        view: View,
        lights: list[str],
        brdfs: list[str],
        out: Path,
        say: Callable[[str], None],
    ) -> None:
        from imgui_bundle import imgui
        from moderngl_window.integrations.imgui_bundle import ModernglWindowRenderer

        from runtime.viewer_panel import Panel

        self.window, self.show, self.view = window, show, view
        self.out, self.say = out, say
        self.helping, self.saved = False, 0
        view.playing = True
        self.good = View(**vars(view))
        self.message = ""
        self.first = View(**vars(view))
        imgui.create_context()
        imgui.get_io().set_ini_filename("")
        self.imgui = imgui
        self.interface = ModernglWindowRenderer(window)
        self.panel = Panel(self, lights, brdfs)
        window.render_func = self.render
        window.resize_func = self.interface.resize
        window.key_event_func = self.key
        window.mouse_position_event_func = self.interface.mouse_position_event
        window.mouse_drag_event_func = self.drag
        window.mouse_scroll_event_func = self.scroll
        window.mouse_press_event_func = self.interface.mouse_press_event
        window.mouse_release_event_func = self.interface.mouse_release_event
        window.unicode_char_entered_func = self.interface.unicode_char_entered
        window.files_dropped_event_func = self.dropped

    def run(self) -> None:
        """Until the window is closed."""
        last = clock.perf_counter()
        while not self.window.is_closing:
            now = clock.perf_counter()
            self.step(now - last)
            last = now

    def step(self, elapsed: float) -> None:
        """One frame, so many seconds after the last."""
        self.window.use()
        self.imgui.get_io().delta_time = max(elapsed, 1e-4)
        if self.view.playing:
            self.advance(elapsed)
        self.render(0.0, elapsed)
        self.window.swap_buffers()  # also hands the window's events out

    def render(self, _time: float, _elapsed: float) -> None:
        """Draw the picture and the panel over it."""
        self.picture()
        self.imgui.new_frame()
        self.panel.draw(HELP if self.helping else ())
        self.imgui.render()
        self.interface.render(self.imgui.get_draw_data())

    def picture(self) -> None:
        """Draw without the panel; a view that cannot be drawn is told, and taken back."""
        size, target = self.window.buffer_size, self.window.fbo
        try:
            self.show.draw(self.view, size, target)
        except Exception as error:  # whatever background work ended in, too
            if vars(self.view) == vars(self.good):
                raise
            self.complain(error)
            vars(self.view).update(vars(self.good))
            self.show.draw(self.view, size, target)
        if not self.show.waiting:  # what is still being made may fail yet
            self.good = View(**vars(self.view))

    def complain(self, error: Exception) -> None:
        """Tell in the panel what went wrong."""
        known = isinstance(error, PrtnetError)
        self.message = f"{error.subject}: {error.message}" if known else f"{error!r}"  # type: ignore[attr-defined]

    def advance(self, seconds: float) -> None:
        """Go on in the clip, and around."""
        clip = self.show.actor.scene.clip(self.view.clip)
        length = clip.end - clip.start
        if length > 0:
            self.view.time = clip.start + (self.view.time - clip.start + seconds) % length

    def key(self, key: Any, action: Any, modifiers: Any) -> None:
        """A key went down or up."""
        keys = self.window.keys
        self.interface.key_event(key, action, modifiers)
        if action != keys.ACTION_PRESS or self.imgui.get_io().want_text_input:
            return
        numbers = (keys.NUMBER_1, keys.NUMBER_2, keys.NUMBER_3, keys.NUMBER_4, keys.NUMBER_5)
        if key in numbers:
            self.view.left = MODES[numbers.index(key)]
        elif key == keys.SPACE:
            self.view.playing = not self.view.playing
        elif key in (keys.LEFT, keys.RIGHT):
            self.view.playing = False
            self.advance(FRAME if key == keys.RIGHT else -FRAME)
        elif key == keys.C:
            self.view.split = 0.5 if self.view.split == 1.0 else 1.0
        elif key == keys.H:
            self.helping = not self.helping
        elif key == keys.R:
            vars(self.view).update(vars(self.first))
            self.show.exposures.clear()
        elif key in (keys.S, keys.T):
            try:
                if key == keys.S:
                    self.save(self.name("picture"))
                else:
                    self.turntable()
            except PrtnetError as error:
                self.complain(error)

    def drag(self, x: int, y: int, dx: int, dy: int) -> None:
        """The mouse moved with a button down."""
        self.interface.mouse_drag_event(x, y, dx, dy)
        if self.imgui.get_io().want_capture_mouse:
            return
        held = self.window.mouse_states
        if held.left:
            self.view.orbit(dx, dy)
        elif held.right:
            self.view.light_turn = (self.view.light_turn + 0.5 * dx) % 360.0
        elif held.middle:
            reach = self.show.metres(self.view, self.window.height)
            self.view.pan = (self.view.pan[0] - reach * dx, self.view.pan[1] + reach * dy)

    def scroll(self, across: float, up: float) -> None:
        """The wheel turned."""
        self.interface.mouse_scroll_event(across, up)
        if not self.imgui.get_io().want_capture_mouse:
            self.view.zoom(up)

    def dropped(self, _x: int, _y: int, paths: list[Any]) -> None:
        """Files fell on the window: a light or a measured material."""
        for path in map(str, paths):
            name = "brdf" if path.lower().endswith(".binary") else "light"
            before = getattr(self.view, name)
            setattr(self.view, name, path)
            try:
                (self.show.brdf if name == "brdf" else self.show.lit)(self.view)
            except PrtnetError as error:
                setattr(self.view, name, before)
                self.complain(error)

    def name(self, kind: str) -> Path:
        """A file that is not there yet."""
        while any(self.out.glob(f"{kind}_{self.saved:03d}*.png")):
            self.saved += 1
        return self.out / f"{kind}_{self.saved:03d}.png"

    def save(self, path: Path) -> None:
        """Write the picture without the panel."""
        size, context = self.window.buffer_size, self.window.ctx
        self.show.operator(self.view, wait=True)
        if {"truth", "error"} & {self.view.left, self.view.right if self.view.split < 1 else ""}:
            self.view.playing = False  # what is traced is this pose
            self.show.truth(self.view, wait=True)
        with contextlib.ExitStack() as made:
            texture = context.texture(size, 4)
            made.callback(texture.release)
            target = context.framebuffer([texture])  # our own: what covers a window is not in it
            made.callback(target.release)
            self.show.draw(self.view, size, target)
            data: Any = np.frombuffer(target.read(components=3, alignment=1), dtype=np.uint8)
        save_png(path, data.reshape(size[1], size[0], 3)[::-1])
        self.message = f"saved {path}"
        self.say(self.message)

    def turntable(self) -> None:
        """Write pictures all around."""
        start, first = self.view.azimuth, self.name("turn")
        try:
            for number in range(TURNTABLE):
                self.view.azimuth = start + 2.0 * np.pi * number / TURNTABLE
                self.save(first.with_name(f"{first.stem}_{number:02d}.png"))
        finally:
            self.view.azimuth = start

    def release(self) -> None:
        """Give everything back but the window, and the panel's library, which goes with it."""
        self.show.release()

    def close(self) -> None:
        """Give everything back."""
        self.release()
        self.window.close()
        self.window.destroy()
