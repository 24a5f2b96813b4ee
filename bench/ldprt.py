"""Shading in deformed frames: lobes beside a rotation of full harmonics, counted and timed.

python bench/ldprt.py [--write] [--quick]

Either is drawn by OpenGL as well. And the two errors of glossy transfer: of the rows of a BRDF, and
of the lobes that fit them.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from tables import per_cent, publish
from turned_harmonics import TurnedHarmonics

from data_gen.bake import BakeConfig, bake_patch
from data_gen.reliefs import relief
from prtnet.arrays import FloatArray
from prtnet.brdf import CookTorrance
from prtnet.canvas import Canvas, vase
from prtnet.cores import core_count
from prtnet.environment import environment
from prtnet.glossy import brdf_rows
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.sh import evaluate
from prtnet.sh_rotation import rotate, rotate_zxzxz, zxzxz_multiplications
from prtnet.transfer import Surface, TransferField
from prtnet.zh import bands_apart
from runtime.camera import Camera
from runtime.gl import available, create_context, framed, pixels_of
from runtime.lobe_picture import drawn_by_numpy
from runtime.lobe_shading import LobeLight, light_table, rows_radiance
from runtime.lobe_stage import LobeStage

ORDER = 6
SIZE = (256, 256)


def field_of(canvas: Canvas, count: int) -> tuple[TransferField, LobeField]:
    """Transfer of leaning, half hidden places at the vertices of a mesh, and lobes of it."""
    random = np.random.default_rng(0)
    lean = 0.5 * random.normal(size=(64, 2, 3)) + [0.0, 0.0, 1.0]
    lean /= np.linalg.norm(lean, axis=-1, keepdims=True)
    g = np.array([0.9, 0.6, 0.25, 0.05, -0.04, -0.03])
    bands = np.repeat(g, 2 * np.arange(ORDER) + 1)
    vectors = (evaluate(lean, ORDER) * bands * [[0.7], [0.3]]).sum(axis=1)
    few = Surface(*(np.zeros((64, 3), np.float32),) * 3, np.zeros((0, 3), np.int32))
    lobes = lobe_field(TransferField(vectors[:, None].astype(np.float32), few), count)
    of = np.arange(len(canvas.positions)) % 64
    parts = [canvas.positions, canvas.normals, canvas.frames[..., 0]]
    layout = Surface(*(part.astype(np.float32) for part in parts), canvas.faces)
    raw = TransferField(vectors[of, None].astype(np.float32), layout)
    return raw, LobeField(lobes.low[of], lobes.axes[of], lobes.coefficients[of], layout)


def of_lobes(count: int, by_table: bool) -> int:
    """Multiplications of a matte point under light of three colours; square roots, arcs and the
    weights of a texture's filter aside.

    An axis is turned by 9. The linear band, where it is apart, is turned and multiplied likewise.
    """
    first = bands_apart(count)
    low = 3 + (9 + 9 if first == 2 else 0)
    each = 9 + 3 * (ORDER - first)
    if not by_table:
        basis = 3 * ORDER**2  # at most: y by recurrence
        each += basis + 3 * (ORDER**2 - first**2)
    return low + count * each


def milliseconds(work: Callable[[], object], times: int) -> float:
    """The median of some runs, after one to warm up."""
    work()
    spent = []
    for _ in range(times):
        started = time.perf_counter()
        work()
        spent.append(1e3 * (time.perf_counter() - started))
    return statistics.median(spent)


def by_gl(
    field: LobeField | TransferField, canvas: Canvas, light: LobeLight, by_table: bool, times: int
) -> float:
    """Milliseconds of a small picture, shaded per vertex; it is held against NumPy's first."""
    camera = Camera.framing(canvas.positions, 1.0)
    matrix, eye = camera.matrix(1.0), np.asarray(camera.eye)
    context = create_context()
    with contextlib.ExitStack() as made:
        made.callback(context.release)
        made.enter_context(context)
        frame = framed(context, SIZE, made)
        draw = drawing(context, field, canvas, light, by_table, made)

        def finished() -> None:
            draw(frame, matrix, eye)
            context.finish()

        finished()
        given = light if by_table else LobeLight(light.harmonics)
        want = drawn_by_numpy(field, canvas, given, eye, matrix, SIZE)
        missed = np.abs(pixels_of(frame, SIZE) - want).max(axis=-1)
        if np.mean(missed > 0.01 * want.max()) > 1e-3:
            raise SystemExit("OpenGL draws something else than NumPy: nothing measured")
        return milliseconds(finished, times)


def drawing(
    context: Any,
    field: LobeField | TransferField,
    canvas: Canvas,
    light: LobeLight,
    by_table: bool,
    made: contextlib.ExitStack,
) -> Callable[[Any, FloatArray, FloatArray], None]:
    """What draws a field on a context, of a frame, a matrix and an eye."""
    if isinstance(field, TransferField):
        turned = TurnedHarmonics(context, field.vectors, canvas, light.harmonics)
        return turned.draw
    stage = LobeStage(context, field, by_table)
    made.callback(stage.release)
    stage.light(light)
    stage.show(canvas)
    return stage.draw


