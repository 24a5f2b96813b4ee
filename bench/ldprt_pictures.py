"""Pictures of local transfer on surfaces that deform, for docs/figures.

python bench/ldprt_pictures.py [--quick] [NAME ...]

The names are patterns, mesh and character; all when none is given.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from collections.abc import Callable

import numpy as np
from PIL import Image, ImageDraw
from tables import ROOT, scene_path

from data_gen.bake import BakeConfig, bake_mesh, bake_patch, bake_wrinkle
from data_gen.procedural import mannequin
from data_gen.reliefs import PATTERNS, relief
from data_gen.static_mesh import StaticMesh, clean_mesh, read_mesh
from prtnet.arrays import FloatArray
from prtnet.canvas import Canvas, boxed, plane, vase
from prtnet.cores import core_count
from prtnet.environment import environment
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.membrane import membrane_field
from prtnet.transfer import TransferField
from prtnet.wrinkle import Wrinkle
from runtime.camera import Camera
from runtime.field_shot import FieldShot
from runtime.picture import INK, PAPER, auto_exposure, develop, font

FIGURES = ROOT / "docs" / "figures"
ORDER = 6
COUNTS = (1, 2, 4)
SIZE = (190, 230)
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
    size = min(texels, 32)
    made["wrinkle"] = bake_wrinkle(Wrinkle(0.1, 0.1, size, size), config(rays))
    return made


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


def patterns(quick: bool) -> Image.Image:
    """Few lobes, more, and full harmonics, on a twisted vase."""
    rows, names = [], []
    for name, field in fields(24 if quick else 64, 64 if quick else 512).items():
        canvas = (plane(1.0) if name == "wrinkle" else vase(6)).twisted(math.radians(60.0))
        one = shot(canvas)
        truth = one.draw(field)
        exposure = auto_exposure(truth)
        fitted = [lobe_field(field, count, name == "wrinkle") for count in COUNTS]
        pictures = [one.draw(lobes) for lobes in fitted]
        rows.append([develop(picture, exposure) for picture in (*pictures, truth)])
        names.append(f"{name}\n" + "\n".join(error_of(lobes) for lobes in fitted))
        print(name, [error_of(lobes) for lobes in fitted], flush=True)
    words = [f"{count} lobe{'s' * (count > 1)}" for count in COUNTS]
    return sheet(rows, [*words, "full harmonics, turned"], names)


def mesh(quick: bool) -> Image.Image:
    """A mesh that is twisted: traced again, transfer as it was, and lobes that turned."""
    whole = read_mesh(scene_path("bunny.ply"))
    found = thinned(whole, 60 if quick else 110)
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


def thinned(found: StaticMesh, cells: int) -> StaticMesh:
    """A mesh whose vertices are the middles of those in each cell of a grid."""
    low, span = found.positions.min(axis=0), float(np.ptp(found.positions, axis=0).max())
    cell = np.floor((found.positions - low) * (cells / span)).astype(np.int64)
    _, of = np.unique(cell, axis=0, return_inverse=True)
    of = of.ravel()
    count = np.bincount(of)
    places = np.stack([np.bincount(of, one) / count for one in found.positions.T], axis=-1)
    faces = of[found.faces]
    sides = [faces[:, a] != faces[:, b] for a, b in ((0, 1), (1, 2), (2, 0))]
    return clean_mesh("bunny", places, faces[np.logical_and.reduce(sides)])


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
    "patterns": patterns,
    "mesh": mesh,
    "character": character,
}


def main() -> None:
    """The figures that are asked for."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("names", nargs="*", help="of figures")
    options.add_argument("--quick", action="store_true", help="coarse")
    chosen = options.parse_args()
    for name in chosen.names or MADE:
        started = time.perf_counter()
        picture = MADE[name](chosen.quick)
        path = FIGURES / f"ldprt_{name}.png"
        picture.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.FLOYDSTEINBERG).save(
            path, optimize=True
        )
        print(f"{path}: {path.stat().st_size} bytes, {time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
