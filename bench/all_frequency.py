"""Bytes, errors and time of all-frequency transfer: "All-Frequency" (Liu et al. 2004), table 1.

python bench/all_frequency.py [--write] [--vertices N] [--full] [--quick]

The bunny, decimated to 11,500 vertices, in light of 6 × 32 × 32; --full takes all of its vertices,
--quick leaves out the curve and the other materials.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from factors import BareCookTorrance
from tables import per_cent, publish, scene_path

from data_gen.all_frequency import SAMPLES, transfer_segments
from data_gen.coarse_mesh import coarser
from data_gen.cube_visibility import CubeVisibility, cube_visibility
from data_gen.static_mesh import read_mesh
from prtnet.all_frequency import SEGMENTS, Segment
from prtnet.all_frequency_factors import RowFactors, row_factors
from prtnet.all_frequency_file import segment_sizes
from prtnet.arrays import FloatArray
from prtnet.brdf import CookTorrance, Lambert
from prtnet.cores import core_count
from prtnet.cube_map import SIZE
from prtnet.transfer import Surface
from training.all_frequency import CompressConfig, Losses, clustered, stored

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
ERRORS = (0.002, 0.001, 0.004, 0.008, 0.016)  # the first is the paper's
CURVE = (MAIN, (16, 100), (16, 400), (8, 200), (24, 200), (32, 200))


@dataclass
class Total:
    """Of all segments, for one way to compress them."""

    bytes: Counter[str] = field(default_factory=Counter)
    losses: Losses = field(default_factory=Losses)
    clusters: int = 0
    reached: int = 0
    raw: int = 0
    representatives: int = 0

    def add(self, raw: FloatArray, segment: Segment, losses: Losses) -> None:
        """One more segment."""
        self.bytes.update(segment_sizes(segment))
        self.losses += losses
        self.clusters += segment.clusters
        self.reached += len(segment.vertices)
        self.raw += raw.nbytes
        self.representatives += 4 * segment.scale.size * segment.representatives.shape[1]

    def share(self, *names: str) -> float:
        """Of the raw bytes; of all that is stored without names."""
        names = names or ("representatives", "weights", "clusters", "view")
        return sum(self.bytes[name] for name in names) / self.raw

    def error(self, stage: str = "stored") -> float:
        """Squared error."""
        return self.losses.errors()[stage]


Ways = dict[tuple[int, int, float], Total]


def timed(segments: Iterator[FloatArray], seconds: Counter[str]) -> Iterator[FloatArray]:
    """The same segments, and how long they took to make."""
    while True:
        started = time.perf_counter()
        raw = next(segments, None)
        seconds["transfer"] += time.perf_counter() - started
        if raw is None:
            return
        yield raw


def encoded(
    surface: Surface,
    seen: CubeVisibility,
    rows: RowFactors,
    ways: tuple[tuple[int, int], ...],
    errors: tuple[float, ...],
    threads: int,
    seconds: Counter[str],
) -> Ways:
    """Every way to compress one pass over the segments."""
    found = {(*way, error): Total() for way in ways for error in errors}
    segments = transfer_segments(surface, seen, rows, threads)
    for number, raw in enumerate(timed(segments, seconds), 1):
        for way in ways:
            config = CompressConfig(*way)
            started = time.perf_counter()
            clusters = clustered(raw, config)
            seconds["clusters"] += time.perf_counter() - started
            for error in errors:
                started = time.perf_counter()
                found[*way, error].add(raw, *stored(raw, clusters, error))
                seconds["wavelets, weights"] += time.perf_counter() - started
        print(f"\rsegment {number}", end="", flush=True)
        del raw
    print()
    for one in found.values():
        one.bytes["view"] = rows.view.nbytes
    return found


def row_of(name: str, count: int, one: Total) -> list[object]:
    """As the paper's table: representatives of raw, what wavelets leave of them, both."""
    clusters = one.representatives / one.raw
    kept = one.share("representatives")
    pairs = SEGMENTS * count
    return [
        name, f"{count:,}", f"{one.raw / 1e9:.2f}", f"{100 * one.reached / pairs:.1f} %",
        one.clusters, per_cent(clusters), f"{100 * kept / clusters:.1f} %", per_cent(kept),
        per_cent(one.share()), per_cent(one.error()),
    ]  # fmt: skip


