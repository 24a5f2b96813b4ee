"""What a viewer shows, without a window: a character, a light, a material, and ways to look at it.

All that an interactive view changes is in a :class:`runtime.view.View`; a :class:`Show` turns it
into a picture on any OpenGL context.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import Any, TypeVar

import moderngl
import numpy as np

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, Lambert
from prtnet.environment import about_up
from prtnet.materials import brdf_named, material
from prtnet.one_dimensional import OneDimensional
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from runtime.background import TRACERS, Background
from runtime.camera import Camera
from runtime.cast import Cast
from runtime.crowd import crowd_places, crowd_poses
from runtime.error_pictures import error_scale, vertex_error
from runtime.looks import (
    cut_lobes,
    cut_visibility,
    heat_colours,
    open_visibility,
    shaded_lobes,
    white_light,
)
from runtime.memory import gpu_bytes
from runtime.one_dimensional_stage import OneDimensionalStage
from runtime.painted import Painted
from runtime.pick import picked
from runtime.posed_surface import (
    coloured_surface,
    lobed_subject,
    posed_subject,
    seeing,
    sides,
)
from runtime.reflected import Subject
from runtime.sight import Sight
from runtime.stage import Stage
from runtime.studio import Studio
from runtime.vertex_sphere import inset_of, receiver_at
from runtime.view import UNLIT, View

__all__ = ["Show"]

T = TypeVar("T")


class Show(Sight[View]):
    """Draws a view of a character.

    Args:
        context: OpenGL that everything lives in; it must be current at every call.
        cast: the character.
        studio: lights and materials; it outlives the character.

    Attributes:
        error_top: what is at the end of the error's colours, per cent of an open vertex.
    """

    unlit = UNLIT

    def __init__(self, context: moderngl.Context, cast: Cast, studio: Studio) -> None:
        self.cast, self.actor, self.studio = cast, cast.actor, studio
        self.order = cast.actor.model.order
        self.error_top = 0.0
        self._truth: Background[FloatArray] = Background(TRACERS)
        self._radiance: Background[FloatArray] = Background(TRACERS)
        self._posed: tuple[Any, FloatArray] | None = None
        self._subject: tuple[Any, Subject] | None = None
        self._predicted: tuple[Any, FloatArray] | None = None
        self._own_lobes: tuple[Any, Lobes] | None = None
        self._traced: tuple[Any, FloatArray] | None = None
        self._inset: tuple[Any, list[tuple[FloatArray, tuple[int, int]]]] | None = None
        self._crowd: tuple[Any, FloatArray, list[Subject]] | None = None
        self._evaluated: dict[Any, list[Any]] = {}  # by what evaluates the crowd's poses
        self._white = white_light(self.order)
        self._matte = material(brdf_named("matte"), order=self.order)
        self.rebuilt: Stage | None = None
        self.lobed: dict[int, OneDimensionalStage] = {}  # by the number of lobes
        super().__init__(context, studio.environments)
        try:
            self.stage = self.keep(Stage(context, self.order))
            self.painted = self.keep(Painted(context))
            if cast.latents is not None:
                self.rebuilt = self.keep(Stage(context, self.order, cast.latents[1]))
        except BaseException:
            self.release()
            raise

    @property
    def tasks(self) -> Mapping[str, Background[Any]]:
        """What is traced and made."""
        return {
            "tracing visibility": self._truth,
            "tracing the truth": self._radiance,
            **self.studio.tasks,
        }

    @property
    def lasting(self) -> Collection[Background[Any]]:
        """The studio's."""
        return self.studio.tasks.values()

    def parts(self) -> dict[str, int | None]:
        """Bytes of the model's file, and of what it needs on the GPU."""
        found = {"model file": self.cast.model_bytes}
        for name, held in (("latents", self.rebuilt), ("visibility", self.stage)):
            if held is not None:
                found[f"GPU {name}"] = gpu_bytes(held.resources)
        found["GPU lobes"] = sum(gpu_bytes(held.resources) for held in self.lobed.values())
        return found

    def framed(self, view: View) -> Camera:
        """Sees the first clip."""
        return self.cast.camera(view.clip)

    def camera(self, view: View) -> Camera:
        """Where a view is from; it sees as far as the last of a crowd."""
        camera = super().camera(view)
        behind = math.sqrt(2.0 * view.copies) * self.cast.room
        return camera if view.copies == 1 else replace(camera, far=camera.far + behind)

    def lay_over(self, view: View, size: tuple[int, int], target: Any) -> None:
        """The spheres of the view's vertex."""
        if view.vertex is not None:
            for picture, place in self.insets(view, size):
                self.overlay.draw(target, picture, place)

    def advance(self, view: View, seconds: float) -> None:
        """Go on in both clips, and around."""
        view.advance(self.actor, seconds)

    def through(self, view: View, fps: int) -> Iterator[tuple[int, int]]:
        """The clip from its start to its end; what it is blended with goes on, too."""
        kept = view.time, view.blend_time
        clip = self.actor.scene.clip(view.clip)
        steps = np.diff(clip.times(fps), prepend=clip.start).tolist()
        view.time = clip.start
        try:
            for number, step in enumerate(steps):
                view.time = min(view.time + step, clip.end)
                view.advance_blend(self.actor, step)
                yield number, len(steps)
        finally:
            view.time, view.blend_time = kept

    def check(self, view: View, name: str) -> None:
        """Find out whether a light or a material can be shown.

        Raises:
            PrtnetError: it cannot.
        """
        if name == "light":
            self.environments(view.light)
        else:
            self.brdf(view)

    def draw_side(
        self,
        mode: str,
        view: View,
        camera: Camera,
        size: tuple[int, int],
        frame: Any,
        exposure: float,
    ) -> None:
        """One side of the split; nothing where the truth is not known yet."""
        matrix = camera.matrix(size[0] / size[1])
        eye = np.asarray(camera.eye)
        brdf = self.brdf(view)
        if isinstance(brdf, OneDimensional) and mode in ("prediction", "visibility", "open"):
            self._draw_lobes(mode, brdf, view, frame, matrix, eye)
            return
        if mode == "prediction" and self.rebuilt is not None:
            self._draw_latents(self.rebuilt, view, frame, matrix, eye)
            return
        if mode in ("truth", "error"):
            colours = self._painted_colours(mode, view, camera, exposure)
            if colours is not None:
                positions = self.subject(view).positions
                surface = coloured_surface(self.actor, positions, colours)
                self.painted.draw(frame, surface, matrix, 1.0)
            return
        shown = self._visibility(mode, view)
        if shown is None:
            return
        plain = mode == "ambient"
        white = Lobes(self._white.axes, self._white.coefficients / exposure)
        self.stage.show_bands(view.order)
        self.stage.light(white if plain else self.lit(view))
        self.stage.material(self._matte if plain else self.operator(view))
        self.stage.show(seeing(self.actor, self.subject(view), shown))
        self.stage.draw(frame, matrix, eye)
        self.count(**self.stage.milliseconds)
        if mode == "visibility":
            return
        for subject, place, others in self.others(view, self.cast.predict):
            seen = shown if mode == "open" else others
            self.stage.show(seeing(self.actor, subject, seen))
            self.stage.draw(frame, matrix @ moved(place), eye - place)
            self.count(**self.stage.milliseconds)

    def _painted_colours(
        self, mode: str, view: View, camera: Camera, exposure: float
    ) -> FloatArray | None:
        """Linear colours of receivers (V, 3) of what is not shaded here; None if not known yet."""
        if mode == "truth":
            return self.radiance(view, camera)
        truth = self.truth(view)
        if truth is None:
            return None
        wrong = vertex_error(cut_visibility(self.predicted(view), view.order), truth)
        self.error_top = error_scale(wrong)
        return heat_colours(wrong, self.error_top) / exposure

    def _visibility(self, mode: str, view: View) -> FloatArray | None:
        """What is shaded with, (V, n²); None if it is not known yet."""
        if mode == "open":
            return open_visibility(len(self.actor.receivers), self.order)
        return self.truth(view) if mode == "visibility" else self.predicted(view)

    def _draw_latents(
        self, stage: Stage, view: View, frame: Any, matrix: FloatArray, eye: FloatArray
    ) -> None:
        """The prediction, its visibility rebuilt on the GPU."""
        assert self.cast.latents is not None
        stage.show_bands(view.order)
        stage.light(self.lit(view))
        stage.material(self.operator(view))
        pose = self.pose(view)
        started = clock.perf_counter()
        (latents, occluders), *_ = self._for_shader(pose)
        self.count(model=1e3 * (clock.perf_counter() - started))
        subject = self.subject(view)
        front, back = sides(self.actor)
        receivers = [front] if back is None else [front, back]
        stage.show_latents(subject, latents, receivers, occluders)
        stage.draw(frame, matrix, eye)
        self.count(**stage.milliseconds)
        for other, place, own in self.others(view, self._for_shader):
            stage.show_latents(other, own[0], receivers, own[1])
            stage.draw(frame, matrix @ moved(place), eye - place)
            self.count(**stage.milliseconds)

    def _draw_lobes(
        self,
        mode: str,
        brdf: OneDimensional,
        view: View,
        frame: Any,
        matrix: FloatArray,
        eye: FloatArray,
    ) -> None:
        """Visibility as lobes, of a 1D BRDF."""
        if mode == "prediction":
            seen: Any = self._lobes(view)
        else:
            seen = self._visibility(mode, view)
        if seen is None:
            return
        shown = shaded_lobes(seen, view.order)
        count = shown.axes.shape[1]
        if count not in self.lobed:
            made = OneDimensionalStage(self.context, self.order, count)
            self.lobed[count] = self.keep(made)
        stage = self.lobed[count]
        stage.light(cut_lobes(self.lit(view), view.order))
        stage.material(brdf)
        stage.show(lobed_subject(self.actor, self.subject(view), shown))
        stage.draw(frame, matrix, eye)
        self.count(**stage.milliseconds)
        if mode == "visibility":
            return
        for other, place, own in self.others(view, self._lobes_of):
            lobes = shown if mode == "open" else shaded_lobes(own, view.order)
            stage.show(lobed_subject(self.actor, other, lobes))
            stage.draw(frame, matrix @ moved(place), eye - place)
            self.count(**stage.milliseconds)

    def _for_shader(self, poses: FloatArray) -> list[tuple[FloatArray, FloatArray | None]]:
        """What a shader rebuilds visibility from, of each pose: latents, a prior's occluders."""
        cast = self.cast
        assert cast.latents is not None
        latents = cast.latents[0](poses)
        seen = [None] * len(poses) if cast.occluders is None else list(cast.occluders(poses))
        return list(zip(latents, seen, strict=True))

    def others(
        self, view: View, evaluate: Callable[[FloatArray], Iterable[T]]
    ) -> list[tuple[Subject, FloatArray, T]]:
        """All characters but the first: vertices, place, and what the model makes of the pose."""
        if view.copies == 1:
            return []
        key = (view.moments, view.copies)
        if self._crowd is None or self._crowd[0] != key:
            started = clock.perf_counter()
            poses = crowd_poses(self.actor, view, view.copies)[1:]
            self._crowd = key, poses, [posed_subject(self.actor, pose[None]) for pose in poses]
            self._evaluated = {}
            self.count(pose=1e3 * (clock.perf_counter() - started))
        _, poses, subjects = self._crowd
        if evaluate not in self._evaluated:
            started = clock.perf_counter()
            self._evaluated[evaluate] = list(evaluate(poses))
            self.count(model=1e3 * (clock.perf_counter() - started))
        places = crowd_places(view.copies, self.cast.room)[1:]
        return list(zip(subjects, places, self._evaluated[evaluate], strict=True))

    def pick(
        self, view: View, size: tuple[int, int], place: tuple[float, float]
    ) -> tuple[int, bool] | None:
        """The vertex at a place of a picture (pixels from the left, the top), and whether it is its
        back that is seen; None where nothing is.
        """
        subject = self.subject(view)
        matrix = self.camera(view).matrix(size[0] / size[1])
        found = picked(subject.positions, subject.faces, matrix, size, place)
        return None if found is None else (found[0], found[1] and subject.back is not None)

    def insets(self, view: View, size: tuple[int, int]) -> list[tuple[FloatArray, tuple[int, int]]]:
        """What ``inset_of`` lays over a picture: of the view's vertex, the prediction, and the
        traced visibility beside it where it is known.
        """
        assert view.vertex is not None
        camera, truth = self.camera(view), self._truth.known(view.moments)
        key = (view.vertex, view.moments, view.order, camera, size, truth is not None)
        if self._inset is None or self._inset[0] != key:
            receiver = receiver_at(self.actor, view.vertex)
            shown = [("predicted", self._predicted_at(view, receiver))]
            shown += [] if truth is None else [("traced", truth[receiver])]
            cut = [(caption, cut_visibility(one, view.order)) for caption, one in shown]
            self._inset = key, inset_of(self.subject(view), view.vertex, cut, camera, size)
        return self._inset[1]

    def pose(self, view: View) -> FloatArray:
        """The pose of a view, (1, D)."""
        if self._posed is None or self._posed[0] != view.moments:
            self._posed = view.moments, view.pose(self.actor)
        return self._posed[1]

    def subject(self, view: View) -> Subject:
        """Vertices and frames of the pose."""
        if self._subject is None or self._subject[0] != view.moments:
            pose = self.pose(view)
            started = clock.perf_counter()
            self._subject = view.moments, posed_subject(self.actor, pose)
            self.count(pose=1e3 * (clock.perf_counter() - started))
        return self._subject[1]

    def predicted(self, view: View) -> FloatArray:
        """Its predicted visibility, (V, n²)."""
        if self._predicted is None or self._predicted[0] != view.moments:
            pose = self.pose(view)
            started = clock.perf_counter()
            self._predicted = view.moments, self.cast.predict(pose)[0]
            self.count(model=1e3 * (clock.perf_counter() - started))
        return self._predicted[1]

    def _predicted_at(self, view: View, receiver: int) -> FloatArray:
        """That of one receiver, (n²,), from the GPU where it is rebuilt there."""
        if self.rebuilt is None:
            return self.predicted(view)[receiver]
        (latents, occluders), *_ = self._for_shader(self.pose(view))
        return self.rebuilt.visibility_of(receiver, latents, occluders)

    def _lobes(self, view: View) -> Lobes:
        """Its predicted visibility as lobes, (V, c)."""
        if self._own_lobes is None or self._own_lobes[0] != view.moments:
            pose = self.pose(view)
            started = clock.perf_counter()
            self._own_lobes = view.moments, self.actor.model.lobes_of(pose)[0]
            self.count(model=1e3 * (clock.perf_counter() - started))
        return self._own_lobes[1]

    def _lobes_of(self, poses: FloatArray) -> list[Lobes]:
        """The same of other poses."""
        found = self.actor.model.lobes_of(poses)
        return [found[pose] for pose in range(len(poses))]

    def truth(self, view: View, wait: bool = False) -> FloatArray | None:
        """The true visibility (V, n²) of the pose, traced in the background; None until then.

        Nothing is traced while time goes on: the next picture has another pose.
        """
        if view.playing and not wait:
            return None
        pose = self.pose(view)
        return self._truth.get(view.moments, lambda: self.cast.trace(pose), wait)

    def radiance(self, view: View, camera: Camera, wait: bool = False) -> FloatArray | None:
        """What receivers truly send to the camera, (V, 3), traced as ``truth`` is.

        While it is traced for a camera that has moved, what the last one saw is given.
        """
        if view.playing and not wait:
            return None
        brdf, pose = self.brdf(view), self.pose(view)
        light = self.environments(view.light).turned(view.light_turn)
        look = (view.moments, view.light, view.light_turn, view.brdf)
        eye = None if isinstance(brdf, Lambert) else camera.eye  # seen alike from everywhere
        place = np.asarray(camera.eye)
        found = self._radiance.get(
            (look, eye), lambda: self.cast.radiance(pose, place, light, brdf), wait
        )
        if found is not None:
            self._traced = look, found
        return self._traced[1] if self._traced is not None and self._traced[0] == look else None

    def settle(self, view: View) -> None:
        """Wait for everything that a view needs; nothing of it is then missing or old."""
        self.lit(view)
        if not isinstance(self.brdf(view), OneDimensional):
            self.operator(view, wait=True)
        if {"visibility", "error"} & set(view.modes):
            self.truth(view, wait=True)
        if "truth" in view.modes:
            self.radiance(view, self.camera(view), wait=True)

    def brdf(self, view: View) -> BRDF:
        """The reflectance that a view names.

        Raises:
            PrtnetError: there is none of that name.
        """
        return self.studio.brdf(view.brdf, bool(self.actor.model.lobes))

    def operator(self, view: View, wait: bool = False) -> ReflectionOperator:
        """The material, made in the background; the last one until then."""
        return self.studio.operator(view.brdf, self.brdf(view), view.factors, self.order, wait)

    def drawable(self, view: View) -> View:
        """The view, in the light that was drawn last until its own has been fitted."""
        studio, order = self.studio, self.order
        last = studio.lit
        known = last is not None and studio.fitted(last[0], order, last[1])
        if studio.lobes(view.light, order, view.lobes, wait=not known) is not None:
            studio.lit = view.light, view.lobes
            return view
        assert last is not None
        return replace(view, light=last[0], lobes=last[1])

    def lit(self, view: View) -> Lobes:
        """The lobes of the light, turned."""
        found = self.studio.lobes(view.light, self.order, view.lobes, wait=True)
        assert found is not None
        return found.rotated(about_up(view.light_turn))


def moved(place: FloatArray) -> FloatArray:
    """The matrix (4, 4) that puts what is at the origin there."""
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return matrix
