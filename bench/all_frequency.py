"""Bytes, errors and time of all-frequency transfer: "All-Frequency" (Liu et al. 2004), table 1.

python bench/all_frequency.py [--write] [--vertices N] [--full] [--quick]

The bunny, decimated to 11,500 vertices, in light of 6 × 32 × 32; --quick leaves out the curve and
the other materials, and so does --full, which takes all vertices and has tables of its own.
"""

from __future__ import annotations

import argparse
import contextlib
import resource
import time
from collections import Counter
from collections.abc import Iterator, Sequence

from factors import BareCookTorrance
from tables import per_cent, publish, scene_path

from data_gen.all_frequency import SAMPLES, transfer_segments
from data_gen.coarse_mesh import coarser
from data_gen.cube_visibility import CubeVisibility, cube_visibility
from data_gen.static_mesh import read_mesh
from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment
from prtnet.all_frequency_factors import row_factors
from prtnet.all_frequency_file import reached, sizes
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, CookTorrance, Lambert
from prtnet.cores import computing_threads, core_count, use_threads
from prtnet.cube_map import SIZE
from prtnet.transfer import Surface
from training.all_frequency import (
    Clustered,
    CompressConfig,
    Losses,
    clustered,
    fitted,
    sparse_wavelets,
)

VERTICES = 11_500  # the paper's
PAPER = ("paper, Cook-Torrance", 11_500, "2.84", "56.0 %", 763, "4.43 %", "29.5 %", "1.31 %",
         "–", "0.20 %")  # fmt: skip
GIVEN = {"roughness": 0.4, "fresnel": 0.5}
MATERIALS = {
    "Cook-Torrance, bare": BareCookTorrance(**GIVEN),
    "Cook-Torrance, as printed": CookTorrance(**GIVEN),
    "matte": Lambert(),
}
MAIN = (16, 200)  # terms, vertices of a cluster
ERRORS = (0.001, 0.002, 0.004, 0.008)  # the second is the paper's
CURVE = (MAIN, (16, 100), (8, 200))


class Encoder:
    """Bakes one material, and clusters it in several ways.

    Attributes:
        seconds: by stage.
    """

    def __init__(self, surface: Surface, seen: CubeVisibility, brdf: BRDF, threads: int) -> None:
        self.surface, self.seen, self.threads = surface, seen, threads
        self.each = computing_threads(threads).map
        self.rows = row_factors(brdf)
        self.seconds: Counter[str] = Counter()

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Counts the seconds of a block."""
        started = time.perf_counter()
        yield
        self.seconds[name] += time.perf_counter() - started

    def segments(self) -> Iterator[FloatArray]:
        """Raw transfer, timed."""
        made = transfer_segments(self.surface, self.seen, self.rows, self.threads)
        for _ in range(SEGMENTS):
            with self.stage("transfer, twice"):
                raw = next(made)
            yield raw

    def clusters(self, way: tuple[int, int]) -> list[Clustered]:
        """Of all segments."""
        found = []
        for raw in self.segments():
            with self.stage("clusters"):
                found.append(clustered(raw, CompressConfig(*way), self.each))
            print(f"\r{way}, segment {len(found)}", end="", flush=True)
        print()
        return found

    def field(self, found: list[Clustered], error: float) -> tuple[AllFrequencyField, Losses]:
        """What is stored of them."""
        return self.fields(found, (error,))[0]

    def fields(
        self, found: list[Clustered], errors: Sequence[float]
    ) -> list[tuple[AllFrequencyField, Losses]]:
        """The same for several errors, of one pass over the raw transfer."""
        with self.stage("wavelets"):
            kept = [sparse_wavelets(found, error, self.each) for error in errors]
        parts: list[list[Segment]] = [[] for _ in errors]
        losses = [Losses() for _ in errors]
        for number, (raw, one) in enumerate(zip(self.segments(), found, strict=True)):
            with self.stage("weights"):
                for way, (own, gone) in enumerate(kept):
                    segment, missed = fitted(raw, one, own[number], self.each)
                    parts[way].append(segment)
                    losses[way] += Losses(one.energy, one.lost, one.lost + gone[number], missed)
        view = self.rows.view
        fields = [AllFrequencyField(self.surface, tuple(own), view, SIZE) for own in parts]
        return list(zip(fields, losses, strict=True))


def row_of(name: str, field: AllFrequencyField, losses: Losses) -> list[object]:
    """As the paper's table: representatives of raw, what wavelets leave of them, both."""
    size = sizes(field)
    weights = 2 * size["weights"]  # as float32
    clusters = (size["clustered"] - weights) / size["raw"]
    kept = size["representatives"] / size["raw"]
    return [
        name, f"{len(field):,}", f"{size['raw'] / 1e9:.2f}", f"{100 * reached(field):.1f} %",
        sum(one.clusters for one in field.segments), per_cent(clusters),
        f"{100 * kept / clusters:.1f} %", per_cent(kept), per_cent(size["total"] / size["raw"]),
        per_cent(losses.errors()["stored"]),
    ]  # fmt: skip


