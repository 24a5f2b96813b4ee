"""Pictures of all-frequency transfer beside ray-traced truth, as in Liu et al. 2004.

python bench/all_frequency_pictures.py [--quick] [--write] [NAME ...]

The names are methods (figures 1 and 7 of "All-Frequency"), truncation (6), specularity (2 and 3),
clusters (4) and representatives (5); all when none is given. A bunny stands on a matte ground. The
truth is traced at the same vertices in the light itself, not in a cube map of it. Of *order 5* it
is the light that is projected on 25 harmonics, which is transfer projected on them: earlier PRT
with no loss in the harmonics of a BRDF. Errors are of pixels that are drawn, of white 1.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
import torch
from ldprt_pictures import save_figures, sheet
from materials import rms
from PIL import Image
from tables import per_cent, publish, scene_path

from data_gen.all_frequency import SAMPLES, ground, transfer_segments
from data_gen.coarse_mesh import coarser
from data_gen.cube_visibility import CubeVisibility, cube_visibility
from data_gen.radiance import trace_surface
from data_gen.static_mesh import read_mesh
from prtnet import sh
from prtnet.all_frequency import AllFrequencyField
from prtnet.all_frequency_factors import row_factors
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, CookTorrance, Lambert
from prtnet.cores import core_count
from prtnet.cube_map import SIZE, directions, segment_coefficients
from prtnet.environment import Environment, environment
from prtnet.presets import Lamp, Preset
from prtnet.transfer import Surface
from prtnet.truncation import area_weights, truncated
from prtnet.turning_light import TurningLight
from runtime.all_frequency import gathered, seen_from, transformed
from runtime.camera import Camera
from runtime.draw import averaged, finer
from runtime.picture import auto_exposure, colour_map, develop
from runtime.rasteriser import rasterise
from training.all_frequency import CompressConfig, compress

ORDER = 5
KEPT = 100  # wavelets of figure 1's truncated light
TRUNCATED = (50, 200, 800)
TERMS = (1, 4, 16)
ROUGHNESS = (0.1, 0.2, 0.4)
SEGMENTS_SHOWN = (2, 9, 17)
WIDE = 2.2  # the ground, in longest sides of the bunny
BLACK = (0.0, 0.0, 0.0)
GROUND = Lambert(0.5)
MATTE, GLOSSY = Lambert(0.7), CookTorrance(diffuse=0.1, specular=0.6, roughness=0.4)
MATERIALS: dict[str, BRDF] = {"matte": MATTE, "glossy": GLOSSY}


def small_lights(count: int = 40) -> Environment:
    """So many lights all around, as in figure 6: each about 4° across."""
    way = sh.fibonacci_sphere(count)
    around = np.degrees(np.arctan2(way[:, 0], way[:, 2]))
    up = np.degrees(np.arcsin(way[:, 1]))
    lamps = [Lamp(a, b, 1000.0, (25.0, 25.0, 25.0)) for a, b in zip(around, up, strict=True)]
    return Environment(Preset(tuple(lamps), BLACK, BLACK, BLACK))


LIGHTS = {"sun": environment("sun"), "40 small lights": small_lights()}


class Prop:
    """A bunny on a ground, baked when asked for.

    Args:
        vertices: of the bunny.
        quick: coarse in all else.
    """

    def __init__(self, vertices: int, quick: bool) -> None:
        self.size, self.rays = (160, 128) if quick else (270, 216), 64 if quick else 512
        self.texels, self.threads = 16 if quick else SIZE, core_count()
        mesh = coarser(read_mesh(scene_path("bunny.ply")), vertices)
        bunny = Surface(mesh.positions, mesh.normals, mesh.tangents, mesh.faces)
        self.parts = [bunny, ground(bunny, 40 if quick else 96, WIDE)]
        aspect = self.size[0] / self.size[1]
        self.camera = Camera.framing(bunny.positions, aspect, 0.35, 0.45, margin=1.35)
        self.eye = np.asarray(self.camera.eye)
        self.baked: dict[tuple[int, BRDF, int], AllFrequencyField] = {}
        self.lit: dict[tuple[int, str, BRDF, int], FloatArray] = {}

    @cached_property
    def seen(self) -> list[CubeVisibility]:
        """What the parts see."""
        found = []
        for part in self.parts:
            started = time.perf_counter()
            found.append(cube_visibility(part, self.parts, SAMPLES * self.texels, self.threads))
            print(f"visibility of {len(part)}: {time.perf_counter() - started:.0f} s", flush=True)
        return found

    def field(self, part: int, brdf: BRDF, terms: int = 16) -> AllFrequencyField:
        """Transfer as it is stored."""
        key = part, brdf, terms
        if key not in self.baked:
            rows = row_factors(brdf)
            given = self.parts[part], self.seen[part], rows, self.threads
            config = CompressConfig(terms, error=0.002)
            self.baked[key] = compress(
                lambda: transfer_segments(*given), self.parts[part], rows.view, self.texels, config
            )
            told = self.baked[key].metadata["squared_error"]["stored"]
            print(f"part {part}, {brdf}, {terms}: squared error {100 * told:.2f} %", flush=True)
        return self.baked[key]

    def drawn(self, colours: Sequence[FloatArray]) -> FloatArray:
        """The picture (H, W, 4) of radiance (P, 3) of the bunny, and of the ground if shown."""
        shown = self.parts[: len(colours)]
        starts = np.cumsum([0, *(len(one) for one in shown)])
        faces = [one.faces + start for one, start in zip(shown, starts, strict=False)]
        matrix = self.camera.matrix(self.size[0] / self.size[1])
        positions = np.concatenate([one.positions for one in shown])
        given = positions, np.concatenate(faces), np.concatenate(colours), matrix
        return averaged(rasterise(*given, finer(self.size, 4)), self.size)

    def shaded(self, brdf: BRDF, coefficients: FloatArray, terms: int = 16) -> FloatArray:
        """The picture in a light of wavelets."""
        fields = [self.field(0, brdf, terms), self.field(1, GROUND)]
        return self.drawn(
            [
                seen_from(one, gathered(one, transformed(one, coefficients)), self.eye)
                for one in fields
            ]
        )

    def traced(self, brdf: BRDF, light: str, seed: int = 0) -> FloatArray:
        """The picture by rays, in the light itself."""
        colours = []
        for number, material in enumerate((brdf, GROUND)):
            key = number, light, material, seed
            if key not in self.lit:
                given = self.parts[number], self.parts, self.eye, LIGHTS[light], material
                many = {"rays": self.rays, "threads": self.threads, "seed": seed}
                self.lit[key] = trace_surface(*given, **many)
            colours.append(self.lit[key])
        return self.drawn(colours)

    def wavelets(self, light: str) -> FloatArray:
        """The light as ``prtnet render`` takes it."""
        return segment_coefficients(TurningLight(LIGHTS[light], self.texels).at(np.eye(3)))

    def low(self, light: str) -> FloatArray:
        """The light of order 5."""
        where = directions(self.texels)
        found = sh.evaluate(where.reshape(-1, 3), ORDER) @ LIGHTS[light].harmonics(ORDER)
        return segment_coefficients(found.reshape(where.shape).astype(np.float32))


Row = tuple[list[FloatArray], list[str]]


def beside_truth(prop: Prop, light: str, brdf: BRDF, shown: Sequence[FloatArray]) -> Row:
    """Pictures developed alike, the truth first, and the errors of the others."""
    truth = prop.traced(brdf, light)
    exposure = auto_exposure(truth)
    errors = [per_cent(rms(one, truth, exposure)) for one in shown]
    return [develop(one, exposure) for one in (truth, *shown)], errors


def methods(prop: Prop) -> Image.Image:
    """Figures 1 and 7: order 5, a truncated light, and all of it, on matte and glossy."""
    rows, table = [], []
    for light in LIGHTS:
        bright = prop.wavelets(light)
        for name, brdf in MATERIALS.items():
            lights = prop.low(light), truncated(bright, KEPT), bright
            shown = [prop.shaded(brdf, one) for one in lights]
            again = prop.traced(brdf, light, seed=1)
            pictures, errors = beside_truth(prop, light, brdf, [*shown, again])
            rows.append(pictures[:-1])
            table.append([f"{name}, {light}", *errors])
            print(table[-1], flush=True)
    publish(
        "all frequency pictures",
        ("", f"order {ORDER}", f"{KEPT} wavelets", "all of the light", "traced again"),
        table,
        f"{len(prop.parts[0])} vertices of the bunny and {len(prop.parts[1])} of the ground,"
        f" {prop.size[0]} × {prop.size[1]} pixels, light of 6 × {prop.texels} × {prop.texels},"
        f" {prop.rays} rays a vertex of the truth.",
    )
    across = ["ray-traced", f"order {ORDER}", f"{KEPT} wavelets", "all of the light"]
    return sheet(rows, across, [f"{name}\n{light}" for light in LIGHTS for name in MATERIALS])


def truncation(prop: Prop) -> Image.Image:
    """Figure 6: fewer and more wavelets of 40 small lights, by magnitude times area."""
    light = "40 small lights"
    bright, areas = prop.wavelets(light), area_weights(prop.texels)
    some = [truncated(bright, count, areas) for count in TRUNCATED]
    shown = [prop.shaded(MATTE, one) for one in (*some, bright)]
    pictures, errors = beside_truth(prop, light, MATTE, shown)
    told = [*(f"{count} wavelets" for count in TRUNCATED), "all of them"]
    across = ["ray-traced", *(f"{one}, {error}" for one, error in zip(told, errors, strict=True))]
    return sheet([pictures], across, ["matte"])


def specularity(prop: Prop) -> Image.Image:
    """Figures 2 and 3: ten products of a BRDF, the narrower its highlight."""
    pictures, errors = [], []
    brdfs = [CookTorrance(diffuse=0.1, specular=0.6, roughness=one) for one in ROUGHNESS]
    for brdf in brdfs:
        own, error = beside_truth(prop, "sun", brdf, [prop.shaded(brdf, prop.wavelets("sun"))])
        pictures.append(own)
        errors += error
    across = [f"roughness {one:g}, {error}" for one, error in zip(ROUGHNESS, errors, strict=True)]
    rows = [[own[row] for own in pictures] for row in range(2)]
    return sheet(rows, across, ["ray-traced", "10 products"])


def representatives(prop: Prop) -> Image.Image:
    """Figure 5: few and more representatives of a cluster."""
    bright = prop.wavelets("sun")
    shown = [prop.shaded(GLOSSY, bright, terms) for terms in TERMS]
    pictures, errors = beside_truth(prop, "sun", GLOSSY, shown)
    across = ["ray-traced", *(f"n = {n}, {error}" for n, error in zip(TERMS, errors, strict=True))]
    return sheet([pictures], across, ["glossy"])


def clusters(prop: Prop) -> Image.Image:
    """Figure 4: clusters of three segments of light; black what it does not reach."""
    pictures = []
    for number in SEGMENTS_SHOWN:
        segment = prop.field(0, GLOSSY).segments[number]
        hue = np.random.default_rng(0).permutation(segment.clusters) + 1.0
        shades = np.zeros((len(prop.parts[0]), 3))
        shades[segment.vertices] = colour_map(hue / len(hue))[segment.labels()] / 255.0
        pictures.append(develop(prop.drawn([shades]), 1.0))
    across = [f"face {number // 4}, quarter {number % 4}" for number in SEGMENTS_SHOWN]
    return sheet([pictures], across, ["clusters"])


MADE: dict[str, Callable[[Prop], Image.Image]] = {
    "methods": methods,
    "truncation": truncation,
    "clusters": clusters,
    "representatives": representatives,
    "specularity": specularity,
}


def main() -> None:
    """The figures that are asked for."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("names", nargs="*", help="of figures")
    options.add_argument("--quick", action="store_true", help="coarse")
    options.add_argument("--write", action="store_true", help="put the table into the docs")
    options.add_argument("--vertices", type=int, help="of the bunny")
    chosen = options.parse_args()
    torch.set_num_threads(core_count())
    prop = Prop(chosen.vertices or (500 if chosen.quick else 2500), chosen.quick)
    made = {name: functools.partial(make, prop) for name, make in MADE.items()}
    save_figures("all_frequency", made, chosen.names)


if __name__ == "__main__":
    main()
