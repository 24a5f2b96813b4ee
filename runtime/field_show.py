"""What ``prtnet view FIELD`` shows, without a window: lobes, one lobe, harmonics, the truth.

All of them are lobes to the GPU (:mod:`runtime.lobe_stage`): full harmonics as many as hold them
exactly, turned by their axes; ray-traced transfer of a posed mesh likewise.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import moderngl
import numpy as np

from prtnet.canvas import Canvas
from prtnet.environment import Environment
from prtnet.errors import PrtnetError
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import exact_field, lobe_field
from prtnet.transfer import TransferField
from runtime.background import TRACERS, Background
from runtime.camera import Camera
from runtime.field_cast import FieldCast
from runtime.field_shot import seen_from_origin
from runtime.field_view import FieldView
from runtime.gpu_timer import GPUTimer
from runtime.lobe_shading import LobeLight, light_table
from runtime.lobe_stage import LobeStage
from runtime.memory import gpu_bytes
from runtime.sight import Sight
from runtime.worn import PERIOD

__all__ = ["FieldShow"]


class FieldShow(Sight[FieldView]):
    """Draws a view of a field.

    Args:
        context: OpenGL that everything lives in; it must be current at every call.
        cast: the field, and what it is on.
        environments: lights by name.
    """

    def __init__(
        self,
        context: moderngl.Context,
        cast: FieldCast,
        environments: Callable[[str], Environment],
    ) -> None:
        self.cast = cast
        self._fitting: Background[LobeField] = Background()
        self._tracing: Background[LobeField] = Background(TRACERS)
        self._fitted: dict[int, LobeField] = {}  # by the number of lobes; 0 for all that it takes
        self._stages: dict[Any, tuple[LobeField, LobeStage, GPUTimer]] = {}
        self._canvas: tuple[Any, Canvas] | None = None
        self._lit: tuple[Any, LobeLight] | None = None
        super().__init__(context, environments)

    @property
    def tasks(self) -> Mapping[str, Background[Any]]:
        """What is fitted and traced."""
        return {"fitting lobes": self._fitting, "tracing the truth": self._tracing}

    def leave(self) -> list[Background[Any]]:
        """Give everything back but the context, and tell what is being made, without waiting."""
        for _, stage, _ in self._stages.values():
            stage.release()
        self._stages = {}
        return super().leave()

    def parts(self) -> dict[str, int | None]:
        """Bytes of the field's file, and of what is on the GPU."""
        held = sum(gpu_bytes(stage.resources) for _, stage, _ in self._stages.values())
        return {"field file": self.cast.file_bytes, "GPU field": held}

    def framed(self, view: FieldView) -> Camera:
        """Sees all that it comes to."""
        worn = self.cast.worn
        return Camera.framing(worn.extent(worn.clip(view.clip), math.radians(view.twist)), 1.0)

    def advance(self, view: FieldView, seconds: float) -> None:
        """Go on in the clip and in the twist, and around."""
        clip = self.cast.worn.clip(view.clip)
        if clip is not None:
            view.time = clip.later(view.time, seconds)
        view.swing = (view.swing + seconds) % PERIOD

    def through(self, view: FieldView, fps: int) -> Iterator[tuple[int, int]]:
        """The clip from its start to its end, or a twist to and fro.

        Raises:
            PrtnetError: nothing moves.
        """
        worn, kept = self.cast.worn, (view.time, view.swing)
        clip = worn.clip(view.clip)
        times = worn.times(clip, bool(view.twist), fps)
        try:
            for number, time in enumerate(times):
                view.time = view.time if clip is None else time
                view.swing = time - times[0]
                yield number, len(times)
        finally:
            view.time, view.swing = kept

    def check(self, view: FieldView, name: str) -> None:
        """Find out whether a light can be shown.

        Raises:
            PrtnetError: it cannot.
        """
        del name
        self.lit(view)

    def settle(self, view: FieldView) -> None:
        """Wait for everything that a view needs; nothing of it is then missing or old."""
        for mode in view.modes:
            self.field(mode, view, wait=True)

    def draw_side(
        self,
        mode: str,
        view: FieldView,
        camera: Camera,
        size: tuple[int, int],
        frame: Any,
        exposure: float,
    ) -> None:
        """One side of the split; nothing where it is not fitted or traced yet."""
        del exposure
        field = self.field(mode, view)
        if field is None:
            return
        by_table = view.by_table and mode in ("lobes", "one lobe")
        stage, timer = self._stage((mode, by_table), field)
        canvas = self.canvas(view)
        light = self.lit(view)
        started = clock.perf_counter()
        placed, moved = seen_from_origin(canvas, camera)
        stage.light(light)
        stage.show(placed)
        self.count(upload=1e3 * (clock.perf_counter() - started))
        with timer:
            stage.draw(frame, moved.matrix(size[0] / size[1]), np.asarray(moved.eye))
        if timer.milliseconds is not None:
            self.count(draw=timer.milliseconds)

    def _stage(self, key: Any, field: LobeField) -> tuple[LobeStage, GPUTimer]:
        """Where a field is drawn; what another was drawn by is given back."""
        held = self._stages.get(key)
        if held is None or held[0] is not field:
            made = LobeStage(self.context, field, key[1])
            if held is not None:
                held[1].release()
            timer = self.keep(GPUTimer(self.context)) if held is None else held[2]
            held = self._stages[key] = field, made, timer
        return held[1:]

    def canvas(self, view: FieldView) -> Canvas:
        """What the field is on, posed."""
        if self._canvas is None or self._canvas[0] != view.moments:
            started = clock.perf_counter()
            self._canvas = view.moments, view.canvas(self.cast.worn)
            self.count(pose=1e3 * (clock.perf_counter() - started))
        return self._canvas[1]

    def lit(self, view: FieldView) -> LobeLight:
        """The light, turned, and its table."""
        key = (view.light, view.light_turn)
        if self._lit is None or self._lit[0] != key:
            turned = self.environments(view.light).turned(view.light_turn)
            started = clock.perf_counter()
            harmonics = turned.harmonics(self.cast.order)
            self._lit = key, LobeLight(harmonics, light_table(harmonics))
            self.count(light=1e3 * (clock.perf_counter() - started))
        return self._lit[1]

    def field(self, mode: str, view: FieldView, wait: bool = False) -> LobeField | None:
        """What is drawn, fitted or traced in the background; None until then.

        Nothing is traced while time goes on: the next picture has another pose.

        Raises:
            PrtnetError: there is nothing that it could be made of.
        """
        if mode == "truth":
            return self._traced(view, wait)
        if mode == "lobes" and self.cast.lobes is not None:
            return self.cast.lobes
        transfer = self.cast.transfer
        if transfer is None:
            why = "needs transfer; name what the lobes were fitted to with --compare"
            raise PrtnetError(mode, why)
        count = {"lobes": view.count, "one lobe": 1, "harmonics": 0}[mode]
        if count not in self._fitted:
            found = self._fitting.get(count, lambda: fitted(transfer, count), wait)
            if found is None:
                return None
            self._fitted[count] = found
        return self._fitted[count]

    def _traced(self, view: FieldView, wait: bool) -> LobeField | None:
        """Transfer of the mesh as it is posed."""
        retrace = self.cast.retrace
        if retrace is None:
            raise PrtnetError("truth", "is of meshes; of a patch compare with harmonics")
        if view.playing and not wait:
            return None
        canvas = self.canvas(view)
        return self._tracing.get(view.moments, lambda: exact_field(retrace(canvas)), wait)


def fitted(transfer: TransferField, count: int) -> LobeField:
    """So many lobes of transfer; 0 for as many as hold it."""
    return lobe_field(transfer, count) if count else exact_field(transfer)
