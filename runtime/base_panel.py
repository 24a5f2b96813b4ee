"""The panel of any viewer: sections of sliders and lists, milliseconds, megabytes, remarks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from runtime.base_viewer import BaseViewer

__all__ = ["BasePanel"]


class BasePanel:
    """Draws the panel and changes the view as it is told.

    Args:
        viewer: whose.
    """

    viewer: BaseViewer[Any, Any, Any]

    def __init__(self, viewer: BaseViewer[Any, Any, Any]) -> None:
        from imgui_bundle import imgui

        self.imgui: Any = imgui
        self.viewer = viewer

    def sections(self) -> Sequence[tuple[str, Callable[[], None]]]:
        """What there is to change: a title, or none, and what draws it."""
        return (("look", self.look), ("light", self.light))

    def draw(self, keys: Sequence[tuple[str, str]]) -> None:
        """The panel, and the keys if there are any to explain."""
        imgui = self.imgui
        imgui.set_next_window_pos((10, 10), imgui.Cond_.first_use_ever)
        height = self.viewer.window.size[1]
        imgui.set_next_window_size_constraints((330, 0), (330, max(100, height - 20)))
        imgui.begin("prtnet", None, imgui.WindowFlags_.always_auto_resize)
        for title, section in self.sections():
            if title:
                imgui.separator_text(title)
            section()
        if imgui.collapsing_header("milliseconds", imgui.TreeNodeFlags_.default_open):
            for stage, spent in self.viewer.show.milliseconds.items():
                imgui.text(f"{stage:<14} {spent:10.3f}")
        if imgui.collapsing_header("megabytes"):
            for what, count in self.viewer.show.memory().items():
                imgui.text(f"{what:<14} {count / 1e6:10.3f}")
        self.remarks()
        imgui.end()
        if keys:
            width, height = self.viewer.window.size
            imgui.set_next_window_pos((0.5 * width, 0.5 * height), imgui.Cond_.always, (0.5, 0.5))
            imgui.begin("help", None, imgui.WindowFlags_.always_auto_resize)
            for key, what in keys:
                imgui.text(f"{key:<12} {what}")
            imgui.end()

    def look(self) -> None:
        """What is shown on either side, how bright."""
        view, modes = self.viewer.view, list(self.viewer.modes)
        view.left = self.choose("shown", view.left, modes)
        view.split = self.slider("split (C)", view.split, 0.0, 1.0, "%.2f")
        if view.split < 1.0:
            view.right = self.choose("beside", view.right, modes)
        view.exposure = self.slider("exposure", view.exposure, -4.0, 4.0, "%+.1f stops")

    def light(self) -> None:
        """Which, from where."""
        viewer, view = self.viewer, self.viewer.view
        viewer.change("light", self.choose("light", view.light, viewer.desk.lights))
        view.light_turn = self.slider("turn", view.light_turn, 0.0, 360.0, "%.0f deg")

    def remarks(self) -> None:
        """What there is to know about the picture."""
        imgui, viewer = self.imgui, self.viewer
        if viewer.show.waiting:
            imgui.text(viewer.show.waiting)
        if viewer.opens:
            imgui.text(f"opening {viewer.opens}")
        if viewer.message:
            imgui.text_wrapped(viewer.message)
        imgui.text_disabled("H: help")

    def slider(self, label: str, value: float, low: float, high: float, shown: str) -> float:
        """A number between two others."""
        always = self.imgui.SliderFlags_.always_clamp
        moved, new = self.imgui.slider_float(label, value, low, high, shown, always)
        return float(new) if moved else value

    def choose_value(self, label: str, current: Any, named: dict[Any, str]) -> Any:
        """A list of values by their names, one of them chosen."""
        named = named if current in named else {**named, current: str(current)}
        chosen = self.choose(label, named[current], list(named.values()))
        return next(value for value, name in named.items() if name == chosen)

    def choose(self, label: str, current: Any, names: Sequence[Any]) -> Any:
        """A list of names, one of them chosen; a current one that is not among them stays."""
        shown = list(names) if current in names else [*names, current]
        _, index = self.imgui.combo(label, shown.index(current), [str(name) for name in shown])
        return shown[index]
