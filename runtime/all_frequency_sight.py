"""What a viewer shows of all-frequency fields, without a window: an object in a light that turns.

Of a picture only what has changed since the last is made anew: nothing but view factors are looked
up while the camera walks around.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import moderngl
import numpy as np

from prtnet.all_frequency import AllFrequencyField
from prtnet.arrays import FloatArray
from prtnet.cube_map import cube_map, directions, segment_coefficients
from prtnet.environment import Environment, about_up
from prtnet.sh import evaluate
from prtnet.truncation import truncated
from prtnet.turning_light import TurningLight
from runtime.all_frequency_shot import framing
from runtime.all_frequency_stage import AllFrequencyStage
from runtime.background import Background
from runtime.camera import Camera
from runtime.memory import gpu_bytes
from runtime.outlook import Outlook
from runtime.sight import Sight

__all__ = ["LOW_ORDER", "MODES", "AllFrequencySight", "AllFrequencyView"]

Mode = Literal["all", "some", "low"]
MODES: tuple[Mode, ...] = get_args(Mode)
LOW_ORDER = 5  # bands of the light that is low in frequency, as in figures 1 and 7 of the paper


@dataclass(kw_only=True)
class AllFrequencyView(Outlook):
    """What is looked at, and how.

    Attributes:
        left: 'all' of the light, 'some' of its wavelets, or what is 'low' in frequency of it.
        keep: how many wavelets 'some' are, the largest.
        turning: degrees that the light turns in a second, while time goes on.
        ground: whether what stands beside the object is shown.
    """

    left: str = "all"
    right: str = "low"
    keep: int = 400
    turning: float = 30.0
    ground: bool = True


class AllFrequencySight(Sight[AllFrequencyView]):
    """Draws a view of an object.

    Args:
        context: OpenGL that everything lives in; it must be current at every call.
        fields: the object, and what stands beside it.
        environments: lights by name.
        file_bytes: of the file they come from.
    """

    def __init__(
        self,
        context: moderngl.Context,
        fields: Sequence[AllFrequencyField],
        environments: Callable[[str], Environment],
        file_bytes: int = 0,
    ) -> None:
        self.fields, self.file_bytes = fields, file_bytes
        self._turning: Background[TurningLight] = Background()
        self._where = directions(fields[0].size).reshape(-1, 3)
        self._basis: FloatArray = evaluate(self._where, LOW_ORDER)
        self._lit: dict[int, Any] = {}  # by field: the light that it has taken
        self.stages: list[AllFrequencyStage] = []
        super().__init__(context, environments)
        try:
            for field in fields:
                self.stages.append(self.keep(AllFrequencyStage(context, field)))
        except BaseException:
            self.release()
            raise

    @property
    def tasks(self) -> Mapping[str, Background[Any]]:
        """Lights are spread so that they do not flicker."""
        return {"spreading the light": self._turning}

    def parts(self) -> dict[str, int | None]:
        """Bytes of the file, and of what is on the GPU."""
        held = sum(gpu_bytes(stage.resources) for stage in self.stages)
        return {"field file": self.file_bytes, "GPU field": held}

    def framed(self, view: AllFrequencyView) -> Camera:
        """Sees all of the object."""
        return framing(self.fields, 1.0, view.azimuth, view.elevation)

    def draw_side(
        self,
        mode: str,
        view: AllFrequencyView,
        camera: Camera,
        size: tuple[int, int],
        frame: Any,
        exposure: float,  # noqa: ARG002 - all that is shown is lit
    ) -> None:
        """All in one light."""
        shown = self.stages if view.ground else self.stages[:1]
        light = self._turning.get(view.light, lambda: self._spread(view.light))
        kept = view.keep if mode == "some" else None
        key = mode, kept, view.light, view.light_turn, light is not None
        old = [k for k in range(len(shown)) if self._lit.get(k) != key]
        if old:
            started = clock.perf_counter()
            coefficients = segment_coefficients(self._texels(mode, view, light))
            if kept is not None:
                coefficients = truncated(coefficients, kept)
            self.count(light=1e3 * (clock.perf_counter() - started))
            for k in old:
                shown[k].light(coefficients)
                self.count(**shown[k].milliseconds)
                self._lit[k] = key
        started = clock.perf_counter()
        matrix, eye = camera.matrix(size[0] / size[1]), np.asarray(camera.eye)
        for stage in shown:
            stage.draw(frame, matrix, eye)
        self.count(draw=1e3 * (clock.perf_counter() - started))

    def _spread(self, name: str) -> TurningLight:
        """A light that can be turned without flicker."""
        return TurningLight(self.environments(name), self.fields[0].size)

    def _texels(self, mode: str, view: AllFrequencyView, light: TurningLight | None) -> FloatArray:
        """The cube map of a moment; sampled as it is as long as the light is not spread."""
        turned, size = self.environments(view.light).turned(view.light_turn), self.fields[0].size
        if mode == "low":
            return (self._basis @ turned.harmonics(LOW_ORDER)).reshape(6, size, size, 3)
        return cube_map(turned, size) if light is None else light.at(about_up(view.light_turn))

    def settle(self, view: AllFrequencyView) -> None:
        """Wait until the light is spread."""
        self._turning.get(view.light, lambda: self._spread(view.light), wait=True)

    def check(self, view: AllFrequencyView, name: str) -> None:
        """Find out whether a light can be shown; materials are baked.

        Raises:
            PrtnetError: it cannot.
        """
        if name == "light":
            self.environments(view.light)

    def advance(self, view: AllFrequencyView, seconds: float) -> None:
        """The light turns on."""
        view.light_turn = (view.light_turn + view.turning * seconds) % 360.0

    def through(self, view: AllFrequencyView, fps: int) -> Iterator[tuple[int, int]]:
        """The light turns once around; a still one stands for a second."""
        kept = view.light_turn
        count = max(1, math.ceil(360.0 / abs(view.turning) * fps)) if view.turning else fps
        step = math.copysign(360.0 / count, view.turning) if view.turning else 0.0
        try:
            for number in range(count):
                view.light_turn = (kept + number * step) % 360.0
                yield number, count
        finally:
            view.light_turn = kept
