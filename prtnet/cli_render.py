"""The work of ``prtnet render``: one picture of a posed scene, or three side by side.

Like ``prtnet.cli``, which it serves, this module imports the other packages: a picture needs the
ray tracer and the renderers alike.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.environment import Environment, environment
from prtnet.materials import brdf_named, material
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.zh import Lobes, exact_lobes, fewest_lobes, fit_lobes, relative_error

if TYPE_CHECKING:
    from prtnet.animation import Clip
    from prtnet.arrays import FloatArray
    from prtnet.brdf import BRDF
    from prtnet.cli_options import RenderOptions, ViewOptions
    from prtnet.console import Console
    from prtnet.reflection import ReflectionOperator
    from runtime.camera import Camera
    from runtime.draw import Renderer

__all__ = ["make_picture", "staged"]

FEW_LOBES = 3  # of a colour
LOBE_ERROR = 1e-3  # relative, of the light


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

    def traced(self, renderer: Renderer, rays: int, threads: int) -> FloatArray:
        """The picture of light traced without limits of bands, factors or lobes."""
        from data_gen.radiance import trace_radiance
        from runtime.draw import render_colours
        from runtime.posed_surface import coloured_surface

        actor = self.actor
        radiance = trace_radiance(
            actor.scene, actor.receivers, actor.frame_field, self.pose,
            np.asarray(self.camera.eye), self.light.radiance, self.brdf, rays, threads,
        )  # fmt: skip
        surface = coloured_surface(actor, self.pose, radiance)
        return render_colours(renderer, surface, self.camera, self.size)


def make_picture(options: RenderOptions, threads: int, console: Console) -> dict[str, Any]:
    """Write the picture; facts about it.

    Raises:
        PrtnetError: model and scene do not belong together, there is no such clip, time, light or
            material, or the picture cannot be written.
    """
    from data_gen.truth import true_visibility
    from runtime.camera import Camera
    from runtime.draw import opened, usable
    from runtime.picture import auto_exposure, comparison, develop, save_png

    light = environment(options.light).turned(options.light_turn)
    brdf = brdf_named(options.brdf)
    actor, clip = staged(options)
    model = actor.model
    lobes = lobes_of(light.harmonics(model.order, options.dering), options.lobes)
    time = (clip.start + clip.end) / 2 if options.time is None else options.time
    pose = actor.poses(clip.name, np.array([time]))
    with console.progress() as report:
        report("material", 0, 0)
        operator = material(brdf, options.factors, model.order)
    positions = actor.scene.geometry(pose).positions[0]
    camera = Camera.framing(positions, options.size[0] / options.size[1])
    shot = Shot(actor, pose, camera, light, lobes, brdf, operator, options.size)
    pictures = pictures_of(options)
    facts = {
        "out": options.out if options.spin is None else [path for path, _ in pictures],
        "clip": clip.name, "time": time, "size": options.size,
        "brdf": options.brdf, "lobes": lobes.axes.shape[1],
    }  # fmt: skip
    predicted, visibility = model(pose)[0], None
    errors = []
    exposure: float | None = None
    with opened(options.renderer or usable(console.message)) as renderer:
        for path, turn in pictures:
            own = dataclasses.replace(shot, camera=camera.around(turn))
            linear, truth = own.of(renderer, predicted), None
            if options.compare is not None:
                with console.progress() as report:
                    report("tracing the truth", 0, 0)
                    if options.compare == "truth":
                        truth = own.traced(renderer, options.rays, threads)
                    else:
                        if visibility is None:  # the same from all around
                            visibility = true_visibility(actor, pose, options.rays, threads)
                        truth = own.of(renderer, visibility)
            if exposure is None:  # one for all pictures around
                exposure = auto_exposure(linear if truth is None else truth)
            if truth is None:
                picture = develop(linear, exposure)
            else:
                captions = "prediction", f"ray-traced {options.compare}"
                picture, error = comparison(linear, truth, captions, exposure)
                errors.append(error)
            save_png(path, picture)
    if errors:
        facts["error_in_per_cent_of_white"] = errors[0] if options.spin is None else errors
    return facts


def staged(options: RenderOptions | ViewOptions) -> tuple[ModelledScene, Clip]:
    """The model on its scene, and the clip asked for or the first.

    Raises:
        PrtnetError: a file cannot be used, they do not belong together, or there is no such clip.
    """
    from data_gen.readers import read_scene, require_clips

    model = VisibilityModel.load(options.model)
    scene = read_scene(options.scene)
    require_clips(scene)
    clip = scene.clip(options.clip) if options.clip else scene.clips[0]
    return ModelledScene(model, scene), clip


def pictures_of(options: RenderOptions) -> list[tuple[Path, float]]:
    """Files to write, and how far the camera has walked around for each, radians."""
    if options.spin is None:
        return [(options.out, 0.0)]
    width = len(str(options.spin - 1))
    return [
        (options.out.with_stem(f"{options.out.stem}_{k:0{width}}"), 2.0 * np.pi * k / options.spin)
        for k in range(options.spin)
    ]


def lobes_of(light: FloatArray, count: int | None) -> Lobes:
    """Lobes of a light (n², 3): so many of each colour, or few if they hold it, or all it takes."""
    if count is not None:
        return fit_lobes(light.T, count)
    found = fewest_lobes(light.T, FEW_LOBES, LOBE_ERROR)
    return found if relative_error(light.T, found) <= LOBE_ERROR else exact_lobes(light.T)
