"""The panel of a field's viewer: what it is on and how that moves, lobes, look, light."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from prtnet.limits import MOST_LOBES
from runtime.base_panel import BasePanel

if TYPE_CHECKING:
    from runtime.field_viewer import FieldViewer

__all__ = ["FieldPanel"]


class FieldPanel(BasePanel):
    """Draws the panel and changes the view as it is told."""

    viewer: FieldViewer

    def sections(self) -> Sequence[tuple[str, Callable[[], None]]]:
        """Surface, look, light."""
        return (("", self.surface), *super().sections())

    def surface(self) -> None:
        """What the field is on, where in its clip, how it is twisted."""
        imgui, viewer, view = self.imgui, self.viewer, self.viewer.view
        worn = viewer.show.cast.worn
        if viewer.show.cast.patch:
            chosen = self.choose("on", worn.name, viewer.desk.built_in)
            if chosen != worn.name:
                viewer.opened()
                viewer.reopen(viewer.desk.field, chosen, chosen)
                return
        if worn.scene is not None:
            names = [clip.name for clip in worn.scene.clips]
            chosen = self.choose("clip", view.clip, names)
            if chosen != view.clip:
                view.clip, view.time = chosen, worn.scene.clip(chosen).start
            clip = worn.scene.clip(view.clip)
            always = imgui.SliderFlags_.always_clamp
            moved, new = imgui.slider_float(
                "time", view.time, clip.start, clip.end, "%.2f s", always
            )
            view.time = new if moved else view.time  # imgui rounds what it shows to 32 bits
            view.playing = view.playing and not moved
        _, view.playing = imgui.checkbox("play (Space)", view.playing)
        view.twist = self.slider("twist", view.twist, -360.0, 360.0, "%.0f deg")

    def look(self) -> None:
        """What is shown on either side, of how many lobes, how."""
        super().look()
        viewer, view = self.viewer, self.viewer.view
        if viewer.show.cast.lobes is None:
            always = self.imgui.SliderFlags_.always_clamp
            _, view.count = self.imgui.slider_int("lobes", view.count, 1, MOST_LOBES, "%d", always)
        _, view.by_table = self.imgui.checkbox("table of the light", view.by_table)

    def remarks(self) -> None:
        """What there is to know about the picture."""
        view = self.viewer.view
        if view.playing and "truth" in view.modes:
            self.imgui.text("stop (Space) to trace the truth")
        super().remarks()
