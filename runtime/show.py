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
from typing import Any, Literal, get_args

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.environment import Environment
from prtnet.gpu_tables import gpu_tables
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
        exposure: stops beside the one chosen at first.
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

    def orbit(self, right: float, up: float) -> None:
        """Walk the camera around the character by so many pixels of a drag."""
        self.azimuth = (self.azimuth - TURN_STEP * right) % (2.0 * math.pi)
        limit = math.radians(89.0)
        self.elevation = min(max(self.elevation + TURN_STEP * up, -limit), limit)

    def zoom(self, steps: float) -> None:
        """Step towards the character."""
        self.distance = min(max(self.distance * 0.9**steps, 0.05), 20.0)


class Show:
    """Draws a view of a character.

    Args:
        context: OpenGL that everything lives in; it must be current at every call.
        actor: the model and its scene.
        predict: poses (P, D) to visibility (P, V, n²).
        trace: the truth of one pose (1, D), (V, n²); runs in a thread of its own.
        environments: lights by name.
        latents: poses (P, D) to latents (P, Σ latents) as a shader wants them, where predictions
            are to be rebuilt on the GPU; not for models with a prior.

    Attributes:
        milliseconds: of the stages of the last frame, by name.
    """

    def __init__(
        self,
        context: moderngl.Context,
        actor: ModelledScene,
        predict: Callable[[FloatArray], FloatArray],
        trace: Callable[[FloatArray], FloatArray],
        environments: Callable[[str], Environment],
        latents: Callable[[FloatArray], FloatArray] | None = None,
    ) -> None:
        self.context, self.actor = context, actor
        self.predict, self.trace, self.environments = predict, trace, environments
        self.order = actor.model.order
        self.stage, self.screen = Stage(context, self.order), Screen(context)
        self.painted = Painted(context)
        self.latents, self.rebuilt = latents, None
        if latents is not None:
            self.rebuilt = Stage(context, self.order, gpu_tables(actor.model))
        self.milliseconds: dict[str, float] = {}
        self.base_exposure: float | None = None
        self.framing: Camera | None = None
        self._workers = ThreadPoolExecutor(1)
        self._truth: tuple[Any, Future[FloatArray]] | None = None
        self._material: tuple[Any, Future[ReflectionOperator]] | None = None
        self._operator: ReflectionOperator | None = None
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
        tasks = {"tracing the truth": self._truth, "making the material": self._material}
        return ", ".join(
            what for what, task in tasks.items() if task is not None and not task[1].done()
        )

    def release(self) -> None:
        """Give everything back but the context; what is being traced is waited for."""
        self._workers.shutdown(cancel_futures=True)
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
        for mode, left, width in (
            (view.left, 0, split),
            (view.right, split, size[0] - split),
        ):
            if width > 0:
                frame.scissor = (left, 0, width, size[1])
                self._draw(mode, view, camera, size, frame)
        frame.scissor = None
        if self.base_exposure is None:
            self.base_exposure = auto_exposure(self.screen.linear())
        self.screen.present(target, self.base_exposure * 2.0**view.exposure)
        self.milliseconds["frame"] = 1e3 * (clock.perf_counter() - started)

    def _draw(
        self, mode: Mode, view: View, camera: Camera, size: tuple[int, int], frame: Any
    ) -> None:
        """One side of the split."""
        pose, matrix = self.pose(view), camera.matrix(size[0] / size[1])
        eye = np.asarray(camera.eye)
        if mode == "prediction" and self.rebuilt is not None:
            self._draw_latents(self.rebuilt, view, frame, matrix, eye)
            return
        predicted = self.predicted(view)
        truth = self.truth(view) if mode in ("truth", "error") else None
        if mode == "error" and truth is not None:
            wrong = 100.0 * vertex_error(predicted, truth)
            heat = (colour_map(wrong / error_scale(wrong / 100.0)) / 255.0) ** 2.2
            gain = 1.0 / ((self.base_exposure or 1.0) * 2.0**view.exposure)
            surface = coloured_surface(self.actor, pose, heat.astype(np.float32))
            self.painted.draw(frame, surface, matrix, gain)
            return
        visibility = predicted if truth is None else truth
        if mode == "open":
            visibility = np.zeros_like(predicted)
            visibility[:, 0] = math.sqrt(4.0 * math.pi)
        plain = mode == "ambient"
        self.stage.light(self._white if plain else self.lit(view))
        self.stage.material(self._matte if plain else self.operator(view))
        started = clock.perf_counter()
        subject = posed_subject(self.actor, pose, visibility)
        self.milliseconds["pose"] = 1e3 * (clock.perf_counter() - started)
        self.stage.show(subject)
        self.stage.draw(frame, matrix, eye)
        self.milliseconds |= self.stage.milliseconds

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
        self.milliseconds["model"] = 1e3 * (clock.perf_counter() - started)
        started = clock.perf_counter()
        subject = posed_subject(self.actor, pose)
        self.milliseconds["pose"] = 1e3 * (clock.perf_counter() - started)
        front, back = sides(self.actor)
        stage.show_latents(subject, latents, [front] if back is None else [front, back])
        stage.draw(frame, matrix, eye)
        self.milliseconds |= stage.milliseconds

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
            self.milliseconds["model"] = 1e3 * (clock.perf_counter() - started)
        return self._predicted[1]

    def truth(self, view: View, wait: bool = False) -> FloatArray | None:
        """The true visibility (V, n²) of the pose, traced in the background; None until then."""
        key = (view.clip, view.time)
        if self._truth is None or (self._truth[0] != key and self._truth[1].done()):
            self._truth = key, self._workers.submit(self.trace, self.pose(view))
        if wait and self._truth[0] != key:
            self._truth[1].result()
            return self.truth(view, wait)
        ready = self._truth[0] == key and (wait or self._truth[1].done())
        return self._truth[1].result() if ready else None

    def operator(self, view: View, wait: bool = False) -> ReflectionOperator:
        """The material, made in the background; the last one until then."""
        key = (view.brdf, view.factors)
        if self._material is None or (self._material[0] != key and self._material[1].done()):
            brdf = brdf_named(view.brdf)  # what it does not know it says at once
            future = self._workers.submit(material, brdf, view.factors, self.order)
            self._material = key, future
        if self._operator is None or wait or self._material[1].done():
            self._operator = self._material[1].result()
        if wait and self._material[0] != key:
            return self.operator(view, wait)
        return self._operator

    def lit(self, view: View) -> Lobes:
        """The lobes of the light."""
        key = (view.light, view.lobes, view.light_turn)
        if self._lit is None or self._lit[0] != key:
            turned = self.environments(view.light).turned(view.light_turn)
            light = turned.harmonics(self.order).T
            self._lit = key, exact_lobes(light) if view.lobes == 0 else fit_lobes(light, view.lobes)
        return self._lit[1]
