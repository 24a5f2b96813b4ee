"""The viewer's panel: clips, look, light, material, milliseconds, megabytes."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from prtnet.materials import OF_LOBES
from prtnet.merl import Measured
from prtnet.one_dimensional import OneDimensional
from runtime.crowd import MOST
from runtime.view import MODES

if TYPE_CHECKING:
    from runtime.viewer import Viewer

__all__ = ["Panel"]

RANGES = {"exponent": (1.0, 200.0), "along": (1.0, 200.0), "across": (1.0, 200.0)}
"""Of parameters that are not between 0 and 1."""
LIVE_RANGE = 0.0, 1000.0  # of an exponent that needs no table
NONE = "none"


class Panel:
    """Draws the panel and changes the view as it is told.

    Args:
        viewer: whose.
    """

    def __init__(self, viewer: Viewer) -> None:
        from imgui_bundle import imgui

        self.imgui: Any = imgui
        self.viewer = viewer

    def draw(self, keys: Sequence[tuple[str, str]]) -> None:
        """The panel, and the keys if there are any to explain."""
        imgui = self.imgui
        imgui.set_next_window_pos((10, 10), imgui.Cond_.first_use_ever)
        height = self.viewer.window.size[1]
        imgui.set_next_window_size_constraints((330, 0), (330, max(100, height - 20)))
        imgui.begin("prtnet", None, imgui.WindowFlags_.always_auto_resize)
        self.pose()
        imgui.separator_text("look")
        self.look()
        imgui.separator_text("light")
        self.light()
        imgui.separator_text("material")
        self.material()
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

    def pose(self) -> None:
        """Clip and time, and what they are blended with."""
        imgui, view = self.imgui, self.viewer.view
        scene = self.viewer.show.actor.scene
        names = [clip.name for clip in scene.clips]
        chosen = self.choose("clip", view.clip, names)
        if chosen != view.clip:
            view.clip, view.time = chosen, scene.clip(chosen).start
        moved, view.time = self.time("time", view.clip, view.time)
        view.playing = view.playing and not moved
        _, view.playing = imgui.checkbox("play (Space)", view.playing)
        other = self.choose("blend with", view.blend_clip or NONE, [NONE, *names])
        other = "" if other == NONE else other
        if other != view.blend_clip:
            view.blend_clip = other
            view.blend_time = scene.clip(other).start if other else 0.0
            view.blend = view.blend or 0.5
        if view.blend_clip:
            moved, view.blend_time = self.time("its time", view.blend_clip, view.blend_time)
            view.playing = view.playing and not moved
            view.blend = self.slider("share", view.blend, 0.0, 1.0, "%.2f")
        always = imgui.SliderFlags_.always_clamp
        _, view.copies = imgui.slider_int("characters", view.copies, 1, MOST, "%d", always)

    def look(self) -> None:
        """What is shown on either side, of how many bands, how bright."""
        view = self.viewer.view
        view.left = self.choose("shown", view.left, list(MODES))
        view.split = self.slider("split (C)", view.split, 0.0, 1.0, "%.2f")
        if view.split < 1.0:
            view.right = self.choose("beside", view.right, list(MODES))
        bands = {0: "all", **{n: str(n) for n in range(1, self.viewer.show.order)}}
        view.order = self.choose_value("order", view.order, bands)
        view.exposure = self.slider("exposure", view.exposure, -4.0, 4.0, "%+.1f stops")

    def light(self) -> None:
        """Which, from where, of how many lobes."""
        viewer, view = self.viewer, self.viewer.view
        viewer.change("light", self.choose("light", view.light, viewer.desk.lights))
        view.light_turn = self.slider("turn", view.light_turn, 0.0, 360.0, "%.0f deg")
        counts: dict[int | None, str] = {None: "auto", 0: "exact"}
        counts |= {count: str(count) for count in range(1, 7)}
        view.lobes = self.choose_value("lobes", view.lobes, counts)

    def material(self) -> None:
        """Which BRDF, its parameters, of how many factors."""
        imgui, view = self.imgui, self.viewer.view
        name = view.brdf.partition(":")[0]
        lobed = OF_LOBES if self.viewer.show.actor.model.lobes else ()
        chosen = self.choose("BRDF", name, [*self.viewer.desk.brdfs, *lobed])
        if chosen != name:
            self.viewer.change("brdf", chosen)
        self.parameters()
        if isinstance(self.viewer.show.brdf(view), OneDimensional):
            return  # it is no product of factors
        always = imgui.SliderFlags_.always_clamp
        _, view.factors = imgui.slider_int("factors", view.factors, 1, 16, "%d", always)

    def remarks(self) -> None:
        """What there is to know about the picture."""
        imgui, viewer, view = self.imgui, self.viewer, self.viewer.view
        if "error" in view.modes and viewer.show.error_top > 0.0:
            imgui.text(f"yellow: {viewer.show.error_top:.3g} % of an open vertex")
        if view.playing and {"truth", "visibility", "error"} & set(view.modes):
            imgui.text("stop (Space) to trace the truth")
        if view.vertex is not None:
            kept = "" if viewer.following else ", kept (V)"
            imgui.text(f"vertex {view.vertex[0]}{kept}")
        if viewer.show.waiting:
            imgui.text(viewer.show.waiting)
        if viewer.message:
            imgui.text_wrapped(viewer.message)
        imgui.text_disabled("H: help")

    def time(self, label: str, clip: str, value: float) -> tuple[bool, float]:
        """A slider of seconds into a clip: whether it was moved, and where it is."""
        imgui, found = self.imgui, self.viewer.show.actor.scene.clip(clip)
        always = imgui.SliderFlags_.always_clamp  # typed numbers, too
        moved, new = imgui.slider_float(label, value, found.start, found.end, "%.2f s", always)
        return moved, new if moved else value  # imgui rounds what it shows to 32 bits

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
            if isinstance(brdf, OneDimensional) and high > 1.0:
                low, high = LIVE_RANGE
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
            self.viewer.change("brdf", f"{view.brdf.partition(':')[0]}:{','.join(words)}")
