"""A character to be shown, with everything that is known or can be found out about it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.environment import Environment
from prtnet.gpu_tables import GPUTables
from prtnet.modelled_scene import ModelledScene
from runtime.camera import Camera
from runtime.crowd import elbow_room
from runtime.view import framing

__all__ = ["Cast", "Radiance"]

Radiance = Callable[[FloatArray, FloatArray, Environment, BRDF], FloatArray]
"""Pose (1, D), eye (3,), light, reflectance to what receivers send to the eye, (V, 3)."""


@dataclass(frozen=True, eq=False)
class Cast:
    """A model on its scene, and how it is evaluated and judged.

    Attributes:
        actor: the model and its scene.
        predict: poses (P, D) to visibility (P, V, n²).
        trace: the true visibility (V, n²) of one pose (1, D); called in another thread.
        radiance: the true light of one pose; likewise.
        latents: poses (P, D) to latents (P, Σ latents) as a shader wants them, and the model's
            tables, where predictions are to be rebuilt on the GPU.
        model_bytes: of the model's file; None where there is none.
        occluders: poses (P, D) to what a prior wants to know of them on the GPU (P, N, 4); None
            for models without one.
    """

    actor: ModelledScene
    predict: Callable[[FloatArray], FloatArray]
    trace: Callable[[FloatArray], FloatArray]
    radiance: Radiance
    latents: tuple[Callable[[FloatArray], FloatArray], GPUTables] | None = None
    model_bytes: int | None = None
    occluders: Callable[[FloatArray], FloatArray] | None = None
    _cameras: dict[str, Camera] = field(default_factory=dict, init=False)

    @functools.cached_property
    def room(self) -> float:
        """Metres from one of a crowd to the next."""
        return elbow_room(self.actor)

    def camera(self, clip: str) -> Camera:
        """Sees the character all through a clip."""
        if clip not in self._cameras:
            self._cameras[clip] = framing(self.actor, clip)
        return self._cameras[clip]

    def ready(self, clip: str) -> None:
        """Work out now what the first picture needs, of this clip or the first."""
        names = [known.name for known in self.actor.scene.clips]
        self.camera(clip if clip in names else names[0])
        _ = self.room, self.actor.frame_field