def stage_rows(field: AllFrequencyField, losses: Losses) -> list[list[object]]:
    """What every stage leaves of the raw bytes, and its error."""
    size = sizes(field)
    errors = {name: f"{100 * error:.3f} %" for name, error in losses.errors().items()}

    def row(name: str, number: int, error: str = "") -> list[object]:
        return [name, f"{number / 1e6:,.1f}", per_cent(number / size["raw"]), error]

    return [
        row("raw", size["raw"], "0"),
        row("representatives and weights, float32", size["clustered"], errors["clustered"]),
        ["small numbers left out", "", "", errors["thresholded"]],
        row("representatives, sparse, 16 bits", size["representatives"]),
        row("weights, 16 bits, fitted anew", size["weights"], errors["stored"]),
        row("lists, scales, view factors", size["clusters"] + size["view"]),
        row("in all", size["total"], errors["stored"]),
    ]


def main() -> None:
    """All tables."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--write", action="store_true", help="put the tables into the docs")
    options.add_argument("--quick", action="store_true", help="one material, no curve")
    options.add_argument("--full", action="store_true", help="all vertices of the bunny")
    options.add_argument("--vertices", type=int, default=VERTICES)
    options.add_argument("--threads", type=int, default=core_count())
    chosen = options.parse_args()
    use_threads(1)  # of each of the threads
    seconds: Counter[str] = Counter()
    started = time.perf_counter()
    mesh = read_mesh(scene_path("bunny.ply"))
    mesh = mesh if chosen.full else coarser(mesh, chosen.vertices)
    seconds["decimation"] = time.perf_counter() - started
    surface = Surface(mesh.positions, mesh.normals, mesh.tangents, mesh.faces)
    started = time.perf_counter()
    seen = cube_visibility(surface, [surface], SAMPLES * SIZE, chosen.threads)
    seconds["visibility"] = time.perf_counter() - started
    quick, full = chosen.quick or chosen.full, ", full" * chosen.full
    told = f"{len(surface):,} vertices, about {MAIN[1]} a cluster of {MAIN[0]} representatives"
    rows = [PAPER]
    for name, brdf in list(MATERIALS.items())[: 1 if quick else None]:
        encoder = Encoder(surface, seen, brdf, chosen.threads)
        found = encoder.clusters(MAIN)
        field, losses = encoder.field(found, ERRORS[1])
        rows.append(row_of(f"{name}, m = {field.rows}", field, losses))
        print(rows[-1], encoder.rows.facts(), encoder.seconds, flush=True)
        if len(rows) == 2:
            first = encoder, found
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
            seconds |= encoder.seconds
            publish(f"all frequency stages{full}", ("", "MB", "of raw", "squared error"),
                    stage_rows(field, losses), f"{name}; {told}.")  # fmt: skip
            taken = [[stage, f"{number:.0f}"] for stage, number in seconds.items()]
            taken.append(["peak memory, GB", f"{peak:.2f}"])
            publish(f"all frequency time{full}", ("", "seconds"), taken,
                    f"{name}; {told}, {chosen.threads} threads.")  # fmt: skip
    publish(
        f"all frequency bytes{full}",
        ("", "vertices", "raw, GB", "ω", "clusters", "clustered", "wavelets", "both", "in all",
         "squared error"),
        rows,
        f"{told}. Columns as in the paper's table 1: representatives of the raw bytes, what"
        " wavelets, 16 bits and sparse columns leave of them, both; then *in all*, with weights,"
        " lists and view factors.",
    )  # fmt: skip
    if not quick:
        curve(*first)


def curve(encoder: Encoder, main: list[Clustered]) -> None:
    """Error against bytes: several clusterings, of which one is there, and how much is left out."""
    rows = []
    for way in CURVE:
        fields = encoder.fields(main if way == MAIN else encoder.clusters(way), ERRORS)
        row: list[object] = [f"{way[0]}, {way[1]}", per_cent(fields[0][1].errors()["clustered"])]
        for field, losses in fields:
            size = sizes(field)
            both = (size[name] / size["raw"] for name in ("representatives", "total"))
            row.append(", ".join(map(per_cent, (losses.errors()["stored"], *both))))
        rows.append(row)
        print(row, flush=True)
    publish(
        "all frequency curve",
        ("representatives, vertices", "clusters alone",
         *(f"for {per_cent(error)}" for error in ERRORS)),
        rows,
        "Squared error; representatives of the raw bytes; all of the raw bytes. Numbers are left"
        " out until the error of the column is reached, where clusters leave room for it.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
