"""The viewer's panel: clips, look, light, material, milliseconds, megabytes."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from prtnet.materials import OF_LOBES
from prtnet.merl import Measured
from prtnet.one_dimensional import OneDimensional
from runtime.base_panel import BasePanel
from runtime.crowd import MOST

if TYPE_CHECKING:
    from runtime.viewer import Viewer

__all__ = ["Panel"]

RANGES = {"exponent": (1.0, 200.0), "along": (1.0, 200.0), "across": (1.0, 200.0)}
"""Of parameters that are not between 0 and 1."""
LIVE_RANGE = 0.0, 1000.0  # of an exponent that needs no table
NONE = "none"


class Panel(BasePanel):
    """Draws the panel and changes the view as it is told."""

    viewer: Viewer

    def sections(self) -> Sequence[tuple[str, Callable[[], None]]]:
        """Clip, look, light, material."""
        return (("", self.pose), *super().sections(), ("material", self.material))

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
        """What is shown on either side, how bright, of how many bands."""
        super().look()
        view = self.viewer.view
        bands = {0: "all", **{n: str(n) for n in range(1, self.viewer.show.order)}}
        view.order = self.choose_value("order", view.order, bands)

    def light(self) -> None:
        """Which, from where, of how many lobes."""
        super().light()
        view = self.viewer.view
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
        super().remarks()

    def time(self, label: str, clip: str, value: float) -> tuple[bool, float]:
        """A slider of seconds into a clip: whether it was moved, and where it is."""
        imgui, found = self.imgui, self.viewer.show.actor.scene.clip(clip)
        always = imgui.SliderFlags_.always_clamp  # typed numbers, too
        moved, new = imgui.slider_float(label, value, found.start, found.end, "%.2f s", always)
        return moved, new if moved else value  # imgui rounds what it shows to 32 bits

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
