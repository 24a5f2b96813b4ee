"""The window of ``prtnet view MODEL SCENE``: a :class:`runtime.show.Show` of a character."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from runtime.base_viewer import (
    CAMERA_KEYS,
    COMMON_KEYS,
    LIGHTS,
    PLAY_KEYS,
    BaseDesk,
    BaseViewer,
    Steps,
)
from runtime.cast import Cast
from runtime.dropped import recast
from runtime.show import Show
from runtime.view import MODES, View
from runtime.viewer_panel import Panel

__all__ = ["Desk", "Viewer"]


@dataclass
class Desk(BaseDesk):
    """What is at a viewer's hand.

    Attributes:
        brdfs: names to choose from.
        open_files: a model's and a scene's file, made into what can be shown.
        model: the file of what is shown.
        scene: likewise.
    """

    brdfs: list[str]
    open_files: Callable[[Path, Path], Cast]
    model: Path
    scene: Path


class Viewer(BaseViewer[Show, View, Desk]):
    """A window and the character it shows; see ``BaseViewer``."""

    modes = MODES
    help = (
        *CAMERA_KEYS,
        ("mouse", "a vertex's visibility on a sphere"),
        ("V", "keep showing that vertex"),
        *PLAY_KEYS,
        ("1 to 6", "prediction, truth, visibility, open, ambient, error"),
        ("drop", "models, scenes, lights, MERL materials"),
        *COMMON_KEYS,
    )
    kinds: ClassVar[Mapping[str, str]] = {
        ".safetensors": "model",
        ".glb": "scene",
        ".gltf": "scene",
        ".npz": "scene",
        ".binary": "brdf",
        **LIGHTS,
    }

    def __init__(self, window: Any, show: Show, view: View, desk: Desk) -> None:
        self.following = True  # the mouse, with the vertex whose visibility is shown
        self.waiting_files: Mapping[str, Path] = {}
        super().__init__(window, show, view, desk)

    def release(self) -> None:
        """Give everything back but the window; what is being made is waited for."""
        super().release()
        self.show.studio.release()

    def made_panel(self) -> Panel:
        """Clips, look, light, material."""
        return Panel(self)

    def drawn(self, size: tuple[int, int]) -> None:
        """The vertex under the mouse is the one whose visibility the next picture shows."""
        if self.following:
            self.view.vertex = self.pointed_at(size)

    def pointed_at(self, size: tuple[int, int]) -> tuple[int, bool] | None:
        """The vertex under the mouse, and whether it is its back."""
        if self.mouse is None or self.imgui.get_io().want_capture_mouse:
            return None
        ratio = self.window.pixel_ratio
        place = (self.mouse[0] + 0.5) * ratio, (self.mouse[1] + 0.5) * ratio
        return self.show.pick(self.view, size, place)

    def pressed(self, key: Any) -> None:
        """``V`` keeps a vertex."""
        if key == self.window.keys.V:
            self.following = not self.following

    def take_files(self, found: Mapping[str, Path]) -> None:
        """Show another model, scene, or both."""
        recast(self, found)

    def take(self, cast: Cast) -> Steps[None]:
        """Show another character, as this one is shown, if it can be.

        Raises:
            Exception: it cannot be drawn; this one stays.
        """

        def adapted() -> View:
            view = dataclasses.replace(self.view)
            names = [clip.name for clip in cast.actor.scene.clips]
            if view.clip not in names:
                view.clip = names[0]
            clip = cast.actor.scene.clip(view.clip)
            view.time = min(max(view.time, clip.start), clip.end)
            view.blend_clip, view.blend, view.pan, view.vertex = "", 0.0, (0.0, 0.0), None
            view.order = view.order if view.order < cast.actor.model.order else 0
            return view

        yield from self.replace(lambda: Show(self.window.ctx, cast, self.show.studio), adapted)
