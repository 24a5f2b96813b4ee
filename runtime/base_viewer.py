"""The window of ``prtnet view``: a :class:`runtime.sight.Sight` with mouse, keys and a panel.

What is the same whatever is shown: ``runtime.viewer`` shows characters with it, and
``runtime.field_viewer`` fields. Needs the extra ``viewer`` (moderngl-window, imgui-bundle).
"""

from __future__ import annotations

import contextlib
import dataclasses
import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError
from runtime import recording
from runtime.background import Background
from runtime.memory import hand_back
from runtime.outlook import Outlook
from runtime.sight import Sight

__all__ = [
    "CAMERA_KEYS",
    "COMMON_KEYS",
    "LIGHTS",
    "PLAY_KEYS",
    "BaseDesk",
    "BaseViewer",
    "Steps",
    "in_window",
    "open_window",
]

T = TypeVar("T")
Steps = Generator[None, None, T]
"""Work that is done in frames, as far as the next ``yield`` in each, and what comes of it."""
S = TypeVar("S", bound=Sight[Any])
V = TypeVar("V", bound=Outlook)
D = TypeVar("D", bound="BaseDesk")
CHANGED = ("light", "brdf")  # of a view, by a file alone
LIGHTS = {".hdr": "light", ".pic": "light", ".rgbe": "light", ".exr": "light"}

CAMERA_KEYS = (
    ("drag", "walk around"),
    ("right drag", "turn the light"),
    ("middle drag", "move the picture"),
    ("wheel", "come closer"),
)
PLAY_KEYS = (
    ("Space", "play or pause"),
    ("Left, Right", "step a frame"),
)
COMMON_KEYS = (
    ("C", "compare: split the picture"),
    ("S", "save a picture"),
    ("T, M", "save a turntable: pictures, a movie"),
    ("P", "save a movie of what moves"),
    ("R", "back to the first view"),
    ("H", "this help"),
    ("Esc", "stop saving; leave"),
)
FRAME = 1.0 / 30.0  # seconds of a step of the arrow keys


@dataclass
class BaseDesk:
    """What is at a viewer's hand.

    Attributes:
        lights: names to choose from.
        out: folder of saved pictures.
        say: is told what was saved.
    """

    lights: list[str]
    out: Path
    say: Callable[[str], None]


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


def in_window(title: str, size: tuple[int, int], visible: bool, made: Callable[[Any], T]) -> T:
    """What is made in a window of its own, which is closed where it cannot be made.

    Raises:
        PrtnetError: no window can be opened; see :func:`open_window`.
    """
    window = open_window(title, size, visible)
    try:
        return made(window)
    except BaseException:
        window.close()
        window.destroy()
        raise