def stage_rows(one: Total) -> list[list[object]]:
    """What every stage leaves of the raw bytes, and its error."""
    weights = one.bytes["weights"]
    return [
        ["raw", f"{one.raw / 1e6:,.1f}", "100 %", "0"],
        ["representatives and weights, float32", f"{one.bytes['clustered'] / 1e6:.1f}",
         per_cent(one.share("clustered")), f"{100 * one.error('clustered'):.3f} %"],
        ["… small numbers left out", "", "", f"{100 * one.error('thresholded'):.3f} %"],
        ["representatives, sparse, 16 bits", f"{one.bytes['representatives'] / 1e6:.1f}",
         per_cent(one.share("representatives")), ""],
        ["weights, 16 bits, fitted anew", f"{weights / 1e6:.1f}", per_cent(one.share("weights")),
         f"{100 * one.error():.3f} %"],
        ["lists, scales, view factors", f"{(one.bytes['clusters'] + one.bytes['view']) / 1e6:.1f}",
         per_cent(one.share("clusters", "view")), ""],
        ["in all", f"{one.share() * one.raw / 1e6:.1f}", per_cent(one.share()),
         f"{100 * one.error():.3f} %"],
    ]  # fmt: skip


def main() -> None:
    """All tables."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--write", action="store_true", help="put the tables into the docs")
    options.add_argument("--quick", action="store_true", help="one material, no curve")
    options.add_argument("--full", action="store_true", help="all vertices of the bunny")
    options.add_argument("--vertices", type=int, default=VERTICES)
    options.add_argument("--threads", type=int, default=core_count())
    chosen = options.parse_args()
    torch.set_num_threads(chosen.threads)
    seconds: Counter[str] = Counter()
    started = time.perf_counter()
    mesh = read_mesh(scene_path("bunny.ply"))
    mesh = mesh if chosen.full else coarser(mesh, chosen.vertices)
    seconds["decimation"] = time.perf_counter() - started
    surface = Surface(mesh.positions, mesh.normals, mesh.tangents, mesh.faces)
    started = time.perf_counter()
    seen = cube_visibility(surface, [surface], SAMPLES * SIZE, chosen.threads)
    seconds["visibility"] = time.perf_counter() - started
    rows, first, peak = [PAPER], None, 0.0
    for name, brdf in list(MATERIALS.items())[: 1 if chosen.quick else None]:
        factors = row_factors(brdf)
        own = seconds if first is None else Counter()
        found = encoded(surface, seen, factors, (MAIN,), ERRORS[:1], chosen.threads, own)
        total = found[*MAIN, ERRORS[0]]
        rows.append(row_of(f"{name}, m = {factors.rows}", len(surface), total))
        print(rows[-1], factors.facts(), own, flush=True)
        if first is None:
            first = total
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    assert first is not None
    told = f"{len(surface):,} vertices, about {MAIN[1]} a cluster of {MAIN[0]} representatives"
    publish(
        "all frequency bytes",
        ("", "vertices", "raw, GB", "ω", "clusters", "clustered", "wavelets", "both", "in all",
         "squared error"),
        rows,
        f"{told}. Columns as in the paper's table 1: representatives of the raw bytes, what"
        " wavelets, 16 bits and sparse columns leave of them, both; then *in all*, with weights,"
        " lists and view factors.",
    )  # fmt: skip
    publish("all frequency stages", ("", "MB", "of raw", "squared error"), stage_rows(first),
            f"Cook-Torrance, bare; {told}.")  # fmt: skip
    publish(
        "all frequency time", ("", "seconds"),
        [[name, f"{taken:.0f}"] for name, taken in seconds.items()]
        + [["peak memory, GB", f"{peak:.2f}"]],
        f"Cook-Torrance, bare; {told}, {chosen.threads} threads.",
    )  # fmt: skip
    if not chosen.quick:
        curve(surface, seen, chosen.threads)


def curve(surface: Surface, seen: CubeVisibility, threads: int) -> None:
    """Error against bytes: several clusterings, and how much is left out."""
    brdf = MATERIALS["Cook-Torrance, bare"]
    found = encoded(surface, seen, row_factors(brdf), CURVE, tuple(sorted(ERRORS)), threads,
                    Counter())  # fmt: skip
    rows = []
    for way in CURVE:
        own = [found[*way, error] for error in sorted(ERRORS)]
        pairs = [f"{per_cent(one.error())}, {per_cent(one.share())}" for one in own]
        rows.append([f"{way[0]}, {way[1]}", per_cent(own[0].error("clustered")), *pairs])
    publish(
        "all frequency curve",
        ("representatives, vertices", "clusters alone",
         *(f"for {per_cent(error)}" for error in sorted(ERRORS))),
        rows,
        "Squared error, and bytes of raw with everything in. Numbers are left out until the"
        " error of the column is reached, where clusters leave room for it.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
