"""What a viewer shows, without a window: a character, a light, a material, and ways to look at it.

All that an interactive view changes is in a :class:`View`; a :class:`Show` turns it into a picture
on any OpenGL context. Windows and command lines only change the view.
"""

from __future__ import annotations

import dataclasses
import math
import time as clock
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar, get_args

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.environment import Environment, about_up
from prtnet.gpu_tables import GPUTables
from prtnet.materials import brdf_named, material
from prtnet.modelled_scene import ModelledScene
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes, exact_lobes, fit_lobes
from runtime.camera import Camera
from runtime.error_pictures import error_scale, vertex_error
from runtime.painted import Painted
from runtime.picture import auto_exposure, colour_map
from runtime.posed_surface import coloured_surface, posed_subject, sides
from runtime.screen import Screen
from runtime.stage import Stage

__all__ = ["MODES", "Mode", "Show", "View"]

Mode = Literal["prediction", "truth", "open", "ambient", "error"]
MODES: tuple[Mode, ...] = get_args(Mode)
T = TypeVar("T")
FRAMED = 9  # poses of a clip that must be in the picture
TURN_STEP = math.radians(0.25)  # a drag's pixel


@dataclass
class View:
    """What is looked at, and how.

    Attributes:
        clip: the animation.
        time: seconds into it.
        light, brdf: names, as in ``prtnet render``.
        light_turn: of the light about the vertical, degrees.
        lobes: of the light, a colour; 0 for as many as hold it exactly.
        factors: of the BRDF.
        left, right: what either side of the split shows.
        split: where that is, a fraction of the width; 1 for the left side alone.
        azimuth, elevation: of the camera, radians.
        distance: of the camera, times the one that frames the character.
        pan: of the target, metres along the picture's axes.
        exposure: stops beside the one chosen under this light.
        playing: whether time goes on; the truth is traced when it does not.
    """

    clip: str
    time: float = 0.0
    light: str = "studio"
    light_turn: float = 0.0
    lobes: int = 3
    brdf: str = "matte"
    factors: int = 8
    left: Mode = "prediction"
    right: Mode = "truth"
    split: float = 1.0
    azimuth: float = math.radians(30.0)
    elevation: float = math.radians(12.0)
    distance: float = 1.0
    pan: tuple[float, float] = (0.0, 0.0)
    exposure: float = 0.0
    playing: bool = False

    def orbit(self, right: float, down: float) -> None:
        """Walk the camera around the character by so many pixels of a drag."""
        self.azimuth = (self.azimuth - TURN_STEP * right) % (2.0 * math.pi)
        limit = math.radians(89.0)
        self.elevation = min(max(self.elevation + TURN_STEP * down, -limit), limit)

    def zoom(self, steps: float) -> None:
        """Step towards the character."""
        self.distance = min(max(self.distance * 0.9**steps, 0.05), 20.0)


class Background(Generic[T]):
    """The last thing asked for, made in a thread of its own; one at a time."""

    def __init__(self) -> None:
        self.worker = ThreadPoolExecutor(1)
        self.key: Any = None
        self.future: Future[T] | None = None

    @property
    def busy(self) -> bool:
        """Whether something is being made."""
        return self.future is not None and not self.future.done()

    def get(self, key: Any, make: Callable[[], T], wait: bool = False) -> T | None:
        """What is asked for; None while it is being made, or something else still is."""
        if wait and self.future is not None and self.key != key:
            self.future.exception()  # done with, whatever came of it
        if self.key != key and not self.busy:
            self.key, self.future = key, self.worker.submit(make)
        ready = self.future is not None and self.key == key and (wait or self.future.done())
        return self.future.result() if ready and self.future is not None else None