def speed(quick: bool) -> None:
    """Lobes and full harmonics, per vertex of the same mesh."""
    canvas = dataclasses.replace(vase(4).twisted(1.0), places=None)
    times = 3 if quick else 15
    harmonics = environment("studio").harmonics(ORDER)
    direct = LobeLight(harmonics)
    table = LobeLight(harmonics, light_table(harmonics))
    frames = canvas.frames
    raw, _ = field_of(canvas, 1)
    vectors = raw.vectors.astype(np.float64)

    def rotated() -> FloatArray:
        return np.asarray(rotate_zxzxz(vectors, frames) @ harmonics)

    count = zxzxz_multiplications(ORDER) + 3 * ORDER**2
    gl = f"{by_gl(raw, canvas, direct, False, times):.1f}" if available() else "–"
    rows = [["full harmonics, turned (zxzxz)", count, f"{milliseconds(rotated, times):.1f}", gl]]
    print(rows[-1], flush=True)
    for lobes in (1, 3, 4):
        _, field = field_of(canvas, lobes)
        points = field.lobes
        for name, light in (("table", table), ("direct", direct)):
            by_table = light.table is not None

            def shaded(points=points, light=light) -> FloatArray:  # type: ignore[no-untyped-def]
                return rows_radiance(points, frames, light)

            gl = f"{by_gl(field, canvas, table, by_table, times):.1f}" if available() else "–"
            spent = f"{milliseconds(shaded, times):.1f}"
            words = f"{lobes} lobe{'s' * (lobes > 1)}, {name}"
            rows.append([words, of_lobes(lobes, by_table), spent, gl])
            print(rows[-1], flush=True)
    publish(
        "ldprt", ("per vertex", "multiplications", "NumPy, ms", "OpenGL, ms"), rows,
        f"A matte mesh of {len(canvas.positions):,} vertices, order {ORDER}, light of three"
        f" colours. Multiplications of one vertex: of the table without those of a texture's"
        f" filter, directly with three for each function of the basis. NumPy shades the vertices;"
        f" OpenGL shades and draws {SIZE[0]}×{SIZE[1]} pixels.",
    )  # fmt: skip


def relative(missed: FloatArray, whole: FloatArray, lights: FloatArray) -> float:
    """Relative RMS of rows (…, n²) under lights (n², M), all views together: u is orthonormal."""
    return float(np.linalg.norm(missed @ lights) / np.linalg.norm(whole @ lights))


def glossy(quick: bool) -> None:
    """What rows leave of a BRDF, and what lobes leave of its rows."""
    order, count = 4, 3
    turns = Rotation.random(12 if quick else 48, rng=0).as_matrix()
    studio = rotate(environment("studio").harmonics(order).T, turns[:, None])  # [turns, 3, n²]
    lights = [np.eye(order**2), studio.reshape(-1, order**2).T]
    texels = 12 if quick else 48
    heights = 0.02 * relief("bumps", (texels, texels))
    rows = []
    for name, slope in (("0.3", 0.3), ("√0.3", 0.3**0.5)):
        brdf = CookTorrance(roughness=slope)
        every = brdf_rows(brdf, order**2, order).harmonics(order)
        errors = [relative(every[count:], every, light) for light in lights]
        rows.append([f"slope {name}, {count} rows", *map(per_cent, errors)])
        print(rows[-1], flush=True)
        settings = BakeConfig(
            order=order, rays=128 if quick else 1024, glossy=brdf_rows(brdf, count, order),
            threads=core_count(),
        )  # fmt: skip
        field = bake_patch(heights, (0.1, 0.1), (True, True), settings)
        for lobes in (1, 2, 3, 4):
            missed = lobe_field(field, lobes).lobes.harmonics() - field.transfer
            errors = [relative(missed, field.transfer, light) for light in lights]
            rows.append([f"further, {lobes} lobe{'s' * (lobes > 1)} a row", *map(per_cent, errors)])
            print(rows[-1], flush=True)
    publish(
        "glossy ldprt", ("", "light of any kind", "`studio`"), rows,
        f"Cook–Torrance, light of order {order}, {count} rows. The rows' error is of an open place,"
        f" over views and lights; that of lobes is of the rows of {texels}×{texels} texels of"
        f" bumps, shadowed and with bounces. Relative RMS: of all coefficients of light alike, and"
        f" under the preset turned {len(turns)} ways.",
    )  # fmt: skip


def main() -> None:
    """Both tables."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--write", action="store_true", help="put the tables into the docs")
    options.add_argument("--quick", action="store_true", help="fewer of everything")
    chosen = options.parse_args()
    speed(chosen.quick)
    glossy(chosen.quick)


if __name__ == "__main__":
    main()
