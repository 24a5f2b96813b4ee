"""The work of ``prtnet render``: pictures and movies of a posed scene, as a viewer would show it.

Like ``prtnet.cli``, which it serves, this module imports the other packages: a picture needs the
ray tracer and the renderers alike.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.brdf import Lambert
from prtnet.cli_arguments import refuse
from prtnet.cli_options import NO_MOVIE, blend_of
from prtnet.environment import Environment, environment
from prtnet.errors import PrtnetError
from prtnet.materials import brdf_named, material
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene, Moment
from prtnet.one_dimensional import OneDimensional

if TYPE_CHECKING:
    from prtnet.animation import Clip
    from prtnet.arrays import FloatArray
    from prtnet.brdf import BRDF
    from prtnet.cli_options import RenderOptions
    from prtnet.console import Console
    from runtime.camera import Camera
    from runtime.cast import Radiance
    from runtime.draw import Renderer
    from runtime.reel import Frame
    from runtime.shot import Posed, Shot

__all__ = ["check_options", "make_picture", "order_of", "staged", "tracers"]


def check_options(options: RenderOptions, named: Mapping[str, str]) -> None:
    """Refuse options that would do nothing.

    Args:
        options: all of them.
        named: those that are given, as ``prtnet.cli_arguments.named_options`` tells.

    Raises:
        PrtnetError: one is given.
    """
    traced = options.compare or {options.show, options.beside} & {"truth", "visibility", "error"}
    whys = {} if options.moving else {"fps": NO_MOVIE}
    if options.beside is None:
        whys["split"] = "is of what is shown beside; leave it out, or add --beside"
    if not traced:
        whys["rays"] = "are of what is traced; leave it out, or add --compare truth"
    refuse(named, whys)


def make_picture(options: RenderOptions, threads: int, console: Console) -> dict[str, Any]:
    """Write the picture, pictures or movie; facts about them.

    Raises:
        PrtnetError: model and scene do not belong together, there is no such clip, time, light,
            material or vertex, or the file cannot be written.
    """
    from runtime.draw import opened, usable
    from runtime.memory import resident_bytes
    from runtime.reel import opened_reel, saved_frames

    actor = staged(options.model, options.scene)
    scene = actor.scene
    clip = scene.clip(options.clip) if options.clip else scene.clips[0]
    check_vertex(options.vertex, actor)
    frames = frames_of(options, clip)
    take = staged_shots(options, actor, clip, frames, threads, console)
    facts = {
        "out": saved_frames(frames, options.out),
        "clip": clip.name, "time": frames[0].time, "size": options.size, "brdf": options.brdf,
        "lobes": take(frames[0]).lobes.axes.shape[1], "pictures": len(frames),
    }  # fmt: skip
    errors: list[dict[str, float]] = []
    exposure: float | None = None  # one for all pictures
    with contextlib.ExitStack() as held:
        renderer = held.enter_context(opened(options.renderer or usable(console.message)))
        report = held.enter_context(console.progress())
        write = held.enter_context(opened_reel(options.out, options.fps))
        for number, frame in enumerate(frames):
            report("pictures", number, len(frames))
            picture, exposure = drawn(options, take(frame), renderer, exposure, errors)
            write(frame, picture)
    facts |= {"model_bytes": options.model.stat().st_size, "resident_bytes": resident_bytes()}
    if errors:
        facts["error_in_per_cent_of_white"] = errors if len(frames) > 1 else errors[0]
    return facts


def drawn(
    options: RenderOptions,
    shot: Shot,
    renderer: Renderer,
    exposure: float | None,
    errors: list[dict[str, float]],
) -> tuple[FloatArray, float | None]:
    """A picture (H, W, 3) and its exposure; the error is added to those there are."""
    from runtime.picture import auto_exposure, comparison

    modes = (options.show, options.show if options.beside is None else options.beside)
    if options.compare is None:
        split = 1.0 if options.beside is None else options.split
        picture, exposure = shot.split(renderer, modes, split, exposure, options.exposure)
    else:
        linear, truth = shot.draw(renderer, "prediction"), shot.draw(renderer, options.compare)
        exposure = auto_exposure(truth) if exposure is None else exposure
        captions = "prediction", f"ray-traced {options.compare}"
        gain = exposure * 2.0**options.exposure
        picture, error = comparison(linear, truth, captions, gain)
        errors.append(error)
    if options.vertex is not None:
        traced = options.compare is not None or bool({"visibility", "error"} & set(modes))
        picture = shot.with_vertex(picture, options.vertex, traced)
    return picture, exposure


def staged_shots(
    options: RenderOptions,
    actor: ModelledScene,
    clip: Clip,
    frames: list[Frame],
    threads: int,
    console: Console,
) -> Callable[[Frame], Shot]:
    """What makes a shot of a frame."""
    from runtime.looks import lobes_of
    from runtime.shot import Shot

    light = environment(options.light).turned(options.light_turn)
    brdf = brdf_named(options.brdf, bool(actor.model.lobes))
    order = order_of(options.order, actor.model.order)
    lobes = lobes_of(light.harmonics(actor.model.order, options.dering), options.lobes)
    posed = posing(options, actor, clip, threads)
    with console.progress() as report:
        report("material", 0, 0)
        lobed = isinstance(brdf, OneDimensional)
        operator = None if lobed else material(brdf, options.factors, actor.model.order)
    camera = camera_of(options, actor, clip, posed(frames[0].time))

    def take(frame: Frame) -> Shot:
        return Shot(
            posed(frame.time), camera.around(frame.turn), light, lobes, brdf, operator,
            options.size, order,
        )  # fmt: skip

    return take


def posing(
    options: RenderOptions, actor: ModelledScene, clip: Clip, threads: int
) -> Callable[[float], Posed]:
    """What poses the character at a time of the clip; the last pose is kept."""
    from runtime.shot import Posed

    trace, radiance = tracers(actor, options.rays, threads)
    blend = blend_of(options.blend)

    @functools.lru_cache(1)
    def posed(time: float) -> Posed:
        if blend is None:
            pose = actor.poses(clip.name, np.array([time]))
        else:
            pose = actor.blended(Moment(clip.name, time), Moment(*blend[:2]), blend[2])
        return Posed(actor, pose, trace, radiance)

    return posed


def camera_of(options: RenderOptions, actor: ModelledScene, clip: Clip, posed: Posed) -> Camera:
    """Sees the pose, or in a movie all of the clip, from where it is wanted."""
    from runtime.camera import Camera
    from runtime.view import framing

    aspect = options.size[0] / options.size[1]
    angles = np.radians([options.azimuth, options.elevation]).tolist()
    if options.moving and options.spin is None:
        camera = framing(actor, clip.name, aspect, azimuth=angles[0], elevation=angles[1])
    else:
        camera = Camera.framing(actor.scene.geometry(posed.pose).positions[0], aspect, *angles)
    return camera.nearer(options.zoom)


def frames_of(options: RenderOptions, clip: Clip) -> list[Frame]:
    """The pictures to make: one, all around, or through the clip."""
    from runtime.reel import reel

    time = (clip.start + clip.end) / 2 if options.time is None else options.time
    return reel(options.out, options.spin, time, clip.times(options.fps).tolist())


def staged(model_file: Path, scene_file: Path) -> ModelledScene:
    """The model on its scene.

    Raises:
        PrtnetError: a file cannot be used, or they do not belong together.
    """
    from data_gen.readers import read_scene, require_clips

    model = VisibilityModel.load(model_file)
    scene = read_scene(scene_file)
    require_clips(scene)
    return ModelledScene(model, scene)


def tracers(
    actor: ModelledScene, rays: int, threads: int
) -> tuple[Callable[[FloatArray], FloatArray], Radiance]:
    """What traces the truth of one pose: visibility (V, n²), and light towards an eye (V, 3).

    What comes through a membrane is what a matte surface would send from its other side: one-sided
    models have none, and it ends in a PrtnetError.
    """
    from data_gen.radiance import trace_radiance
    from data_gen.truth import true_visibility

    def visibility(pose: FloatArray) -> FloatArray:
        return true_visibility(actor, pose, rays, threads)

    def radiance(pose: FloatArray, eye: FloatArray, light: Environment, brdf: BRDF) -> FloatArray:
        def traced(reflectance: BRDF) -> FloatArray:
            return trace_radiance(
                actor.scene, actor.receivers, actor.frame_field, pose, eye, light, reflectance,
                rays, threads,
            )  # fmt: skip

        if not (isinstance(brdf, OneDimensional) and brdf.lets_light_through):
            return traced(brdf)
        if not actor.model.metadata.get("two_sided", False):
            why = "of light that is transmitted needs a model with backs (generate --two-sided)"
            raise PrtnetError("truth", f"{why}; leave out transmitted")
        through = traced(Lambert(brdf.transmitted))
        return traced(brdf) + np.roll(through, len(through) // 2, axis=0)  # fronts, then backs

    return visibility, radiance


def order_of(order: int | None, most: int) -> int:
    """Bands to show, of so many; 0 for all.

    Raises:
        PrtnetError: there are not as many.
    """
    if order is not None and order > most:
        raise PrtnetError("--order", f"is {order}; the model has {most} bands, give at most those")
    return 0 if order in (None, most) else int(order)


def check_vertex(vertex: int | None, actor: ModelledScene) -> None:
    """Refuse a vertex that there is none of."""
    count = actor.scene.vertex_count
    if vertex is not None and vertex >= count:
        raise PrtnetError("--vertex", f"is {vertex}; the scene has {count}, counted from 0")
