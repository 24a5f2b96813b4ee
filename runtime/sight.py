"""What any viewer shows, without a window: two sides of a split under one light, exposed.

A :class:`Sight` turns an :class:`runtime.outlook.Outlook` into a picture on any OpenGL context.
Windows and command lines only change the outlook. What is drawn on a side is its subclasses'.
"""

from __future__ import annotations

import time as clock
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any, ClassVar, Generic, TypeVar

import moderngl
import numpy as np

from prtnet.environment import Environment
from runtime.background import Background
from runtime.camera import Camera
from runtime.memory import gpu_bytes, resident_bytes
from runtime.outlook import Outlook
from runtime.overlay import Overlay
from runtime.picture import auto_exposure
from runtime.screen import Screen

__all__ = ["Sight"]

V = TypeVar("V", bound=Outlook)


class Sight(ABC, Generic[V]):
    """Draws a view of something.

    Args:
        context: OpenGL that everything lives in; it must be current at every call.
        environments: lights by name.

    Attributes:
        milliseconds: of the stages of the last frame, by name.
        exposures: by light, each chosen by the first picture under it.
        framing: sees everything; made when it is first wanted.
        unlit: what is shown at an exposure of its own, whatever the light.
    """

    unlit: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self, context: moderngl.Context, environments: Callable[[str], Environment]
    ) -> None:
        self.context, self.environments = context, environments
        self.milliseconds: dict[str, float] = {}
        self.exposures: dict[str, float] = {}
        self.framing: Camera | None = None
        self._made: list[Any] = []
        try:
            self.screen = self.keep(Screen(context))
            self.overlay = self.keep(Overlay(context))
        except BaseException:
            self.release()
            raise

    @property
    def tasks(self) -> Mapping[str, Background[Any]]:
        """What may be made in the background, by words for it."""
        return {}

    @property
    def lasting(self) -> Collection[Background[Any]]:
        """Those of the tasks that outlive this."""
        return ()

    @abstractmethod
    def framed(self, view: V) -> Camera:
        """Sees everything that a view may come to show."""

    @abstractmethod
    def draw_side(
        self, mode: str, view: V, camera: Camera, size: tuple[int, int], frame: Any, exposure: float
    ) -> None:
        """One side of the split, linear colour; nothing where it is not known yet."""

    @abstractmethod
    def settle(self, view: V) -> None:
        """Wait for everything that a view needs; nothing of it is then missing or old."""

    @abstractmethod
    def check(self, view: V, name: str) -> None:
        """Find out whether what a view names can be shown: its light, its material.

        Raises:
            PrtnetError: it cannot.
        """

    @abstractmethod
    def advance(self, view: V, seconds: float) -> None:
        """Go on, and around."""

    @abstractmethod
    def through(self, view: V, fps: int) -> Iterator[tuple[int, int]]:
        """Move the view through all that moves, so many pictures a second: number, and of how many.

        It is then where it was.
        """

    def drawable(self, view: V) -> V:
        """The view with what can be drawn at once in place of what is still being made."""
        return view

    def parts(self) -> dict[str, int | None]:
        """Bytes of what is shown, by what takes them."""
        return {}

    def lay_over(self, view: V, size: tuple[int, int], target: Any) -> None:
        """Draw what lies over the picture, in sRGB."""

    def keep(self, made: Any) -> Any:
        """Something to be given back in the end."""
        self._made.append(made)
        return made

    @property
    def waiting(self) -> str:
        """What is being made in the background, in words; empty where nothing is."""
        return ", ".join(what for what, task in self.tasks.items() if task.busy)

    @property
    def failing(self) -> bool:
        """Whether something that was made ended in an error that the next picture will meet."""
        return any(task.unheard for task in self.tasks.values())

    def release(self) -> None:
        """Give everything back but the context; what is being made is waited for."""
        for task in self.leave():
            task.release()

    def leave(self) -> list[Background[Any]]:
        """Give everything back but the context, and tell what is being made, without waiting."""
        for held in self._made:
            held.release()
        self._made = []
        own = [task for task in self.tasks.values() if task not in self.lasting]
        return [task for task in own if task.busy and not task.cancelled()]

    def memory(self) -> dict[str, int]:
        """Bytes by what takes them: files, parts of the GPU's memory, the process."""
        found = self.parts()
        found["GPU picture"] = gpu_bytes(self.screen.resources)
        found["process"] = resident_bytes()
        return {name: count for name, count in found.items() if count}

    def camera(self, view: V) -> Camera:
        """Where a view is from: what frames everything, walked around."""
        if self.framing is None:
            self.framing = self.framed(view)
        return view.camera(self.framing)

    def draw(self, view: V, size: tuple[int, int], target: Any) -> None:
        """Draw a view into a framebuffer of this size."""
        started = clock.perf_counter()
        self.milliseconds = {}
        failed = [task for task in self.tasks.values() if task.unheard]
        view = self.drawable(view)
        camera = self.camera(view)
        frame = self.screen.clear(size)
        split = round(min(max(view.split, 0.0), 1.0) * size[0])
        exposure = self.exposures.get(view.light, 1.0) * 2.0**view.exposure
        for mode, left, width in (
            (view.left, 0, split),
            (view.right, split, size[0] - split),
        ):
            if width > 0:
                frame.scissor = (left, 0, width, size[1])
                self.draw_side(mode, view, camera, size, frame, exposure)
        frame.scissor = None
        if view.light not in self.exposures and self._expose(view, split):
            if {view.left, view.right} & set(self.unlit):  # drawn at an exposure of its own
                self.draw(view, size, target)
                return
            exposure = self.exposures[view.light] * 2.0**view.exposure
        for task in failed:
            if task.unheard:  # nobody has asked for it any more
                task.release()
        self.screen.present(target, exposure)
        self.lay_over(view, size, target)
        self.milliseconds["frame"] = 1e3 * (clock.perf_counter() - started)

    def _expose(self, view: V, split: int) -> bool:
        """Choose the exposure under this light by what has been drawn, if anything lit has been."""
        for mode, columns in ((view.left, slice(split)), (view.right, slice(split, None))):
            drawn = self.screen.linear()[:, columns]
            if mode not in self.unlit and drawn[..., 3].any():  # not while the truth is traced
                self.exposures[view.light] = auto_exposure(drawn)
                return True
        return False

    def count(self, **spent: float) -> None:
        """Milliseconds of stages: those of both sides of a split are summed."""
        for stage, ms in spent.items():
            self.milliseconds[stage] = self.milliseconds.get(stage, 0.0) + ms

    def metres(self, view: V, height: int) -> float:
        """What a pixel of a picture of this height is wide at the target."""
        camera = self.camera(view)
        reach = np.linalg.norm(np.asarray(camera.eye) - np.asarray(camera.target))
        return float(2.0 * np.tan(camera.fov / 2.0) * reach / max(height, 1))
