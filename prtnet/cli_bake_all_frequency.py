"""The work of ``prtnet bake-all-frequency``: a still object for light of all frequencies.

Beside ``prtnet.cli``, which it serves, it may import the other packages: rays are ``data_gen``'s,
clusters ``training``'s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tyro.conf import Positional

from prtnet.cli_options import Place, fraction_of
from prtnet.cores import computing_threads, side_by_side, use_threads
from prtnet.errors import PrtnetError
from prtnet.limits import MOST_FACTORS, MOST_THREADS, check_within
from prtnet.provenance import made_with

if TYPE_CHECKING:
    from prtnet.all_frequency import AllFrequencyField
    from prtnet.all_frequency_factors import RowFactors
    from prtnet.console import Report
    from prtnet.transfer import Surface
    from training.all_frequency import CompressConfig

__all__ = ["PACKAGES", "AllFrequencyOptions", "baked_fields", "stages"]

TEXELS = (8, 16, 32, 64)  # that halve to one, and whose directions fill bytes
GROUND = "lambert:diffuse=0.5"
ROWS = 10
MOST_TERMS = 256
PACKAGES = ("numpy", "scipy", "torch", "embreex")  # whose versions a field's numbers depend on


@dataclass(frozen=True)
class AllFrequencyOptions:
    """Options of ``prtnet bake-all-frequency``."""

    source: Positional[Path]  # mesh: .ply, .obj, .stl, .off, or a scene at rest
    out: Path  # field to write, a .safetensors file
    brdf: str = "matte"  # material: a preset, a BRDF as ggx:roughness=0.3, a MERL .binary file
    rows: int | None = None  # products that a glossy BRDF is a sum of, 10; a matte one is one
    vertices: int | None = None  # decimate a finer mesh to so many
    ground: bool = False  # a matte ground under the object, shadowed by it
    texels: int = 32  # of a face of the light's cube map, a side: 8, 16, 32 or 64
    terms: int = 16  # representatives of a cluster
    points_per_cluster: int = 200  # vertices that share representatives, on average
    error: str = "0.2%"  # squared error to stay below, if clusters leave room for it
    seed: int = 0  # of the clusters
    cluster: str | None = None  # trace on the workers of this Dask scheduler, tcp://HOST:PORT
    exchange: Place | None = None  # folder or URL for finished parts, until all are: to go on with
    threads: int | None = None  # CPU threads; all cores when not given

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        for option, value, least, most in (
            ("--rows", self.rows, 1, MOST_FACTORS),
            ("--terms", self.terms, 1, MOST_TERMS),
            ("--points-per-cluster", self.points_per_cluster, 1, math.inf),
            ("--vertices", self.vertices, 4, math.inf),
            ("--threads", self.threads, 1, MOST_THREADS),
        ):
            check_within(option, value, least, most)
        if self.texels not in TEXELS:
            raise PrtnetError("--texels", f"is {self.texels}; give 8, 16, 32 or 64")
        if not 0.0 <= (fraction_of("--error", self.error) or 0.0) < 1.0:
            raise PrtnetError("--error", f"is {self.error}; it must be from 0 to below 100%")
        if self.out.suffix.lower() != ".safetensors":
            raise PrtnetError(self.out, "is no name of a field; end it in .safetensors")

    def inputs(self) -> list[Path]:
        """The files that are read."""
        return [path for path in (self.source, Path(self.brdf)) if path.is_file()]

    def compression(self) -> CompressConfig:
        """How much is kept."""
        from prtnet.cli_options import fraction_of
        from training.all_frequency import CompressConfig

        error = fraction_of("--error", self.error) or 0.0
        return CompressConfig(self.terms, self.points_per_cluster, error, seed=self.seed)


def baked_fields(
    options: AllFrequencyOptions, threads: int, report: Report
) -> tuple[AllFrequencyField, ...]:
    """The object, and the ground if it is asked for.

    Raises:
        PrtnetError: the mesh or the material is none, or cannot be read; a matte one is given rows.
    """
    from data_gen.all_frequency import ground
    from data_gen.coarse_mesh import coarser
    from data_gen.static_mesh import read_mesh
    from prtnet.all_frequency_factors import row_factors
    from prtnet.brdf import Lambert
    from prtnet.materials import brdf_named
    from prtnet.transfer import Surface

    use_threads(1)  # pieces of the work have one each: their number decides no byte
    brdf = brdf_named(options.brdf)
    if options.rows is not None and isinstance(brdf, Lambert):
        raise PrtnetError("--rows", "does nothing for a matte material; leave it out")
    mesh = read_mesh(options.source)
    fine = mesh if options.vertices is None else coarser(mesh, options.vertices)
    surface = Surface(fine.positions, fine.normals, fine.tangents, fine.faces)
    measured = Path(options.brdf)
    told: dict[str, Any] = {
        "source": options.source.name,
        "brdf": measured.name if measured.is_file() else options.brdf,
        "dropped": list(mesh.dropped),
    }
    parts = [(surface, row_factors(brdf, options.rows or ROWS), told)]
    if options.ground:
        beside: dict[str, Any] = {"source": "ground", "brdf": GROUND}
        parts.append((ground(surface), row_factors(brdf_named(GROUND)), beside))
    casters = [part[0] for part in parts]
    with side_by_side(threads):
        return tuple(
            one(options, own, casters, rows, facts, threads, report) for own, rows, facts in parts
        )


def one(
    options: AllFrequencyOptions,
    surface: Surface,
    casters: Sequence[Surface],
    rows: RowFactors,
    told: Mapping[str, Any],
    threads: int,
    report: Report,
) -> AllFrequencyField:
    """A surface in the shadow of casters."""
    from data_gen.all_frequency import SAMPLES, transfer_segments
    from data_gen.cube_visibility import cube_visibility
    from prtnet.exchange import exchange
    from training.all_frequency import compress, compressed

    seen = cube_visibility(surface, casters, SAMPLES * options.texels, threads, report)
    facts = {**told, **rows.facts(), "made_with": made_with(*PACKAGES)}
    kept = surface, rows.view, options.texels, options.compression(), facts, report
    place = exchange()
    with computing_threads(threads) as pool:
        if place is None:
            segments = partial(transfer_segments, surface, seen, rows, threads)
            return compress(segments, *kept, pool.map)
        from prtnet.cli_bake_segments import stages_elsewhere

        parts = stages_elsewhere(place, surface, seen, rows, options.compression())
        return compressed(parts, *kept, pool.map)


def stages(field: AllFrequencyField) -> list[list[str]]:
    """Rows of a table: what every stage leaves of the raw size, and its squared error."""
    from prtnet.all_frequency_file import sizes

    size, told = sizes(field), field.metadata["squared_error"]
    errors = {"clustered": told["clustered"], "total": told["stored"]}
    names = {
        "raw": "raw transfer",
        "clustered": "clusters, without zeros",
        "representatives": "representatives, stored",
        "weights": "weights",
        "clusters": "clusters' lists and scales",
        "view": "view factors",
        "total": "in all",
    }
    return [
        [
            name,
            f"{size[key] / 1e6:.2f} MB",
            f"{100 * size[key] / size['raw']:.3f} %",
            f"{100 * errors[key]:.3f} %" if key in errors else "",
        ]
        for key, name in names.items()
    ]
