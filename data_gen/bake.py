"""Local transfer of patches, meshes and wrinkles: rays, bounces and scatter make a field.

Everything is computed in one frame of the whole surface, as functions of the same distant light.
A patch keeps that frame, since it is what the patch is laid on; the vectors of a mesh are turned
into the frame of each vertex in the end.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from data_gen.casters import Caster, MeshCaster, PatchCaster
from data_gen.scattering import TAIL, scattering
from data_gen.static_mesh import StaticMesh
from data_gen.transport import bounce, gather, unit_irradiance
from prtnet.arrays import FloatArray
from prtnet.console import Report, silent
from prtnet.dipole import Medium
from prtnet.glossy import BrdfRows
from prtnet.sh_rotation import rotate
from prtnet.transfer import Patch, Surface, TransferField
from prtnet.wrinkle import Wrinkle

__all__ = ["BakeConfig", "bake_mesh", "bake_patch", "bake_wrinkle"]

FINER = 4  # places simulated for one column of a wrinkle's map
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class BakeConfig:
    """What is simulated.

    Attributes:
        order: bands n.
        rays: of every point, above its horizon.
        bounces: of inter-reflection at most; 0 for direct light alone.
        tolerance: bounces end when further ones add less than this share.
        albedo: of a matte surface, and of what glossy places see of others.
        medium: what scatters light under the surface, in place of the albedo; None for none.
        glossy: rows of a BRDF; None for matte transfer.
        threads: that trace.
    """

    order: int = 6
    rays: int = 1024
    bounces: int = 16
    tolerance: float = 1e-3
    albedo: float = 0.8
    medium: Medium | None = None
    glossy: BrdfRows | None = None
    threads: int = 1

    def facts(self) -> dict[str, Any]:
        """As JSON can hold it."""
        if self.medium is None:
            return {"rays": self.rays, "albedo": self.albedo}
        return {"rays": self.rays, "subsurface": dataclasses.asdict(self.medium)}


@dataclass(frozen=True, eq=False)
class Body:
    """What scatters light inside, beside the points themselves.

    Attributes:
        metres: one unit of the points' positions.
        period: of a surface that tiles along x and y, metres; None where it does not.
        underside: height in metres of a flat, open underside that takes light, and its area in
            square metres; None for none.
    """

    metres: float = 1.0
    period: tuple[float | None, float | None] = (None, None)
    underside: tuple[float, float] | None = None


def simulated(
    caster: Caster, config: BakeConfig, body: Body, report: Report
) -> tuple[FloatArray, dict[str, Any]]:
    """Transfer (K, R, n²) float64 in the surface's frame, and what became of the energy."""
    functions, open_sky = None, None
    if config.glossy is not None:
        rows = config.glossy

        def functions(local: FloatArray) -> FloatArray:
            return np.concatenate([local[None, :, 2] / math.pi, rows.at(local)])

        open_sky = np.concatenate(
            [unit_irradiance(config.order)[None], rows.harmonics(config.order)]
        )
    found = gather(caster, config.order, config.rays, functions, open_sky, config.threads, report)
    leave, through = exits(caster, config, body)
    total, told = bounce(
        found.direct[:, 0], found.hidden[0], leave, caster.areas, config.bounces,
        config.tolerance, through, report,
    )  # fmt: skip
    if config.glossy is None:
        return total[:, None], told.facts()
    seen = [matrix @ total if config.bounces else 0.0 for matrix in found.hidden[1:]]
    direct = found.direct[:, 1:]
    return np.stack([direct[:, b] + one for b, one in enumerate(seen)], axis=1), told.facts()


def exits(
    caster: Caster, config: BakeConfig, body: Body
) -> tuple[Callable[[FloatArray], FloatArray], FloatArray | None]:
    """How irradiance over π leaves the points again, and what comes through from the underside."""
    medium = config.medium
    if medium is None:
        return lambda arriving: config.albedo * arriving, None
    places = caster.positions * body.metres
    areas = caster.areas * body.metres**2
    if body.underside is None:
        return scattering(places, areas, medium, body.period), None
    height, area = body.underside
    under = places.copy()
    under[:, 2] = height
    flat = np.full(len(places), area / len(places))
    operator = scattering(
        np.concatenate([places, under]), np.concatenate([areas, flat]), medium, body.period
    )
    below = rotate(unit_irradiance(config.order), UPSIDE_DOWN)
    count = len(places)

    def leave(arriving: FloatArray) -> FloatArray:
        return operator(np.concatenate([arriving, np.zeros_like(arriving)]))[:count]

    lit = np.zeros((2 * count, config.order**2))
    lit[count:] = below
    return leave, operator(lit)[:count]


