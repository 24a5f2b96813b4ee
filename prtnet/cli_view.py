"""The work of ``prtnet view``: a window that plays a model on its scene.

Like ``prtnet.cli``, which it serves, this module imports the other packages: the viewer shows the
ray-traced truth beside the prediction.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

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
    from runtime.onnx_model import OnnxLatents, OnnxModel
    from runtime.show import Show, View
    from runtime.viewer import Viewer, open_window
    from training.onnx_export import build_latent_onnx, build_onnx

    environments = functools.cache(environment)
    environments(options.light)
    brdf_named(options.brdf)
    actor, clip = staged(options)
    model = actor.model
    predict = OnnxModel(build_onnx(model).SerializeToString(), threads)

    def trace(pose: FloatArray) -> FloatArray:
        return true_visibility(actor, pose, options.rays, threads)

    latents = None
    if model.prior is None and model.latents.sum() > 0:
        tables = gpu_tables(model)
        graph = build_latent_onnx(model, tables.latent_scale)
        latents = OnnxLatents(graph.SerializeToString(), threads), tables
    if not options.out.is_dir():
        raise PrtnetError(options.out, "is no folder to save pictures in; make it, or give another")
    window = open_window(f"prtnet: {options.model.name}", options.size, visible)
    show = Show(window.ctx, actor, predict, trace, environments, latents)
    view = View(
        clip.name, clip.start, options.light, lobes=options.lobes, brdf=options.brdf,
        factors=options.factors,
    )  # fmt: skip
    lights, brdfs = list(LIGHTS), [*MATERIALS, *BRDFS]
    return Viewer(window, show, view, lights, brdfs, options.out, say)
