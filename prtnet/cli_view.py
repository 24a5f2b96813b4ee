"""The work of ``prtnet view``: a window that plays a model on its scene.

Like ``prtnet.cli``, which it serves, this module imports the other packages: the viewer shows the
ray-traced truth beside the prediction.
"""

from __future__ import annotations

import contextlib
import functools
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.cli_arguments import pictures_folder
from prtnet.cli_options import blend_of
from prtnet.cli_render import order_of, staged, tracers
from prtnet.environment import environment
from prtnet.gpu_tables import gpu_tables
from prtnet.materials import BRDFS, brdf_named
from prtnet.materials import PRESETS as MATERIALS
from prtnet.presets import PRESETS as LIGHTS

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray
    from prtnet.cli_options import ViewOptions
    from prtnet.model import VisibilityModel
    from runtime.base_viewer import BaseViewer
    from runtime.cast import Cast
    from runtime.viewer import Viewer

__all__ = ["cast_of", "opened_viewer", "until_closed"]


def opened_viewer(
    options: ViewOptions, threads: int, say: Callable[[str], None], visible: bool = True
) -> Viewer:
    """The window, ready to run.

    Raises:
        PrtnetError: model and scene do not belong together, there is no such clip, light or
            material, or no window can be opened.
    """
    from runtime.base_viewer import in_window
    from runtime.memory import keep_little
    from runtime.show import Show
    from runtime.studio import Studio
    from runtime.view import View
    from runtime.viewer import Desk, Viewer

    keep_little()
    environments = functools.cache(environment)
    environments(options.light)
    cast_files = functools.partial(cast_of, rays=options.rays, threads=threads)
    cast = cast_files(options.model, options.scene)
    brdf_named(options.brdf, bool(cast.actor.model.lobes))
    scene = cast.actor.scene
    clip = scene.clip(options.clip) if options.clip else scene.clips[0]
    pictures_folder(options.out)
    view = View(
        clip.name, clip.start, light=options.light, lobes=options.lobes, brdf=options.brdf,
        factors=options.factors, order=order_of(options.order, cast.actor.model.order),
        copies=options.copies,
    )  # fmt: skip
    if (blend := blend_of(options.blend)) is not None:
        view.blend_clip, view.blend_time, view.blend = blend
        view.pose(cast.actor)
    desk = Desk(
        list(LIGHTS), options.out, say, [*MATERIALS, *BRDFS], cast_files, options.model,
        options.scene,
    )  # fmt: skip
    return in_window(
        f"prtnet: {options.model.name}", options.size, visible,
        lambda window: Viewer(window, Show(window.ctx, cast, Studio(environments)), view, desk),
    )  # fmt: skip


def until_closed(viewer: BaseViewer[Any, Any, Any], fail: Callable[[str, int, bool], int]) -> None:
    """Run a window, then give everything back.

    Args:
        viewer: the window.
        fail: prints an error and gives the exit status, for a display that goes away under it.
    """
    from runtime.closed_display import on_closed_display

    def leave() -> None:
        with contextlib.suppress(Exception):  # it may be in the middle of it
            viewer.stop_saving()
        told = "display: was closed under the window; start again on one that lasts"
        os._exit(fail(told, 2, False))  # Xlib lets nobody go on

    on_closed_display(leave)
    try:
        viewer.run()
    finally:
        viewer.close()


def cast_of(model_file: Path, scene_file: Path, rays: int, threads: int) -> Cast:
    """A model on its scene, ready to be shown.

    Args:
        model_file: from ``prtnet train``.
        scene_file: the scene it was fitted to.
        rays: per receiver of the truth.
        threads: that predict and trace.

    Raises:
        PrtnetError: a file cannot be used, or they do not belong together.
    """
    from runtime.cast import Cast
    from runtime.onnx_model import OnnxModel
    from training.onnx_export import build_onnx

    actor = staged(model_file, scene_file)
    predict = OnnxModel(build_onnx(actor.model).SerializeToString(), threads)
    latents, occluders = rebuilt(actor.model, threads)
    size = model_file.stat().st_size
    return Cast(actor, predict, *tracers(actor, rays, threads), latents, size, occluders)


def rebuilt(model: VisibilityModel, threads: int) -> tuple[Any, Any]:
    """What a ``runtime.cast.Cast`` has to rebuild visibility on the GPU: latents, and occluders.

    None for a model that is the same in all poses; no occluders without a prior.
    """
    from runtime.onnx_model import OnnxPart
    from training.onnx_export import build_latent_onnx
    from training.onnx_occluders import build_occluder_onnx

    def run(graph: Any) -> OnnxPart:
        return OnnxPart(graph.SerializeToString(), threads)

    some = model.latents.sum() > 0
    if model.prior is None and not some:
        return None, None
    tables = gpu_tables(model)

    def nothing(poses: FloatArray) -> FloatArray:
        return np.zeros((len(poses), 0), dtype=np.float32)

    latents = run(build_latent_onnx(model, tables.latent_scale)) if some else nothing
    occluders = None if model.prior is None else run(build_occluder_onnx(model))
    return (latents, tables), occluders