class BaseViewer(ABC, Generic[S, V, D]):
    """A window and what it shows.

    Args:
        window: from :func:`open_window`.
        show: what is drawn, on the window's context.
        view: where it starts.
        desk: what else there is to choose from.

    Attributes:
        modes: what the keys 1, 2, … show.
        help: keys, and what they do.
        opens: the name of the file that is being opened.
        trial: what is shown has not been drawn yet; if it cannot be, what was there comes back.
        replacing: what was shown before has not been given back yet.
        leaving: what is still being made of what is shown no more; nobody waits for it until the
            window is closed.
        kinds: of files that may fall on the window, by their suffix: one of ``CHANGED``, or what
            ``take_files`` takes.
    """

    modes: ClassVar[Sequence[str]]
    help: ClassVar[Sequence[tuple[str, str]]]
    kinds: ClassVar[Mapping[str, str]]

    def __init__(self, window: Any, show: S, view: V, desk: D) -> None:
        from imgui_bundle import imgui
        from moderngl_window.integrations.imgui_bundle import ModernglWindowRenderer

        self.window, self.show, self.view, self.desk = window, show, view, desk
        self.helping = False
        self.mouse: tuple[int, int] | None = None
        self.saving: Iterator[str] | None = None
        self.opening: Background[Any] = Background()
        self.opens = ""
        self.trial = self.replacing = False
        self.leaving: list[Background[Any]] = []
        self.finish: Steps[None] | None = None  # to open what is being opened
        view.playing = True
        self.good = dataclasses.replace(view)
        self.message = ""
        self.first = dataclasses.replace(view)
        imgui.create_context()
        imgui.get_io().set_ini_filename("")
        self.imgui = imgui
        self.interface = ModernglWindowRenderer(window)
        self.panel = self.made_panel()
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

    @abstractmethod
    def made_panel(self) -> Any:
        """A ``runtime.base_panel.BasePanel`` of this."""

    @abstractmethod
    def take_files(self, found: Mapping[str, Path]) -> None:
        """Begin to ``open`` what fell on the window, by its kind."""

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
        self.leaving = [task for task in self.leaving if task.busy]
        ready = min(self.window.buffer_size) and not (self.opening.busy or self.trial)
        if ready and (self.saving is None or self.replacing):  # a movie takes long
            self.open_on()
        if self.saving is not None:
            self.save_on()
        elif self.view.playing:
            self.show.advance(self.view, elapsed)
        self.render(0.0, elapsed)
        self.window.swap_buffers()  # also hands the window's events out

    def render(self, _time: float, _elapsed: float) -> None:
        """Draw the picture and the panel over it."""
        self.picture()
        self.imgui.new_frame()
        self.panel.draw(self.help if self.helping else ())
        self.imgui.render()
        self.interface.render(self.imgui.get_draw_data())

    def picture(self) -> None:
        """Draw without the panel; a view that cannot be drawn is told, and taken back."""
        size, target = self.window.buffer_size, self.window.fbo
        if not min(size):  # minimised
            return
        try:
            self.show.draw(self.view, size, target)
            if self.saving is None:
                self.drawn(size)
        except Exception as error:  # whatever background work ended in, too
            if self.trial:
                assert self.finish is not None
                self.finish.throw(error)
                self.picture()
                return
            if vars(self.view) == vars(self.good):
                raise
            self.complain(error)
            vars(self.view).update(vars(self.good))
            self.show.draw(self.view, size, target)
        self.trial = False
        # What is still being made may fail yet, or has since it was asked for.
        if not self.show.waiting and not self.show.failing:
            self.good = dataclasses.replace(self.view)

    def complain(self, error: Exception) -> None:
        """Tell in the panel what went wrong."""
        known = isinstance(error, PrtnetError)
        self.message = f"{error.subject}: {error.message}" if known else f"{error!r}"  # type: ignore[attr-defined]

    def drawn(self, size: tuple[int, int]) -> None:
        """A picture of this size is there."""

    def change(self, name: str, value: Any) -> None:
        """Change the light or the material, unless that cannot be drawn: then say why."""
        before = getattr(self.view, name)
        if value == before:
            return
        setattr(self.view, name, value)
        try:
            self.show.check(self.view, name)
            self.message = ""
        except PrtnetError as error:
            setattr(self.view, name, before)
            self.complain(error)

    def replace(self, make: Callable[[], S], adapted: Callable[[], V]) -> Steps[None]:
        """Show something else, if it can be drawn: made, drawn, and what was there given back.

        Each in a frame of its own, since each may take longer than all that is in one otherwise.

        Args:
            make: what is to be shown.
            adapted: the view, as it is then, of that.

        Raises:
            Exception: it cannot; what is there stays.
        """
        show = make()
        try:
            yield
            self.stop_saving()
            new = adapted()
        except BaseException:
            show.release()
            raise
        gone, view, good, first = self.show, dataclasses.replace(self.view), self.good, self.first
        self.show, self.trial, self.replacing = show, True, True
        vars(self.view).update(vars(new))
        self.good, self.first = new, dataclasses.replace(new)
        try:
            yield
        except Exception:  # of drawing it
            gone, self.show = show, gone
            vars(self.view).update(vars(view))
            self.good, self.first = good, first
            raise
        finally:
            self.trial = self.replacing = False
            self.leaving += gone.leave()

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
            number = numbers.index(key)
            if number < len(self.modes):
                self.view.left = self.modes[number]
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
            self.show.advance(self.view, FRAME if key == keys.RIGHT else -FRAME)
        elif key == keys.C:
            self.view.split = 0.5 if self.view.split == 1.0 else 1.0
        elif key == keys.H:
            self.helping = not self.helping
        elif key == keys.R:
            vars(self.view).update(vars(self.first))
            self.show.exposures.clear()
        else:
            self.pressed(key)

    def pressed(self, key: Any) -> None:
        """A key that means nothing here went down."""

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
        """Files fell on the window: lights, and what else can be shown."""
        self.message = ""
        found: dict[str, Path] = {}
        named = {path: self.kinds.get(path.suffix.lower()) for path in map(Path, paths)}
        if set(named.values()) - {*CHANGED, None}:
            self.opened()
        for path, kind in named.items():
            if kind is None:
                known = ", ".join(self.kinds)
                self.complain(PrtnetError(path, f"is none of what can be shown here: {known}"))
            elif kind in CHANGED:
                self.change(kind, str(path))
            else:
                found[kind] = path
        if found:
            self.take_files(found)

    def open(
        self,
        name: str,
        make: Callable[[], T],
        take: Callable[[T], Steps[str]],
        fail: Callable[[Exception], None] | None = None,
    ) -> None:
        """Open a file beside the frames; what is there is shown until then.

        Args:
            name: of the file.
            make: what is to be shown of it.
            take: shows that, a step between two frames each, and says what is shown.
            fail: is told why it cannot be shown; tells it in the panel if it is not given.
        """
        self.opened()
        self.opens = name
        self.opening.begin(make, make)

        def finish() -> Steps[None]:
            self.stop_saving()
            try:
                made = self.opening.get(make, make, wait=True)
                assert made is not None
                self.message = yield from take(made)
            except Exception as error:
                (fail or self.complain)(error)
            self.opens = ""
            self.opening.release()  # it is held by who shows it
            yield
            hand_back()

        self.finish = finish()

    def open_on(self) -> None:
        """One more step of showing what is being opened, if anything is."""
        if self.finish is not None:
            self.window.use()
            try:
                next(self.finish)
            except StopIteration:
                self.finish = None

    def opened(self) -> None:
        """Show what is being opened, if anything is; it is waited for.

        In a window that is minimised it waits until it can be drawn.
        """
        while self.finish is not None:
            if self.trial:
                self.picture()
            if self.trial:
                return
            self.open_on()

    def save(self, recorder: Callable[[Any], Iterator[str]]) -> None:
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
        if self.finish is not None:
            self.finish.close()
            self.finish = None
        for task in (self.opening, *self.leaving):
            task.release()
        self.show.release()

    def close(self) -> None:
        """Give everything back."""
        self.release()
        self.window.close()
        self.window.destroy()
