"""The window of ``prtnet view``: a :class:`runtime.show.Show` with mouse, keys and a panel.

Needs the extra ``viewer`` (moderngl-window, imgui-bundle).
"""

from __future__ import annotations

import contextlib
import time as clock
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from runtime import recording
from runtime.cast import Cast
from runtime.dropped import take_files
from runtime.show import Show
from runtime.view import MODES, View

__all__ = ["Desk", "Viewer", "open_window"]

HELP = (
    ("drag", "walk around"),
    ("right drag", "turn the light"),
    ("middle drag", "move the picture"),
    ("wheel", "come closer"),
    ("mouse", "a vertex's visibility on a sphere"),
    ("V", "keep showing that vertex"),
    ("Space", "play or pause"),
    ("Left, Right", "step a frame"),
    ("1 to 6", "prediction, truth, visibility, open, ambient, error"),
    ("C", "compare: split the picture"),
    ("S", "save a picture"),
    ("T, M", "save a turntable: pictures, a movie"),
    ("P", "save a movie of the clip"),
    ("R", "back to the first view"),
    ("drop", "models, scenes, lights, MERL materials"),
    ("H", "this help"),
    ("Esc", "stop saving; leave"),
)
FRAME = 1.0 / 30.0  # seconds of a step of the arrow keys


@dataclass
class Desk:
    """What is at a viewer's hand.

    Attributes:
        lights: names to choose from.
        brdfs: likewise.
        out: folder of saved pictures.
        say: is told what was saved.
        open_files: a model's and a scene's file, made into what can be shown.
        model: the file of what is shown.
        scene: likewise.
    """

    lights: list[str]
    brdfs: list[str]
    out: Path
    say: Callable[[str], None]
    open_files: Callable[[Path, Path], Cast]
    model: Path
    scene: Path


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
            "prtnet view", f"cannot open a window with OpenGL ({reason}); use prtnet render, which "
            "needs neither, or give it a display (xvfb-run)"
        ) from error  # fmt: skip


