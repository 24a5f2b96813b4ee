"""Pictures of local transfer on surfaces that deform, for docs/figures.

python bench/ldprt_pictures.py [--quick] [NAME ...]

The names are fits, glossy, patterns, mesh and character, for the figures 3, 4, 5 and 7, 6, and 1 of
"LDPRT"; all when none is given.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from PIL import Image, ImageDraw
from tables import ROOT, scene_path

from data_gen.bake import BakeConfig, bake_mesh, bake_patch, bake_wrinkle
from data_gen.coarse_mesh import coarser
from data_gen.procedural import mannequin
from data_gen.reliefs import PATTERNS, relief
from data_gen.static_mesh import StaticMesh, clean_mesh, read_mesh
from prtnet.arrays import FloatArray
from prtnet.brdf import CookTorrance
from prtnet.canvas import Canvas, boxed, vase
from prtnet.cores import core_count
from prtnet.environment import environment
from prtnet.glossy import brdf_rows
from prtnet.lobe_field import LobeField, halved
from prtnet.lobe_fit import lobe_field
from prtnet.membrane import membrane_field
from prtnet.sh import evaluate
from prtnet.transfer import TransferField
from prtnet.wrinkle import Wrinkle
from prtnet.zh import Lobes, apart, best_coefficients
from prtnet.zh_fit import linear_axes
from runtime.camera import Camera
from runtime.field_shot import FieldShot
from runtime.picture import INK, PAPER, auto_exposure, develop, font

FIGURES = ROOT / "docs" / "figures"
ORDER = 6
COUNTS = (1, 2, 4)
SIZE = (190, 230)
GROOVE, SWING = 0.35, 0.12  # width of a groove around a vase of height 1, and how far it goes up
LIGHT = environment("sun").turned(-30.0)


def config(rays: int) -> BakeConfig:
    """What is simulated."""
    return BakeConfig(order=ORDER, rays=rays, threads=core_count())


def fields(texels: int, rays: int) -> dict[str, TransferField]:
    """Transfer of all patterns and parametric models."""
    made = {}
    for name in PATTERNS:
        heights = 0.01 * relief(name, (texels, texels))
        made[name] = bake_patch(heights, (0.1, 0.1), (True, True), config(rays))
    share = 0.5 + 0.5 * np.cos(2.0 * math.pi * np.arange(32) / 32)
    made["membrane"] = membrane_field(np.outer(share, share), (0.1, 0.1), ORDER, 0.8)
    made["wrinkle"] = bake_wrinkle(wrinkle_of(texels), config(rays))
    return made


def wrinkle_of(texels: int) -> Wrinkle:
    """Grooves up to as deep as they are wide."""
    size = min(texels, 32)
    return Wrinkle(0.1, 0.1, size, size)


def grooved(family: Wrinkle) -> Canvas:
    """A vase with a groove around it, up and down twice, deep in front and flat at the back."""
    smooth = vase(1)
    phi = np.arctan2(smooth.positions[:, 0], smooth.positions[:, 2])
    scale = family.width / GROOVE  # metres of the groove over units of the vase
    across = scale * (smooth.positions[:, 1] - SWING * np.sin(2.0 * phi)) + 0.5 * family.width
    depth = family.deepest * np.cos(0.5 * phi) ** 2
    # Across the groove is up, and against the way it climbs.
    radius = np.hypot(smooth.positions[:, 0], smooth.positions[:, 2])
    climb = 2.0 * SWING * np.cos(2.0 * phi) / radius
    around = smooth.frames[..., 0]
    upward = smooth.frames[..., 1]
    places = family.coordinates(across, depth)
    return dataclasses.replace(smooth, tangents=upward - climb[:, None] * around, places=places)


def shot(canvas: Canvas, size: tuple[int, int] = SIZE) -> FieldShot:
    """A picture of a canvas."""
    camera = Camera.framing(canvas.positions, size[0] / size[1], math.radians(25.0), 0.2)
    return FieldShot(canvas, LIGHT.harmonics(ORDER), camera, size)


def sheet(rows: list[list[FloatArray]], across: list[str], along: list[str]) -> Image.Image:
    """Pictures (H, W, 3) in rows, with words above and beside them."""
    height, width = rows[0][0].shape[:2]
    left, top, gap = 14 + 8 * max(len(line) for words in along for line in words.split("\n")), 24, 4
    page = Image.new(
        "RGB", (left + len(across) * (width + gap), top + len(rows) * (height + gap)), PAPER
    )
    pen = ImageDraw.Draw(page)
    for column, words in enumerate(across):
        pen.text((left + column * (width + gap) + 4, 4), words, INK, font(13))
    for row, (words, pictures) in enumerate(zip(along, rows, strict=True)):
        pen.text((6, top + row * (height + gap) + height / 2), words, INK, font(13))
        for column, picture in enumerate(pictures):
            place = left + column * (width + gap), top + row * (height + gap)
            page.paste(Image.fromarray(picture), place)
    return page


def error_of(lobes: LobeField) -> str:
    """The error of a fit, in words."""
    return f"{100.0 * lobes.metadata['fit']['error']:.1f} %"


def lobe_words(count: int) -> str:
    """How many lobes, in words."""
    return f"{count} lobe{'s' * (count > 1)}"


def patterns(quick: bool) -> Image.Image:
    """Few lobes, more, and full harmonics, on a twisted vase."""
    rows, names = [], []
    texels = 24 if quick else 64
    for name, field in fields(texels, 64 if quick else 512).items():
        canvas = grooved(wrinkle_of(texels)) if name == "wrinkle" else vase(6)
        canvas = canvas.twisted(math.radians(60.0))
        one = shot(canvas)
        truth = one.draw(field)
        exposure = auto_exposure(truth)
        fitted = [lobe_field(field, count, name == "wrinkle") for count in COUNTS]
        pictures = [one.draw(lobes) for lobes in fitted]
        rows.append([develop(picture, exposure) for picture in (*pictures, truth)])
        names.append(f"{name}\n" + "\n".join(error_of(lobes) for lobes in fitted))
        print(name, [error_of(lobes) for lobes in fitted], flush=True)
    return sheet(rows, [*map(lobe_words, COUNTS), "full harmonics, turned"], names)


def mesh(quick: bool) -> Image.Image:
    """A mesh that is twisted: traced again, transfer as it was, and lobes that turned."""
    whole = read_mesh(scene_path("bunny.ply"))
    found = coarser(whole, 2_000 if quick else 8_000)
    rays = 64 if quick else 512
    field = bake_mesh(found, config(rays))
    rest = Canvas(found.positions, found.tangents, found.normals, found.faces)
    canvas = rest.twisted(math.radians(120.0))
    parts = (canvas.positions, canvas.normals, canvas.frames[..., 0])
    posed = StaticMesh(*(part.astype(np.float32) for part in parts), found.faces, found.vertices)  # type: ignore[arg-type]
    truth = shot(canvas).draw(bake_mesh(posed, config(rays)))
    exposure = auto_exposure(truth)
    fitted = [lobe_field(field, count) for count in (1, 3)]
    # Where it is now, but in the frames of where it was.
    frames = dataclasses.replace(canvas, tangents=rest.tangents, normals=rest.normals)
    pictures = [truth, dataclasses.replace(shot(canvas), canvas=frames).draw(field)]
    pictures += [shot(canvas).draw(lobes) for lobes in fitted]
    words = ["ray-traced as posed", "transfer as at rest", "1 lobe", "3 lobes"]
    drawn = pictures[0][..., 3] > 0
    for name, picture in zip(words, pictures, strict=True):
        missed = exposure * (picture - pictures[0])[drawn, :3]
        print(name, f"rms {100 * np.sqrt(np.mean(missed**2)):.2f} % of white", flush=True)
    return sheet([[develop(picture, exposure) for picture in pictures]], words, ["twisted"])


def fits(quick: bool) -> Image.Image:
    """A mesh by its optimal linear lobes, by one lobe and more, and by full harmonics."""
    found = coarser(read_mesh(scene_path("bunny.ply")), 2_000 if quick else 8_000)
    field = bake_mesh(found, config(64 if quick else 512))
    canvas = Canvas(found.positions, found.tangents, found.normals, found.faces)
    target = field.transfer.astype(np.float64)
    axes = linear_axes(target[:, 0])[:, None, None]
    about = Lobes(axes, best_coefficients(evaluate(axes, ORDER), target))
    linear = halved("bunny", apart(target, about))
    missed = np.linalg.norm(linear.harmonics() - target) / np.linalg.norm(target)
    fitted = [lobe_field(field, count) for count in COUNTS]
    facts = {"fit": {"error": float(missed)}}
    parts = linear.low, linear.lobes.axes, linear.lobes.coefficients
    shown = [LobeField(*parts, field.layout, metadata=facts), *fitted]
    one = shot(canvas)
    truth = one.draw(field)
    exposure = auto_exposure(truth)
    pictures = [develop(picture, exposure) for picture in (*map(one.draw, shown), truth)]
    words = ["linear lobe", *map(lobe_words, COUNTS)]
    across = [f"{name}: {error_of(lobes)}" for name, lobes in zip(words, shown, strict=True)]
    print(across, flush=True)
    return sheet([pictures], [*across, "full harmonics"], [""])


def glossy(quick: bool) -> Image.Image:
    """Glossy transfer by all rows of a BRDF, by three, and by lobes of the three."""
    order, count, texels = 4, 3, 24 if quick else 64
    rows = brdf_rows(CookTorrance(roughness=0.3), order**2, order)
    settings = dataclasses.replace(config(64 if quick else 512), order=order, glossy=rows)
    whole = bake_patch(0.01 * relief("bumps", (texels, texels)), (0.1, 0.1), (True, True), settings)
    assert whole.view is not None
    few = dataclasses.replace(whole, transfer=whole.transfer[:, :count], view=whole.view[:count])
    lobes = lobe_field(few, 3)
    canvas = vase(6).twisted(math.radians(60.0))
    one = dataclasses.replace(shot(canvas), light=LIGHT.harmonics(order))
    drawn = [one.draw(field) for field in (whole, few, lobes)]
    exposure = auto_exposure(drawn[0])
    inside = drawn[0][..., 3] > 0
    size = np.sqrt(np.mean(np.square(drawn[0][inside, :3])))
    missed = [
        float(np.sqrt(np.mean(np.square((other - before)[inside, :3]))) / size)
        for before, other in itertools.pairwise(drawn)
    ]
    across = ["16 rows", f"3 rows: {missed[0]:.1%}", f"3 lobes a row: {missed[1]:.1%} more"]
    print(across, flush=True)
    return sheet([[develop(picture, exposure) for picture in drawn]], across, [""])


def character(quick: bool) -> Image.Image:
    """A weave on a character that moves."""
    scene = mannequin()
    rest = scene.rest()
    found = clean_mesh("mannequin", rest.positions[0], scene.faces, rest.normals[0])
    heights = 0.008 * relief("weave", (32, 32))
    field = bake_patch(heights, (0.1, 0.1), (True, True), config(64 if quick else 512))
    canvas, source = boxed(found.positions, found.normals, found.faces, (0.12, 0.12))
    lobes = lobe_field(field, 4)
    pictures = []
    for clip in scene.clips[:4]:
        time_ = np.array([0.4 * clip.start + 0.6 * clip.end])
        posed = scene.geometry(scene.poses(clip, time_))
        of = found.vertices[source]
        moved = canvas.moved(posed.positions[0, of], posed.normals[0, of])
        picture = shot(moved, (200, 320)).draw(lobes)
        pictures.append(develop(picture, auto_exposure(picture)))
    return sheet([pictures], [clip.name for clip in scene.clips[:4]], ["4 lobes"])


MADE: dict[str, Callable[[bool], Image.Image]] = {
    "fits": fits,
    "glossy": glossy,
    "patterns": patterns,
    "mesh": mesh,
    "character": character,
}


def save_figures(
    prefix: str, made: Mapping[str, Callable[[], Image.Image]], names: Sequence[str]
) -> None:
    """Make figures and put them into the docs: those that are named, or all."""
    for name in names or made:
        started = time.perf_counter()
        path = FIGURES / f"{prefix}_{name}.png"
        picture = made[name]()
        picture.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.FLOYDSTEINBERG).save(
            path, optimize=True
        )
        print(f"{path}: {path.stat().st_size} bytes, {time.perf_counter() - started:.0f} s")


def main() -> None:
    """The figures that are asked for."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("names", nargs="*", help="of figures")
    options.add_argument("--quick", action="store_true", help="coarse")
    chosen = options.parse_args()
    made = {name: functools.partial(make, chosen.quick) for name, make in MADE.items()}
    save_figures("ldprt", made, chosen.names)


if __name__ == "__main__":
    main()
