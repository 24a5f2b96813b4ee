"""Frames a second of all-frequency transfer, stage by stage: a light that turns, an eye that moves.

python bench/all_frequency_frames.py [FILE.safetensors] [--write]

Of a file from prtnet bake-all-frequency; without one, of made-up transfer of the paper's size and
of a given share of numbers that are not zero, which says what frames cost and shows nothing.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
import torch
import trimesh
from tables import gpu_milliseconds, publish

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment
from prtnet.all_frequency_file import load_fields, reached
from prtnet.cores import core_count
from prtnet.cube_map import segment_coefficients
from prtnet.environment import about_up, environment
from prtnet.sparse_columns import encode
from prtnet.tangents import any_tangent
from prtnet.transfer import Surface
from prtnet.truncation import truncated
from prtnet.turning_light import TurningLight
from runtime.all_frequency_shot import framing
from runtime.all_frequency_stage import AllFrequencyStage
from runtime.gl import create_context

SIZE = (640, 640)  # of pictures
FINEST = (0.02, 0.1, 0.25)  # shares of numbers that are not zero, of made-up transfer
KEPT = (1.0, 0.3, 0.1, 0.03)  # shares of the light's coefficients
ROWS, TERMS, CELLS, CLUSTER, REACHED = 10, 16, 32, 200, 0.56  # table 1 of the paper: bunny


def made_up(finest: float) -> AllFrequencyField:
    """A ball of 10,242 vertices and random transfer.

    Args:
        finest: share of the finest wavelets' numbers that are not zero; twice as many of the next.
    """
    rng = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(subdivisions=5)
    points = np.asarray(ball.vertices, dtype=np.float32)
    surface = Surface(points, points, any_tangent(points).astype(np.float32),
                      np.asarray(ball.faces, dtype=np.int32))  # fmt: skip
    row, column = np.mgrid[:16, :16]
    level = np.floor(np.log2(np.maximum(np.maximum(row, column), 1)))  # 3 for the finest
    share = np.minimum(finest * 2.0 ** (3.0 - level), 1.0).ravel()
    count = round(REACHED * len(points))
    starts = np.append(np.arange(0, count - CLUSTER // 2, CLUSTER), count).astype(np.int32)
    clusters = len(starts) - 1
    segments = []
    for _ in range(SEGMENTS):
        dense = rng.integers(-3000, 3001, (clusters * TERMS, ROWS, 256)).astype(np.int16)
        dense[rng.random(dense.shape) > share] = 0
        segments.append(
            Segment(
                rng.permutation(len(points))[:count].astype(np.int32), starts,
                rng.integers(-32767, 32768, (count, TERMS)).astype(np.int16),
                np.full((clusters, TERMS), 1 / 32767, dtype=np.float32),
                encode(dense.reshape(clusters * TERMS, -1)), 1e-3,
            )
        )  # fmt: skip
    view = rng.uniform(0.0, 1.0, (ROWS, CELLS * CELLS, 3)).astype(np.float32)
    return AllFrequencyField(surface, tuple(segments), view, 32)


def measured(field: AllFrequencyField, label: str, context: moderngl.Context) -> list[list[str]]:
    """Rows of the table, one for each share of the light's coefficients."""
    light = TurningLight(environment("studio"), field.size)
    camera = framing([field], 1.0, 0.5, 0.2)
    matrix, eye = camera.matrix(1.0), np.asarray(camera.eye)
    stage = AllFrequencyStage(context, field)
    frame = context.framebuffer(
        [context.texture(SIZE, 4, dtype="f2")], context.depth_renderbuffer(SIZE)
    )
    turn = gpu_milliseconds(lambda: light.at(about_up(33.0)), context)
    texels = light.at(about_up(33.0))
    turn += gpu_milliseconds(lambda: segment_coefficients(texels), context)
    steps = itertools.count()

    def draw() -> None:
        stage.draw(frame, matrix, eye + 1e-4 * next(steps))  # an eye that rests costs nothing

    frame.scissor = (0, 0, 1, 1)  # every vertex, one pixel
    seen = gpu_milliseconds(draw, context)
    frame.scissor = None

    def picture() -> None:
        frame.use()
        frame.clear(0.0, 0.0, 0.0, 0.0, depth=1.0)
        draw()

    drawn = max(0.0, gpu_milliseconds(picture, context) - seen)
    numbers = sum(len(one.representatives.values) for one in field.segments)
    whole = sum(np.prod(one.representatives.shape) for one in field.segments)
    full = f"{label}, {100 * numbers / whole:.0f} % not zero"
    rows = []
    for share in KEPT:
        some = truncated(segment_coefficients(texels), round(share * 6 * field.size**2))
        products = gpu_milliseconds(lambda: stage.products(some), context)  # noqa: B023
        lit = gpu_milliseconds(lambda: stage.light(some), context)  # noqa: B023
        sums = max(0.0, lit - products)
        shading = turn + products + sums + seen
        stages = [turn, products, sums, seen, drawn]
        rates = [1e3 / shading, 1e3 / (shading + drawn), 1e3 / seen, 1e3 / (seen + drawn)]
        rows.append([full, f"{100 * share:.0f} %", *(f"{ms:.1f}" for ms in stages),
                     *(f"{rate:.0f}" for rate in rates)])  # fmt: skip
        print(rows[-1], flush=True)
    stage.release()
    return rows


def main() -> None:
    """Measure, print and publish."""
    torch.set_num_threads(core_count())
    files = [Path(word) for word in sys.argv[1:] if not word.startswith("--")]
    context = create_context()
    fields: list[tuple[AllFrequencyField, str]] = [
        (load_fields(path)[0], path.stem) for path in files
    ] or [(made_up(finest), "made up") for finest in FINEST]
    rows: list[list[Any]] = []
    for field, label in fields:
        rows += measured(field, f"{label}, {len(field)} vertices", context)
    sizes = ", ".join(
        f"m = {one.rows}, n = {max(each.weights.shape[1] for each in one.segments)}, "
        f"{sum(each.clusters for each in one.segments)} clusters, ω = {100 * reached(one):.0f} %"
        for one, _ in fields[:1]
    )
    publish(
        "all-frequency-frames",
        ["transfer", "of light", "turn", "products", "sums", "view", "raster",
         "shading/s", "shading + draw/s", "view only/s", "view only + draw/s"],
        rows,
        f"Milliseconds, {SIZE[0]} × {SIZE[1]} pixels, one sample each; {sizes}; "
        f"{context.info['GL_RENDERER']}.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
