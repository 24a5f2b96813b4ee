"""The truth beside a field in ``prtnet render FIELD --compare truth``: simulated anew, as it lies.

Rays are cast from the surface as it is posed, whatever lobes, frames and rows make of what was
simulated at rest. The light is that of the field's bands, and so is the truth. Beside
``prtnet.cli``, which it serves, it may import the other packages: rays are ``data_gen``'s.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from prtnet.errors import PrtnetError
from prtnet.limits import MOST_BOUNCES, MOST_RAYS

if TYPE_CHECKING:
    from data_gen.bake import BakeConfig
    from prtnet.canvas import Canvas
    from prtnet.console import Report
    from prtnet.lobe_field import LobeField
    from prtnet.transfer import Patch, Surface, TransferField

__all__ = ["traced_anew"]

MOST_ROWS = 16  # of a BRDF's truth: all that light of order 4 tells apart
LEVEL = 1e-4  # frames of a flat surface differ by less


def traced_anew(
    field: LobeField | TransferField, canvas: Canvas, threads: int, report: Report
) -> tuple[TransferField, str]:
    """Transfer of the field's own surface where it is now, and what it is, in words.

    Of a glossy material it has as many rows as light of its order tells apart, at most
    ``MOST_ROWS``.

    Args:
        field: whose metadata say what was simulated.
        canvas: where it is.
        threads: that trace.
        report: of progress.

    Raises:
        PrtnetError: it is a patch that is bent, a membrane, or the field does not say what was
            simulated.
    """
    from prtnet.transfer import Patch

    told = field.metadata
    if told.get("simulated") == "membrane":
        raise PrtnetError("--compare", "a membrane is a formula, not traced; compare with sh")
    if isinstance(field.layout, Patch) and not flat(canvas):
        what = "truth of a patch is traced where it is flat; add --on plane, or compare with sh"
        raise PrtnetError("--compare", what)
    try:
        config = config_of(field, threads)
        if isinstance(field.layout, Patch):
            truth = traced_patch(field.layout, config, told, report)
        else:
            truth = traced_mesh(field.layout, canvas, config, told, report)
    except (KeyError, TypeError, ValueError) as error:
        what = f"truth needs what the field says of its simulation ({error!r}); bake it anew"
        raise PrtnetError("--compare", what) from error
    rows = f", {truth.rows} rows" if field.view is not None else ""
    return truth, f"ray-traced where it is{rows}"


def flat(canvas: Canvas) -> bool:
    """Whether it has one frame everywhere."""
    frames = canvas.frames
    return float(np.ptp(frames, axis=0).max(initial=0.0)) < LEVEL


def config_of(field: LobeField | TransferField, threads: int) -> BakeConfig:
    """What was simulated; ``traced_anew`` reports what is not told."""
    from data_gen.bake import BakeConfig
    from prtnet.dipole import Medium
    from prtnet.glossy import brdf_rows
    from prtnet.materials import brdf_named

    told, glossy, medium = field.metadata, None, None
    if field.view is not None:
        count = min(field.order**2, MOST_ROWS)
        glossy = brdf_rows(brdf_named(str(told["brdf"])), count, field.order)
    if "subsurface" in told:
        medium = Medium(**{name: float(value) for name, value in dict(told["subsurface"]).items()})
    rays, bounces = int(told["rays"]), int(told["bounces"])
    albedo = BakeConfig.albedo if medium is not None else float(told["albedo"])
    if not (1 <= rays <= MOST_RAYS and 0 <= bounces <= MOST_BOUNCES and 0 <= albedo <= 1):
        raise ValueError("rays, bounces or albedo out of bounds")
    return BakeConfig(
        order=field.order,
        rays=rays,
        bounces=bounces,
        albedo=albedo,
        medium=medium,
        glossy=glossy,
        threads=threads,
    )


def traced_patch(
    layout: Patch, config: BakeConfig, told: Mapping[str, Any], report: Report
) -> TransferField:
    """A relief, or a map of grooves."""
    from data_gen.bake import bake_patch, bake_wrinkle
    from prtnet.wrinkle import Wrinkle

    if "wrinkle" in told:
        family = Wrinkle(**told["wrinkle"])
        if (family.rows, family.columns) != layout.heights.shape:
            raise ValueError("its wrinkle is of another size")
        return bake_wrinkle(family, config, report)
    thickness = None if "thickness" not in told else float(told["thickness"])
    heights = layout.heights.astype(np.float64)
    return bake_patch(heights, layout.size, layout.tiles, config, thickness, report)


def traced_mesh(
    layout: Surface, canvas: Canvas, config: BakeConfig, told: Mapping[str, Any], report: Report
) -> TransferField:
    """A mesh as it is posed."""
    from data_gen.bake import bake_mesh
    from data_gen.static_mesh import StaticMesh

    positions, normals, tangents = (
        part.astype(np.float32)
        for part in (canvas.positions, canvas.normals, canvas.frames[..., 0])
    )
    every = np.arange(len(positions))
    mesh = StaticMesh(positions, normals, tangents, canvas.faces, every)
    before, now = (float(np.ptp(one, axis=0).max()) for one in (layout.positions, positions))
    longest = float(told.get("longest", before))
    return bake_mesh(mesh, config, longest * now / before, report)