class Show:
    """Draws a view of a character.

    Args:
        context: OpenGL that everything lives in; it must be current at every call.
        actor: the model and its scene.
        predict: poses (P, D) to visibility (P, V, n²).
        trace: the truth of one pose (1, D), (V, n²); runs in a thread of its own.
        environments: lights by name.
        latents: poses (P, D) to latents (P, Σ latents) as a shader wants them, and the model's
            tables, where predictions are to be rebuilt on the GPU.
        occluders: poses (P, D) to what a prior wants to know of them on the GPU (P, N, 4).

    Attributes:
        milliseconds: of the stages of the last frame, by name.
        exposures: by light, each chosen by the first picture under it.
        error_top: what is at the end of the error's colours, per cent of an open vertex.
    """

    def __init__(
        self,
        context: moderngl.Context,
        actor: ModelledScene,
        predict: Callable[[FloatArray], FloatArray],
        trace: Callable[[FloatArray], FloatArray],
        environments: Callable[[str], Environment],
        latents: tuple[Callable[[FloatArray], FloatArray], GPUTables] | None = None,
        occluders: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.context, self.actor = context, actor
        self.predict, self.trace, self.environments = predict, trace, environments
        self.order = actor.model.order
        self.stage, self.screen = Stage(context, self.order), Screen(context)
        self.painted = Painted(context)
        self.latents, self.rebuilt, self.occluders = None, None, occluders
        if latents is not None:
            self.latents = latents[0]
            self.rebuilt = Stage(context, self.order, latents[1])
        self.milliseconds: dict[str, float] = {}
        self.exposures: dict[str, float] = {}
        self.error_top = 0.0
        self.framing: Camera | None = None
        self._truth: Background[FloatArray] = Background()
        self._material: Background[ReflectionOperator] = Background()
        self._operator: ReflectionOperator | None = None
        self._brdf: tuple[str, BRDF] | None = None
        self._lit: tuple[Any, Lobes] | None = None
        self._posed: tuple[Any, FloatArray] | None = None
        self._predicted: tuple[Any, FloatArray] | None = None
        white = np.zeros((self.order**2, 3))
        white[0] = math.sqrt(4.0 * math.pi)
        self._white = exact_lobes(white.T)
        self._matte = material(brdf_named("matte"), order=self.order)

    @property
    def waiting(self) -> str:
        """What is being made in the background, in words; empty where nothing is."""
        tasks: dict[str, Background[Any]] = {
            "tracing the truth": self._truth,
            "making the material": self._material,
        }
        return ", ".join(what for what, task in tasks.items() if task.busy)

    def release(self) -> None:
        """Give everything back but the context; what is being traced is waited for."""
        for task in (self._truth, self._material):
            task.worker.shutdown(cancel_futures=True)
        for held in (self.stage, self.rebuilt, self.screen, self.painted):
            if held is not None:
                held.release()

    def camera(self, view: View) -> Camera:
        """Where a view is from: what frames the first clip, walked around."""
        if self.framing is None:
            clip = self.actor.scene.clip(view.clip)
            poses = self.actor.poses(clip.name, np.linspace(clip.start, clip.end, FRAMED))
            self.framing = Camera.framing(self.actor.scene.geometry(poses).positions, 1.0)
        base = self.framing
        target, eye = np.asarray(base.target), np.asarray(base.eye)
        reach = float(np.linalg.norm(eye - target))
        flat = math.cos(view.elevation)
        towards = np.array(
            [math.sin(view.azimuth) * flat, math.sin(view.elevation), math.cos(view.azimuth) * flat]
        )
        right = np.array([math.cos(view.azimuth), 0.0, -math.sin(view.azimuth)])
        target = target + view.pan[0] * right + view.pan[1] * np.cross(towards, right)
        eye = target + reach * view.distance * towards
        return dataclasses.replace(
            base,
            eye=tuple(eye.tolist()),
            target=tuple(target.tolist()),
            near=0.02 * reach * view.distance,
            far=reach * view.distance + base.far,
        )

    def draw(self, view: View, size: tuple[int, int], target: Any) -> None:
        """Draw a view into a framebuffer of this size."""
        started = clock.perf_counter()
        self.milliseconds = {}
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
                self._draw(mode, view, camera, size, frame, exposure)
        frame.scissor = None
        if view.light not in self.exposures and view.left not in ("ambient", "error"):
            drawn = auto_exposure(self.screen.linear())
            self.exposures[view.light] = drawn
            exposure = drawn * 2.0**view.exposure
        self.screen.present(target, exposure)
        self.milliseconds["frame"] = 1e3 * (clock.perf_counter() - started)

    def _draw(
        self,
        mode: Mode,
        view: View,
        camera: Camera,
        size: tuple[int, int],
        frame: Any,
        exposure: float,
    ) -> None:
        """One side of the split; nothing where the truth is not known yet."""
        pose, matrix = self.pose(view), camera.matrix(size[0] / size[1])
        eye = np.asarray(camera.eye)
        if mode == "prediction" and self.rebuilt is not None:
            self._draw_latents(self.rebuilt, view, frame, matrix, eye)
            return
        predicted = self.predicted(view)
        truth = self.truth(view) if mode in ("truth", "error") else None
        if mode in ("truth", "error") and truth is None:
            return
        if mode == "error" and truth is not None:
            wrong = vertex_error(predicted, truth)
            self.error_top = error_scale(wrong)
            heat = (colour_map(100.0 * wrong / self.error_top) / 255.0) ** 2.2
            surface = coloured_surface(self.actor, pose, heat.astype(np.float32))
            self.painted.draw(frame, surface, matrix, 1.0 / exposure)
            return
        visibility = predicted if truth is None else truth
        if mode == "open":
            visibility = np.zeros_like(predicted)
            visibility[:, 0] = math.sqrt(4.0 * math.pi)
        plain = mode == "ambient"
        white = Lobes(self._white.axes, self._white.coefficients / exposure)
        self.stage.light(white if plain else self.lit(view))
        self.stage.material(self._matte if plain else self.operator(view))
        started = clock.perf_counter()
        subject = posed_subject(self.actor, pose, visibility)
        self._count(pose=1e3 * (clock.perf_counter() - started))
        self.stage.show(subject)
        self.stage.draw(frame, matrix, eye)
        self._count(**self.stage.milliseconds)

    def _draw_latents(
        self, stage: Stage, view: View, frame: Any, matrix: FloatArray, eye: FloatArray
    ) -> None:
        """The prediction, its visibility rebuilt on the GPU."""
        assert self.latents is not None
        stage.light(self.lit(view))
        stage.material(self.operator(view))
        pose = self.pose(view)
        started = clock.perf_counter()
        latents = self.latents(pose)[0]
        occluders = None if self.occluders is None else self.occluders(pose)[0]
        self._count(model=1e3 * (clock.perf_counter() - started))
        started = clock.perf_counter()
        subject = posed_subject(self.actor, pose)
        self._count(pose=1e3 * (clock.perf_counter() - started))
        front, back = sides(self.actor)
        receivers = [front] if back is None else [front, back]
        stage.show_latents(subject, latents, receivers, occluders)
        stage.draw(frame, matrix, eye)
        self._count(**stage.milliseconds)

    def _count(self, **spent: float) -> None:
        """Milliseconds of stages: those of both sides of a split are summed."""
        for stage, ms in spent.items():
            self.milliseconds[stage] = self.milliseconds.get(stage, 0.0) + ms

    def metres(self, view: View, height: int) -> float:
        """What a pixel of a picture of this height is wide at the target."""
        camera = self.camera(view)
        reach = np.linalg.norm(np.asarray(camera.eye) - np.asarray(camera.target))
        return float(2.0 * math.tan(camera.fov / 2.0) * reach / max(height, 1))

    def pose(self, view: View) -> FloatArray:
        """The pose of a view, (1, D)."""
        key = (view.clip, view.time)
        if self._posed is None or self._posed[0] != key:
            self._posed = key, self.actor.poses(view.clip, np.array([view.time]))
        return self._posed[1]

    def predicted(self, view: View) -> FloatArray:
        """Its predicted visibility, (V, n²)."""
        key = (view.clip, view.time)
        if self._predicted is None or self._predicted[0] != key:
            pose = self.pose(view)
            started = clock.perf_counter()
            self._predicted = key, self.predict(pose)[0]
            self._count(model=1e3 * (clock.perf_counter() - started))
        return self._predicted[1]

    def truth(self, view: View, wait: bool = False) -> FloatArray | None:
        """The true visibility (V, n²) of the pose, traced in the background; None until then.

        Nothing is traced while time goes on: the next picture has another pose.
        """
        if view.playing and not wait:
            return None
        pose = self.pose(view)
        return self._truth.get((view.clip, view.time), lambda: self.trace(pose), wait)

    def brdf(self, view: View) -> BRDF:
        """The reflectance that a view names.

        Raises:
            PrtnetError: there is none of that name.
        """
        if self._brdf is None or self._brdf[0] != view.brdf:
            self._brdf = view.brdf, brdf_named(view.brdf)
        return self._brdf[1]

    def operator(self, view: View, wait: bool = False) -> ReflectionOperator:
        """The material, made in the background; the last one until then."""
        brdf, factors = self.brdf(view), view.factors
        found = self._material.get(
            (view.brdf, factors),
            lambda: material(brdf, factors, self.order),
            wait or self._operator is None,
        )
        self._operator = self._operator if found is None else found
        assert self._operator is not None
        return self._operator

    def lit(self, view: View) -> Lobes:
        """The lobes of the light: fitted once, then turned."""
        key = (view.light, view.lobes)
        if self._lit is None or self._lit[0] != key:
            light = self.environments(view.light).harmonics(self.order).T
            self._lit = key, exact_lobes(light) if view.lobes == 0 else fit_lobes(light, view.lobes)
        return self._lit[1].rotated(about_up(view.light_turn))
