"""Pictures of a character without a window, as a viewer shows them: by OpenGL or by NumPy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.environment import Environment
from prtnet.materials import brdf_named, material
from prtnet.modelled_scene import ModelledScene
from prtnet.one_dimensional import OneDimensional
from prtnet.reflection import ReflectionOperator
from prtnet.zh import Lobes
from runtime.camera import Camera
from runtime.cast import Radiance
from runtime.draw import Renderer, render_colours, render_lobes, render_material
from runtime.error_pictures import error_scale, vertex_error
from runtime.looks import (
    cut_lobes,
    cut_visibility,
    heat_colours,
    open_visibility,
    shaded_lobes,
    white_light,
)
from runtime.picture import auto_exposure, develop, laid_over
from runtime.posed_surface import coloured_surface, lobed_subject, posed_subject, seeing
from runtime.reflected import Subject
from runtime.vertex_sphere import inset_of, receiver_at
from runtime.view import UNLIT, Mode

__all__ = ["Posed", "Shot"]


@dataclass(frozen=True, eq=False)
class Posed:
    """A character in one pose; what is known of it is found out once.

    Attributes:
        actor: the model and its scene.
        pose: flattened, (1, D).
        trace: its true visibility, (V, n²).
        radiance: its true light, seen from somewhere.
    """

    actor: ModelledScene
    pose: FloatArray
    trace: Callable[[FloatArray], FloatArray]
    radiance: Radiance

    @cached_property
    def subject(self) -> Subject:
        """Vertices and frames."""
        return posed_subject(self.actor, self.pose)

    @cached_property
    def predicted(self) -> FloatArray:
        """Visibility (V, n²) as the model has it."""
        return self.actor.model(self.pose)[0]

    @cached_property
    def predicted_lobes(self) -> Lobes:
        """The same as lobes (V, c), of models that predict those."""
        return self.actor.model.lobes_of(self.pose)[0]

    @cached_property
    def visibility(self) -> FloatArray:
        """The traced one, (V, n²)."""
        return self.trace(self.pose)


@dataclass(frozen=True, eq=False)
class Shot:
    """What a picture is of.

    Attributes:
        posed: the character.
        camera: where from.
        light: what shines on it.
        lobes: the light as a shader takes it.
        brdf: the material.
        operator: the material as a shader takes it; None for one that lobes are shaded with.
        size: of the picture, in pixels.
        order: bands of light and visibility that are shown; 0 for all.
    """

    posed: Posed
    camera: Camera
    light: Environment
    lobes: Lobes
    brdf: BRDF
    operator: ReflectionOperator | None
    size: tuple[int, int]
    order: int = 0

    def draw(self, renderer: Renderer, mode: Mode) -> FloatArray:
        """The picture, (H, W, 4) linear."""
        posed, lobes, operator = self.posed, self.lobes, self.operator
        actor, order = posed.actor, posed.actor.model.order
        if mode in ("truth", "error"):
            colours = self._radiance() if mode == "truth" else self._heat()
            surface = coloured_surface(actor, posed.subject.positions, colours)
            return render_colours(renderer, surface, self.camera, self.size)
        if isinstance(self.brdf, OneDimensional) and mode != "ambient":
            seen = posed.predicted_lobes if mode == "prediction" else self._visibility(mode)
            lobed = lobed_subject(actor, posed.subject, shaded_lobes(seen, self.order))
            cut = cut_lobes(lobes, self.order)
            return render_lobes(renderer, lobed, cut, self.brdf, self.camera, self.size)
        if mode == "ambient":
            lobes = white_light(order)
            operator = material(brdf_named("matte"), order=order)
        assert operator is not None
        visibility = self._visibility(mode)
        subject = seeing(actor, posed.subject, visibility)
        return render_material(
            renderer, subject, lobes, operator, self.camera, self.size, order=self.order
        )

    def _visibility(self, mode: Mode) -> FloatArray:
        """What is shaded with, (V, n²), all bands."""
        if mode == "open":
            actor = self.posed.actor
            return open_visibility(len(actor.receivers), actor.model.order)
        return self.posed.visibility if mode == "visibility" else self.posed.predicted

    def _radiance(self) -> FloatArray:
        """Light traced without limits of bands, factors or lobes, (V, 3)."""
        eye = np.asarray(self.camera.eye)
        return self.posed.radiance(self.posed.pose, eye, self.light, self.brdf)

    def _heat(self) -> FloatArray:
        """Colours (V, 3) of what is wrong with the prediction."""
        predicted = cut_visibility(self.posed.predicted, self.order)
        wrong = vertex_error(predicted, self.posed.visibility)
        return heat_colours(wrong, error_scale(wrong))

    def split(
        self,
        renderer: Renderer,
        modes: tuple[Mode, Mode],
        place: float,
        exposure: float | None,
        stops: float = 0.0,
    ) -> tuple[FloatArray, float | None]:
        """Two ways to look at it, side by side in one picture.

        Args:
            renderer: from ``runtime.draw.opened``.
            modes: of the left and of the right side.
            place: where they meet, a fraction of the width; 1 for the left one alone.
            exposure: of an earlier picture; None to choose it by this one.
            stops: beside that.

        Returns:
            (H, W, 3) uint8 sRGB, and the exposure chosen; still None where nothing is lit.
        """
        column = round(min(max(place, 0.0), 1.0) * self.size[0])
        shown: list[FloatArray] = []
        for mode, part in ((modes[0], slice(column)), (modes[1], slice(column, None))):
            if not len(range(*part.indices(self.size[0]))):
                continue
            linear = self.draw(renderer, mode)
            if mode in UNLIT:
                gain = 1.0
            else:
                exposure = auto_exposure(linear) if exposure is None else exposure
                gain = exposure * 2.0**stops
            shown.append(develop(linear, gain)[:, part])
        return np.concatenate(shown, axis=1), exposure

    def with_vertex(self, picture: FloatArray, vertex: int, traced: bool) -> FloatArray:
        """A picture (H, W, 3) of this with a vertex's visibility on spheres laid over it.

        Args:
            picture: uint8 sRGB.
            vertex: of the render mesh; its front.
            traced: whether to show what is ray-traced beside the prediction.
        """
        posed, front = self.posed, (vertex, False)
        receiver = receiver_at(posed.actor, front)
        shown = [("predicted", posed.predicted[receiver])]
        shown += [("traced", posed.visibility[receiver])] if traced else []
        cut = [(caption, cut_visibility(one, self.order)) for caption, one in shown]
        spheres = inset_of(posed.subject, front, cut, self.camera, self.size)
        for inset, place in spheres:
            picture = laid_over(picture, inset, place)
        return picture
