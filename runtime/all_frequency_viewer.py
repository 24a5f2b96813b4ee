"""The window of ``prtnet view FILE`` of an object with all-frequency transfer."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import ClassVar

from prtnet.all_frequency import AllFrequencyField
from runtime.all_frequency_sight import MODES, AllFrequencySight, AllFrequencyView
from runtime.base_panel import BasePanel
from runtime.base_viewer import CAMERA_KEYS, COMMON_KEYS, LIGHTS, BaseDesk, BaseViewer, Steps

__all__ = ["AllFrequencyDesk", "AllFrequencyViewer"]


@dataclass
class AllFrequencyDesk(BaseDesk):
    """What is at a viewer's hand.

    Attributes:
        open_file: a file, made into the fields it holds.
    """

    open_file: Callable[[Path], Sequence[AllFrequencyField]]


class AllFrequencyPanel(BasePanel):
    """Draws the panel and changes the view as it is told."""

    viewer: AllFrequencyViewer

    def look(self) -> None:
        """What is shown, and beside the object."""
        super().look()
        viewer = self.viewer
        if "some" in viewer.view.modes:
            most = 6 * viewer.show.fields[0].size ** 2
            always = self.imgui.SliderFlags_.always_clamp
            _, viewer.view.keep = self.imgui.slider_int(
                "wavelets", viewer.view.keep, 1, most, "%d", always
            )
        if len(viewer.show.fields) > 1:
            _, viewer.view.ground = self.imgui.checkbox("ground", viewer.view.ground)

    def light(self) -> None:
        """Which, from where, and how fast it turns."""
        super().light()
        view = self.viewer.view
        view.turning = self.slider("turning", view.turning, -180.0, 180.0, "%.0f deg/s")
        _, view.playing = self.imgui.checkbox("turn (Space)", view.playing)


class AllFrequencyViewer(BaseViewer[AllFrequencySight, AllFrequencyView, AllFrequencyDesk]):
    """A window and the object it shows; see ``BaseViewer``."""

    modes = MODES
    help = (
        *CAMERA_KEYS,
        ("Space", "let the light turn, or stand"),
        ("Left, Right", "turn it a little"),
        ("1 to 3", "all of the light, some of its wavelets, or what is low in frequency of it"),
        ("drop", "fields, lights"),
        *COMMON_KEYS,
    )
    kinds: ClassVar[Mapping[str, str]] = {".safetensors": "field", **LIGHTS}

    def made_panel(self) -> AllFrequencyPanel:
        """Look, light."""
        return AllFrequencyPanel(self)

    def take_files(self, found: Mapping[str, Path]) -> None:
        """Show another object, as this one is shown, if it can be."""
        path = found["field"]

        def take(fields: Sequence[AllFrequencyField]) -> Steps[str]:
            context, lights, size = self.window.ctx, self.show.environments, path.stat().st_size
            yield from self.replace(
                lambda: AllFrequencySight(context, fields, lights, size),
                lambda: dataclasses.replace(self.view, pan=(0.0, 0.0)),
            )
            return path.name

        self.open(path.name, partial(self.desk.open_file, path), take)