class Viewer:
    """A window and what it shows.

    Args:
        window: from :func:`open_window`.
        show: what is drawn, on the window's context.
        view: where it starts.
        desk: what else there is to choose from.
    """

    def __init__(self, window: Any, show: Show, view: View, desk: Desk) -> None:
        from imgui_bundle import imgui
        from moderngl_window.integrations.imgui_bundle import ModernglWindowRenderer

        from runtime.viewer_panel import Panel

        self.window, self.show, self.view, self.desk = window, show, view, desk
        self.helping = False
        self.following = True  # the mouse, with the vertex whose visibility is shown
        self.mouse: tuple[int, int] | None = None
        self.saving: Iterator[str] | None = None
        self.waiting_files: dict[str, Path] = {}
        view.playing = True
        self.good = View(**vars(view))
        self.message = ""
        self.first = View(**vars(view))
        imgui.create_context()
        imgui.get_io().set_ini_filename("")
        self.imgui = imgui
        self.interface = ModernglWindowRenderer(window)
        self.panel = Panel(self)
        window.exit_key = None  # Esc has more to do than to close
        window.render_func = self.render
        window.resize_func = self.interface.resize
        window.key_event_func = self.key
        window.mouse_position_event_func = self.moved
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
        if self.saving is not None:
            self.save_on()
        elif self.view.playing:
            self.view.advance(self.show.actor, elapsed)
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
        if not min(size):  # minimised
            return
        try:
            self.show.draw(self.view, size, target)
            if self.following and self.saving is None:
                self.view.vertex = self.pointed_at(size)
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

    def pointed_at(self, size: tuple[int, int]) -> tuple[int, bool] | None:
        """The vertex under the mouse, and whether it is its back."""
        if self.mouse is None or self.imgui.get_io().want_capture_mouse:
            return None
        ratio = self.window.pixel_ratio
        place = (self.mouse[0] + 0.5) * ratio, (self.mouse[1] + 0.5) * ratio
        return self.show.pick(self.view, size, place)

    def change(self, name: str, value: Any) -> None:
        """Change the light or the material, unless that cannot be drawn: then say why."""
        before = getattr(self.view, name)
        if value == before:
            return
        setattr(self.view, name, value)
        try:
            if name == "light":
                self.show.lit(self.view)
            else:
                self.show.brdf(self.view)
            self.message = ""
        except PrtnetError as error:
            setattr(self.view, name, before)
            self.complain(error)

    def take(self, cast: Cast) -> None:
        """Show another character, as this one is shown, if it can be.

        Raises:
            Exception: it cannot be drawn; this one stays.
        """
        view = View(**vars(self.view))
        names = [clip.name for clip in cast.actor.scene.clips]
        if view.clip not in names:
            view.clip = names[0]
        clip = cast.actor.scene.clip(view.clip)
        view.time = min(max(view.time, clip.start), clip.end)
        view.blend_clip, view.blend, view.pan, view.vertex = "", 0.0, (0.0, 0.0), None
        view.order = view.order if view.order < cast.actor.model.order else 0
        self.window.use()
        show = Show(self.window.ctx, cast, self.show.environments)
        try:
            show.draw(view, self.window.buffer_size, self.window.fbo)
        except BaseException:
            show.release()
            raise
        self.stop_saving()
        self.show.release()
        self.show = show
        vars(self.view).update(vars(view))
        self.good, self.first = View(**vars(view)), View(**vars(view))

    def key(self, key: Any, action: Any, modifiers: Any) -> None:
        """A key went down or up."""
        keys = self.window.keys
        self.interface.key_event(key, action, modifiers)
        if action != keys.ACTION_PRESS or self.imgui.get_io().want_text_input:
            return
        numbers = (
            keys.NUMBER_1, keys.NUMBER_2, keys.NUMBER_3, keys.NUMBER_4, keys.NUMBER_5,
            keys.NUMBER_6,
        )  # fmt: skip
        savings = {
            keys.S: recording.picture, keys.T: recording.turntable,
            keys.M: recording.turntable_movie, keys.P: recording.clip_movie,
        }  # fmt: skip
        if key in numbers:
            self.view.left = MODES[numbers.index(key)]
        elif key in savings:
            self.save(savings[key])
        elif key == keys.ESCAPE:
            if self.saving is None:
                self.window.close()
            self.stop_saving()
        elif key == keys.SPACE:
            self.view.playing = not self.view.playing
        elif key in (keys.LEFT, keys.RIGHT):
            self.view.playing = False
            self.view.advance(self.show.actor, FRAME if key == keys.RIGHT else -FRAME)
        elif key == keys.C:
            self.view.split = 0.5 if self.view.split == 1.0 else 1.0
        elif key == keys.V:
            self.following = not self.following
        elif key == keys.H:
            self.helping = not self.helping
        elif key == keys.R:
            vars(self.view).update(vars(self.first))
            self.show.exposures.clear()

    def moved(self, x: int, y: int, dx: int, dy: int) -> None:
        """The mouse moved."""
        self.interface.mouse_position_event(x, y, dx, dy)
        self.mouse = x, y

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
        """Files fell on the window."""
        take_files(self, paths)

    def save(self, recorder: Callable[[Viewer], Iterator[str]]) -> None:
        """Begin to save something, a picture a step; ``runtime.recording`` has what there is."""
        self.stop_saving()
        self.view.playing = False  # what is traced is this pose
        self.saving = recorder(self)

    def save_on(self) -> None:
        """One more picture of what is being saved."""
        assert self.saving is not None
        try:
            self.message = next(self.saving)
        except StopIteration:
            self.saving = None
            self.desk.say(self.message)
        except Exception as error:
            self.saving = None
            self.complain(error)

    def stop_saving(self) -> None:
        """Leave what is being saved; a movie that is not whole does not stay."""
        if self.saving is not None:
            self.saving.close()  # type: ignore[attr-defined]
            self.saving, self.message = None, "stopped"

    def pixels(self) -> FloatArray:
        """The picture without the panel, (H, W, 3) uint8 sRGB, once all of it is known."""
        size, context = self.window.buffer_size, self.window.ctx
        self.show.settle(self.view)
        with contextlib.ExitStack() as made:
            texture = context.texture(size, 4)
            made.callback(texture.release)
            target = context.framebuffer([texture])  # our own: what covers a window is not in it
            made.callback(target.release)
            self.show.draw(self.view, size, target)
            data: Any = np.frombuffer(target.read(components=3, alignment=1), dtype=np.uint8)
        return np.ascontiguousarray(data.reshape(size[1], size[0], 3)[::-1])

    def release(self) -> None:
        """Give everything back but the window, and the panel's library, which goes with it."""
        self.stop_saving()
        self.show.release()

    def close(self) -> None:
        """Give everything back."""
        self.release()
        self.window.close()
        self.window.destroy()
