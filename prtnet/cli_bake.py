"""The work of ``prtnet bake``: local transfer of meshes, reliefs and parametric models.

Beside ``prtnet.cli``, which it serves, it may import the other packages: rays are ``data_gen``'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from tyro.conf import Positional

from prtnet.cli_options import Place
from prtnet.cores import side_by_side, use_blas_threads
from prtnet.errors import PrtnetError, nearest_name
from prtnet.limits import (
    MOST_BOUNCES,
    MOST_LOBES,
    MOST_ORDER,
    MOST_RAYS,
    MOST_TEXELS,
    MOST_THREADS,
    check_side,
    check_within,
)
from prtnet.provenance import made_with

if TYPE_CHECKING:
    from data_gen.bake import BakeConfig
    from prtnet.console import Report
    from prtnet.lobe_field import LobeField
    from prtnet.transfer import TransferField

__all__ = ["PACKAGES", "BakeOptions", "baked", "check_options", "warnings_of"]

PACKAGES = ("embreex", "numpy", "scipy")  # that decide the bytes of a field
MEMBRANE, WRINKLE = "membrane", "wrinkle"
TEXELS = (64, 64)  # of a pattern
MAP = (32, 32)  # of a wrinkle
RELIEF = 0.1  # depth of a relief over its width, where no depth is given

# What options do something for each kind of source; all others are of any.
SIMULATED = {
    "order",
    "rays",
    "bounces",
    "albedo",
    "subsurface",
    "brdf",
    "rows",
    "metres",
    "cluster",
    "exchange",
}
RELIEFS = SIMULATED | {"thickness", "size", "depth", "edges"}
OPTIONS_OF = {
    "pattern": RELIEFS,
    "pattern that scatters": RELIEFS | {"seed"},
    "picture": RELIEFS,
    "mesh": SIMULATED,
    "wrinkle": SIMULATED | {"size", "depth"},
    "membrane": {"order", "albedo", "metres", "size", "translucency"},
    "field": {"cluster", "exchange"},
}
NEEDS = {
    "rows": "brdf",
    "thickness": "subsurface",
    "coherent": "lobes",
}


@dataclass(frozen=True)
class BakeOptions:
    """Options of ``prtnet bake``."""

    source: Positional[str]  # mesh, picture, weave, swirl, bumps, waffle, membrane, wrinkle, field
    out: Path  # field to write, a .safetensors file
    order: int = 6  # bands of the spherical harmonics
    rays: int = 1024  # rays per point; not of a membrane
    bounces: int = 16  # of inter-reflection at most; 0 for shadows alone
    albedo: float = 0.8  # share of light that the surface sends on; not beside --subsurface
    subsurface: str | None = None  # marble, milk, ...; or SCATTERING/ABSORPTION per millimetre
    thickness: float | None = None  # metres under a relief's deepest place, lit from below
    brdf: str | None = None  # glossy rows of a preset, a BRDF as ggx:roughness=0.3, a MERL .binary
    rows: int = 3  # of a glossy matrix: of --brdf
    lobes: int | None = None  # write zonal lobes, so many a row, instead of transfer as it is
    coherent: bool = False  # fit lobes all at once, so that they can be interpolated; slower
    size: tuple[int, int] | None = None  # texels; 64x64, a picture's own, 32x32 depths of a wrinkle
    metres: float | None = None  # width (0.1); longest side of a mesh that scatters
    depth: float | None = None  # metres: grey 0 to 1, or the deepest wrinkle; not of a mesh
    edges: Literal["auto", "wrap", "clamp"] = "auto"  # a relief repeats, or its border goes on
    translucency: str = "0.5"  # of a membrane: a number from 0 to 1, or a picture of them
    seed: int = 0  # of what bumps scatters
    cluster: str | None = None  # trace on the workers of this Dask scheduler, tcp://HOST:PORT
    exchange: Place | None = None  # folder or URL for finished parts, until all are: to go on with
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        check_within("--order", self.order, 1, MOST_ORDER)
        check_within("--rays", self.rays, 1, MOST_RAYS)
        check_within("--bounces", self.bounces, 0, MOST_BOUNCES)
        check_within("--rows", None if self.brdf is None else self.rows, 1, self.order**2)
        check_within("--lobes", self.lobes, 1, MOST_LOBES)
        check_within("--threads", self.threads, 1, MOST_THREADS)
        check_within("--albedo", self.albedo, 0, 1)
        check_side("--size", self.size, MOST_TEXELS)
        for option in ("metres", "depth", "thickness"):
            value = getattr(self, option)
            if value is not None and not (0 < value < math.inf):
                raise PrtnetError(f"--{option}", f"is {value:g}; it must be a length above 0")
        if self.out.suffix.lower() != ".safetensors":
            raise PrtnetError(self.out, "is no name of a field; end it in .safetensors")

    def inputs(self) -> list[Path]:
        """The files that are read."""
        named = [Path(text) for text in (self.source, self.translucency, self.brdf or "")]
        return [path for path in named if path.is_file()]


def source_of(options: BakeOptions) -> str:
    """What kind of source is named, of ``OPTIONS_OF``.

    Raises:
        PrtnetError: it is none.
    """
    from data_gen.grey_image import PICTURES
    from data_gen.reliefs import PATTERNS, SCATTERED
    from data_gen.static_mesh import MESHES

    ending = Path(options.source).suffix.lower()
    if options.source in (MEMBRANE, WRINKLE):
        return options.source
    if options.source in PATTERNS:
        return "pattern that scatters" if options.source in SCATTERED else "pattern"
    kinds = {".safetensors": "field"} | dict.fromkeys(PICTURES, "picture")
    kinds |= dict.fromkeys(MESHES, "mesh")
    if ending in kinds:
        return kinds[ending]
    known = nearest_name(options.source, [*PATTERNS, MEMBRANE, WRINKLE])
    files = ", ".join((*MESHES, *PICTURES, ".safetensors"))
    what = f"is no mesh, picture or pattern; {known}; files end in {files}"
    raise PrtnetError(options.source, what)


def check_options(options: BakeOptions, named: Mapping[str, str]) -> None:
    """Refuse options that would do nothing.

    Args:
        options: all of them.
        named: those that are given, as ``prtnet.cli_arguments.named_options`` tells.

    Raises:
        PrtnetError: one does nothing for this source, or without another option; or the source is
            none.
    """
    source = source_of(options)
    of_sources = set.union(*OPTIONS_OF.values())
    for name, option in named.items():
        if name in of_sources - OPTIONS_OF[source]:
            raise PrtnetError(option, f"does nothing for a {source}; leave it out")
        needed = NEEDS.get(name)
        if source == "mesh" and name == "metres":
            needed = "subsurface"  # light and shadow are the same at any size
        if needed is not None and getattr(options, needed) is None:
            raise PrtnetError(option, f"needs --{needed}; add it, or leave this out")
    for name in ("cluster", "exchange"):
        if name in named and source == "field" and options.coherent:
            raise PrtnetError(named[name], "does nothing for coherent lobes, one fit; leave it out")
    if "albedo" in named and options.subsurface is not None:
        raise PrtnetError(named["albedo"], "is what --subsurface takes the place of; leave it out")


def baked(options: BakeOptions, threads: int, report: Report) -> TransferField | LobeField:
    """The field that the options ask for.

    Raises:
        PrtnetError: the source is none, or cannot be read, simulated or fitted.
    """
    from prtnet.lobe_fit import lobe_field
    from prtnet.transfer import TransferField

    use_blas_threads(1)  # factors and fits of a point are small, and the same whatever --threads
    with side_by_side(threads):
        if source_of(options) != "field":
            field = simulated(options, threads, report)
        elif options.lobes is None:
            raise PrtnetError(options.source, "is baked already; add --lobes to fit lobes to it")
        else:
            field = TransferField.load(options.source)
        if options.lobes is None:
            return field
        return lobe_field(field, options.lobes, options.coherent, report)


def simulated(options: BakeOptions, threads: int, report: Report) -> TransferField:
    """Transfer as it is.

    Raises:
        PrtnetError: the source is none, or cannot be read or simulated.
    """
    source = source_of(options)
    if source == MEMBRANE:
        field = membrane(options)
    elif source == WRINKLE:
        field = wrinkle(options, threads, report)
    elif source == "mesh":
        field = mesh(options, threads, report)
    else:
        field = patch(options, threads, report)
    name = Path(options.source).name
    told = {"source": name, **field.metadata, "made_with": made_with(*PACKAGES)}
    if options.brdf is not None:
        measured = Path(options.brdf)
        told["brdf"] = measured.name if measured.is_file() else options.brdf
    return type(field)(field.transfer, field.layout, field.view, told)


def config_of(options: BakeOptions, threads: int) -> BakeConfig:
    """What is simulated.

    Raises:
        PrtnetError: there is no such medium or material.
    """
    from data_gen.bake import BakeConfig
    from prtnet.dipole import medium_named
    from prtnet.glossy import brdf_rows
    from prtnet.materials import brdf_named

    glossy = None
    if options.brdf is not None:
        glossy = brdf_rows(brdf_named(options.brdf), options.rows, options.order)
    medium = None if options.subsurface is None else medium_named(options.subsurface)
    return BakeConfig(
        order=options.order,
        rays=options.rays,
        bounces=options.bounces,
        albedo=options.albedo,
        medium=medium,
        glossy=glossy,
        threads=threads,
    )


def patch(options: BakeOptions, threads: int, report: Report) -> TransferField:
    """A relief: a pattern, or a picture."""
    from data_gen.bake import bake_patch
    from data_gen.grey_image import read_grey
    from data_gen.reliefs import PATTERNS, relief, seams_close

    config = config_of(options, threads)
    if options.source in PATTERNS:
        grey, closed = relief(options.source, options.size or TEXELS, options.seed), (True, True)
    else:
        grey = read_grey(options.source, options.size)
        closed = seams_close(grey)
    tiles = {"auto": closed, "wrap": (True, True), "clamp": (False, False)}
    rows, columns = grey.shape
    width = options.metres or 0.1
    size = (width, width * rows / columns)
    try:
        return bake_patch(
            grey * (options.depth or RELIEF * width),
            size,
            tiles[options.edges],
            config,
            options.thickness,
            report,
        )
    except ValueError as error:
        raise PrtnetError(options.source, f"cannot be baked ({error}); give another") from error


def mesh(options: BakeOptions, threads: int, report: Report) -> TransferField:
    """The vertices of a mesh."""
    from data_gen.bake import bake_mesh
    from data_gen.static_mesh import read_mesh

    found = read_mesh(options.source)
    return bake_mesh(found, config_of(options, threads), options.metres, report)


def membrane(options: BakeOptions) -> TransferField:
    """A thin membrane, and its map of translucency."""
    import numpy as np

    from data_gen.grey_image import read_grey
    from prtnet.membrane import membrane_field

    try:
        columns, rows = options.size or (1, 1)
        share = np.full((rows, columns), float(options.translucency))
    except ValueError:
        share = read_grey(options.translucency, options.size)
    rows, columns = share.shape
    width = options.metres or 0.1
    try:
        return membrane_field(share, (width, width * rows / columns), options.order, options.albedo)
    except ValueError as error:
        raise PrtnetError("--translucency", f"{error}; give 0.5 or a picture") from error


def wrinkle(options: BakeOptions, threads: int, report: Report) -> TransferField:
    """The map of grooves by place and depth."""
    from data_gen.bake import bake_wrinkle
    from prtnet.wrinkle import Wrinkle

    width = options.metres or 0.1
    columns, rows = options.size or MAP
    try:
        family = Wrinkle(width, options.depth or width, columns, rows)
    except ValueError as error:
        raise PrtnetError("--size", f"{error}; give 32x32") from error
    return bake_wrinkle(family, config_of(options, threads), report)


def warnings_of(facts: Mapping[str, Any]) -> list[str]:
    """What the user should know about a field."""
    told = []
    if facts.get("diverges"):
        told.append("inter-reflection does not end: light is enclosed where nothing absorbs it; "
                    "give a lower --albedo")  # fmt: skip
    elif facts.get("bounces", 0) > 0 and ((left := facts["left"]) is None or left > 0.01):
        share = "an unknown share" if left is None else f"up to {100 * left:.2g} %"
        told.append(f"further bounces would add {share} somewhere; give more --bounces")
    if "wrinkle" not in facts and facts.get("tiles") in (
        [True, False],
        [False, True],
        [False, False],
    ):
        told.append("the relief does not tile everywhere: its border goes on outwards there")
    return told
