"""The work of ``prtnet render``: one picture of a posed scene, or three side by side.

Like ``prtnet.cli``, which it serves, this module imports the other packages: a picture needs the
ray tracer and the renderers alike.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.environment import Environment, environment
from prtnet.materials import brdf_named, material
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.zh import Lobes, exact_lobes, fit_lobes

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray
    from prtnet.brdf import BRDF
    from prtnet.cli_options import RenderOptions
    from prtnet.console import Console
    from prtnet.reflection import ReflectionOperator
    from runtime.camera import Camera
    from runtime.draw import Renderer

__all__ = ["make_picture"]


@dataclass(frozen=True, eq=False)
class Shot:
    """What a picture is of.

    Attributes:
        actor: the model and its scene.
        pose: flattened, (1, D).
        camera: where from.
        light: what shines on it.
        lobes: the light as a shader takes it.
        brdf: the material.
        operator: the material as a shader takes it.
        size: of the picture, in pixels.
    """

    actor: ModelledScene
    pose: FloatArray
    camera: Camera
    light: Environment
    lobes: Lobes
    brdf: BRDF
    operator: ReflectionOperator
    size: tuple[int, int]

    def of(self, renderer: Renderer, visibility: FloatArray) -> FloatArray:
        """The picture (H, W, 4), linear, with this visibility (V, n²)."""
        from runtime.draw import render_material
        from runtime.posed_surface import posed_subject

        subject = posed_subject(self.actor, self.pose, visibility)
        return render_material(renderer, subject, self.lobes, self.operator, self.camera, self.size)

    def true_visibility(self, rays: int, threads: int) -> FloatArray:
        """Ray-traced, in local frames, (V, n²)."""
        from data_gen.visibility import trace_pose

        actor = self.actor
        return trace_pose(
            actor.scene, actor.receivers, actor.frame_field, self.pose, actor.model.order, rays,
            threads,
        )[0]  # fmt: skip

    def traced(self, renderer: Renderer, rays: int, threads: int) -> FloatArray:
        """The picture of light traced without limits of bands, factors or lobes."""
        from data_gen.radiance import trace_radiance
        from runtime.draw import render
        from runtime.posed_surface import coloured_surface

        actor = self.actor
        radiance = trace_radiance(
            actor.scene, actor.receivers, actor.frame_field, self.pose,
            np.asarray(self.camera.eye), self.light.radiance, self.brdf, rays, threads,
        )  # fmt: skip
        surface = coloured_surface(actor, self.pose, radiance)
        return render(renderer, surface, np.pi * np.eye(3), self.camera, self.size, albedo=1.0)


def make_picture(options: RenderOptions, threads: int, console: Console) -> dict[str, Any]:
    """Write the picture; facts about it.

    Raises:
        PrtnetError: model and scene do not belong together, there is no such clip, time, light or
            material, or the picture cannot be written.
    """
    from data_gen.readers import read_scene, require_clips
    from runtime.camera import Camera
    from runtime.draw import opened, usable
    from runtime.picture import auto_exposure, comparison, develop, save_png

    model = VisibilityModel.load(options.model)
    light = environment(options.light).turned(options.light_turn)
    brdf = brdf_named(options.brdf)
    lobes = lobes_of(light.harmonics(model.order), options.lobes)
    scene = read_scene(options.scene)
    require_clips(scene)
    actor = ModelledScene(model, scene)
    clip = scene.clip(options.clip) if options.clip else scene.clips[0]
    time = (clip.start + clip.end) / 2 if options.time is None else options.time
    pose = actor.poses(clip.name, np.array([time]))
    with console.progress() as report:
        report("material", 0, 0)
        operator = material(brdf, options.factors, model.order)
    positions = scene.geometry(pose).positions[0]
    camera = Camera.framing(positions, options.size[0] / options.size[1])
    shot = Shot(actor, pose, camera, light, lobes, brdf, operator, options.size)
    facts = {
        "out": options.out, "clip": clip.name, "time": time, "size": options.size,
        "brdf": options.brdf, "lobes": lobes.axes.shape[1],
    }  # fmt: skip
    with opened(options.renderer or usable(console.message)) as renderer:
        linear = shot.of(renderer, model(pose)[0])
        if options.compare is None:
            picture = develop(linear, auto_exposure(linear))
        else:
            with console.progress() as report:
                report("tracing the truth", 0, 0)
                if options.compare == "truth":
                    truth = shot.traced(renderer, options.rays, threads)
                else:
                    truth = shot.of(renderer, shot.true_visibility(options.rays, threads))
            captions = "prediction", f"ray-traced {options.compare}"
            picture, error = comparison(linear, truth, captions)
            facts["error_in_per_cent_of_white"] = error
    save_png(options.out, picture)
    return facts


def lobes_of(light: FloatArray, count: int | None) -> Lobes:
    """Lobes of a light (n², 3), so many of each colour, or as many as hold it exactly."""
    if count is None:
        return exact_lobes(light.T)
    return fit_lobes(light.T, count)