def bake_patch(
    heights: FloatArray,
    size: tuple[float, float],
    tiles: tuple[bool, bool],
    config: BakeConfig,
    thickness: float | None = None,
    report: Report = silent,
) -> TransferField:
    """Transfer of a height field, in the frame of what it is laid on.

    Args:
        heights: (H, W) metres, row 0 at y = 0; −∞ is a pit without a floor.
        size: metres along x and y.
        tiles: whether it repeats along x, along y; if not, its border goes on outwards.
        config: what is simulated.
        thickness: from the deepest place to a flat underside that light enters as well, metres;
            None for a thick body. Only where light scatters inside.
        report: of progress.

    Raises:
        ValueError: the relief is none (``data_gen.casters.PatchCaster``).
    """
    caster = PatchCaster(heights, size, tiles)
    period = tuple(length if once else None for length, once in zip(size, tiles, strict=True))
    body = Body(period=(period[0], period[1]))
    if thickness is not None:
        deep = float(caster.heights.min()) - thickness
        body = dataclasses.replace(body, underside=(deep, size[0] * size[1]))
    transfer, told = simulated(caster, config, body, report)
    normals = caster.frames[..., 2].reshape(*caster.heights.shape, 3)
    layout = Patch(caster.heights.astype(np.float32), normals.astype(np.float32), size, tiles)
    facts = {**config.facts(), **told}
    if thickness is not None:
        facts["thickness"] = thickness
    return field_of(transfer, layout, config, facts)


def bake_mesh(
    mesh: StaticMesh, config: BakeConfig, metres: float | None = None, report: Report = silent
) -> TransferField:
    """Transfer of the vertices of a mesh, each in its own frame.

    Args:
        mesh: what is lit.
        config: what is simulated.
        metres: that the longest side of its box stands for, where light scatters inside; its own
            units are metres when not given. Positions stay as they are.
        report: of progress.
    """
    caster = MeshCaster(mesh.positions, mesh.faces, mesh.normals, mesh.tangents)
    longest = float(np.ptp(mesh.positions, axis=0).max())
    body = Body(1.0 if metres is None else metres / longest)
    transfer, told = simulated(caster, config, body, report)
    local = rotate(transfer, caster.frames.transpose(0, 2, 1)[:, None])
    layout = Surface(mesh.positions, mesh.normals, mesh.tangents, mesh.faces)
    facts = {**config.facts(), **told, "dropped": list(mesh.dropped)}
    if config.medium is not None:
        facts["longest"] = longest if metres is None else metres
    return field_of(local, layout, config, facts)


def bake_wrinkle(wrinkle: Wrinkle, config: BakeConfig, report: Report = silent) -> TransferField:
    """Transfer of a family of grooves: a map of the place across and the depth.

    Every depth is simulated as an endless groove, on a finer line than the map's.

    Args:
        wrinkle: the family.
        config: what is simulated.
        report: of progress.
    """
    fine = FINER * (wrinkle.columns - 1)
    step = wrinkle.width / fine
    reach = 0.0 if config.medium is None else config.medium.reach(TAIL) / step
    beside = max(fine // 4, min(math.ceil(reach), 4 * fine))  # flat places on either side
    x = np.arange(-beside, fine + beside + 1) / fine
    rows, told = [], {}
    for done, depth in enumerate(wrinkle.depths):
        caster = PatchCaster(wrinkle.heights(x, depth)[None], (len(x) * step, step), (False, True))
        caster.turn_to(wrinkle.normals(x, depth))
        transfer, own = simulated(caster, config, Body(period=(None, step)), silent)
        rows.append(transfer[beside : beside + fine + 1 : FINER])
        told = own  # of the deepest, where most light bounces
        report("depths", done + 1, wrinkle.rows)
    across = np.arange(wrinkle.columns) / (wrinkle.columns - 1)
    depths = wrinkle.depths[:, None]
    layout = Patch(
        wrinkle.heights(across, depths).astype(np.float32),
        wrinkle.normals(across, np.broadcast_to(depths, (wrinkle.rows, wrinkle.columns)))
        .astype(np.float32),
        (wrinkle.width, wrinkle.deepest),
        (False, False),
    )  # fmt: skip
    facts = {**config.facts(), **told, "wrinkle": dataclasses.asdict(wrinkle)}
    return field_of(np.concatenate(rows), layout, config, facts)


def field_of(
    transfer: FloatArray, layout: Patch | Surface, config: BakeConfig, facts: dict[str, Any]
) -> TransferField:
    """The field of transfer (K, R, n²)."""
    view = None if config.glossy is None else config.glossy.view.astype(np.float32)
    return TransferField(transfer.astype(np.float32), layout, view, facts)
