"""The work of ``prtnet view``: a window that plays a model on its scene.

Like ``prtnet.cli``, which it serves, this module imports the other packages: the viewer shows the
ray-traced truth beside the prediction.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.cli_render import staged
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.gpu_tables import gpu_tables
from prtnet.materials import BRDFS, brdf_named
from prtnet.materials import PRESETS as MATERIALS
from prtnet.presets import PRESETS as LIGHTS

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray
    from prtnet.cli_options import ViewOptions
    from prtnet.model import VisibilityModel
    from runtime.viewer import Viewer

__all__ = ["opened_viewer"]


def opened_viewer(
    options: ViewOptions, threads: int, say: Callable[[str], None], visible: bool = True
) -> Viewer:
    """The window, ready to run.

    Raises:
        PrtnetError: model and scene do not belong together, there is no such clip, light or
            material, or no window can be opened.
    """
    from data_gen.truth import true_visibility
    from runtime.onnx_model import OnnxModel
    from runtime.show import Show, View
    from runtime.viewer import Viewer, open_window
    from training.onnx_export import build_onnx

    environments = functools.cache(environment)
    environments(options.light)
    brdf_named(options.brdf)
    actor, clip = staged(options)
    model = actor.model
    predict = OnnxModel(build_onnx(model).SerializeToString(), threads)

    def trace(pose: FloatArray) -> FloatArray:
        return true_visibility(actor, pose, options.rays, threads)

    latents, occluders = rebuilt(model, threads)
    if not options.out.is_dir():
        raise PrtnetError(options.out, "is no folder to save pictures in; make it, or give another")
    window = open_window(f"prtnet: {options.model.name}", options.size, visible)
    show = Show(window.ctx, actor, predict, trace, environments, latents, occluders)
    view = View(
        clip.name, clip.start, options.light, lobes=options.lobes, brdf=options.brdf,
        factors=options.factors,
    )  # fmt: skip
    lights, brdfs = list(LIGHTS), [*MATERIALS, *BRDFS]
    return Viewer(window, show, view, lights, brdfs, options.out, say)


def rebuilt(model: VisibilityModel, threads: int) -> tuple[Any, Any]:
    """What ``runtime.show.Show`` wants to rebuild visibility on the GPU: latents, and occluders.

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
