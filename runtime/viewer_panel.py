"""The viewer's panel: clip, look, light, material, milliseconds."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from prtnet.errors import PrtnetError
from prtnet.merl import Measured
from runtime.show import MODES

if TYPE_CHECKING:
    from runtime.viewer import Viewer

__all__ = ["Panel"]

RANGES = {"exponent": (1.0, 200.0), "along": (1.0, 200.0), "across": (1.0, 200.0)}
"""Of parameters that are not between 0 and 1."""


class Panel:
    """Draws the panel and changes the view as it is told.

    Args:
        viewer: whose.
        lights, brdfs: names to choose from.
    """

    def __init__(self, viewer: Viewer, lights: list[str], brdfs: list[str]) -> None:
        from imgui_bundle import imgui

        self.imgui: Any = imgui
        self.viewer, self.lights, self.brdfs = viewer, lights, brdfs

    def draw(self, keys: Sequence[tuple[str, str]]) -> None:
        """The panel, and the keys if there are any to explain."""
        imgui, viewer, view = self.imgui, self.viewer, self.viewer.view
        imgui.set_next_window_pos((10, 10), imgui.Cond_.first_use_ever)
        imgui.set_next_window_size((330, 0), imgui.Cond_.first_use_ever)
        imgui.begin("prtnet")
        clips = [clip.name for clip in viewer.show.actor.scene.clips]
        chosen = self.choose("clip", view.clip, clips)
        if chosen != view.clip:
            view.clip, view.time = chosen, viewer.show.actor.scene.clip(chosen).start
        clip = viewer.show.actor.scene.clip(view.clip)
        always = imgui.SliderFlags_.always_clamp  # typed numbers, too
        moved, view.time = imgui.slider_float(
            "time", view.time, clip.start, clip.end, "%.2f s", always
        )
        view.playing = view.playing and not moved
        _, view.playing = imgui.checkbox("play (Space)", view.playing)
        imgui.separator_text("look")
        view.left = self.choose("shown", view.left, list(MODES))
        _, view.split = imgui.slider_float("split (C)", view.split, 0.0, 1.0, "%.2f", always)
        if view.split < 1.0:
            view.right = self.choose("beside", view.right, list(MODES))
        _, view.exposure = imgui.slider_float(
            "exposure", view.exposure, -4.0, 4.0, "%+.1f stops", always
        )
        imgui.separator_text("light")
        self.set_checked("light", self.choose("light", view.light, self.lights))
        _, view.light_turn = imgui.slider_float(
            "turn", view.light_turn, 0.0, 360.0, "%.0f deg", always
        )
        _, view.lobes = imgui.slider_int(
            "lobes", view.lobes, 0, 6, "%d" if view.lobes else "exact", always
        )
        imgui.separator_text("material")
        name = view.brdf.partition(":")[0]
        chosen = self.choose("BRDF", name, self.brdfs)
        if chosen != name:
            self.set_checked("brdf", chosen)
        self.parameters()
        _, view.factors = imgui.slider_int("factors", view.factors, 1, 16, "%d", always)
        imgui.separator_text("milliseconds")
        for stage, spent in viewer.show.milliseconds.items():
            imgui.text(f"{stage:<8} {spent:8.3f}")
        sides = (view.left, view.right if view.split < 1.0 else view.left)
        if "error" in sides and viewer.show.error_top > 0.0:
            imgui.text(f"yellow: {viewer.show.error_top:.3g} % of an open vertex")
        if view.playing and {"truth", "error"} & set(sides):
            imgui.text("stop (Space) to trace the truth")
        if viewer.show.waiting:
            imgui.text(viewer.show.waiting)
        if viewer.message:
            imgui.text_wrapped(viewer.message)
        imgui.text_disabled("H: help")
        imgui.end()
        if keys:
            width, height = viewer.window.size
            imgui.set_next_window_pos((0.5 * width, 0.5 * height), imgui.Cond_.always, (0.5, 0.5))
            imgui.begin("help", None, imgui.WindowFlags_.always_auto_resize)
            for key, what in keys:
                imgui.text(f"{key:<12} {what}")
            imgui.end()

    def choose(self, label: str, current: Any, names: Sequence[Any]) -> Any:
        """A list of names, one of them chosen; a current one that is not among them stays."""
        shown = list(names) if current in names else [*names, current]
        _, index = self.imgui.combo(label, shown.index(current), [str(name) for name in shown])
        return shown[index]

    def set_checked(self, name: str, value: Any) -> None:
        """Change the view, unless that cannot be drawn: then say why."""
        viewer = self.viewer
        before = getattr(viewer.view, name)
        if value == before:
            return
        setattr(viewer.view, name, value)
        try:
            if name == "light":
                viewer.show.lit(viewer.view)
            else:
                viewer.show.brdf(viewer.view)
            viewer.message = ""
        except PrtnetError as error:
            setattr(viewer.view, name, before)
            viewer.complain(error)

    def parameters(self) -> None:
        """A slider for every parameter of the BRDF, colours in three."""
        imgui, view = self.imgui, self.viewer.view
        brdf = self.viewer.show.brdf(view)
        if isinstance(brdf, Measured):
            return
        words, moved = [], False
        for field in dataclasses.fields(brdf):  # type: ignore[arg-type]
            value = getattr(brdf, field.name)
            low, high = RANGES.get(field.name, (0.0, 1.0))
            flags = imgui.SliderFlags_.always_clamp
            if isinstance(value, tuple):
                changed, new = imgui.color_edit3(
                    field.name, list(value), imgui.ColorEditFlags_.float
                )
                value = tuple(min(max(part, 0.0), 1.0) for part in new) if changed else value
            else:
                if high > 1.0:
                    flags |= imgui.SliderFlags_.logarithmic
                changed, new = imgui.slider_float(
                    field.name, float(value), low, high, "%.3f", flags
                )
                value = new if changed else value
            moved |= changed
            parts = value if isinstance(value, tuple) else (value,)
            words.append(f"{field.name}=" + "/".join(f"{part:.6g}" for part in parts))
        if moved:
            self.set_checked("brdf", f"{view.brdf.partition(':')[0]}:{','.join(words)}")
