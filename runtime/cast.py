"""A character to be shown, with everything that is known or can be found out about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.environment import Environment
from prtnet.gpu_tables import GPUTables
from prtnet.modelled_scene import ModelledScene

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
