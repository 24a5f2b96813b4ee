"""What a frame costs of 1 to 100 characters, each in a pose of its own.

python bench/crowd.py [--write]
"""

from __future__ import annotations

import dataclasses
import time

import numpy as np
from tables import CHARACTERS, OUT, publish, scene_path

from prtnet.cli_view import cast_of
from prtnet.environment import environment
from runtime.gl import create_context
from runtime.show import Show
from runtime.studio import Studio
from runtime.view import View

COUNTS = (1, 3, 10, 30, 100)
SIZE = (1280, 720)
FRAMES = 8  # of which the first two warm up
STAGES = ("model", "pose", "upload", "draw")


def frames(show: Show, view: View) -> dict[str, float]:
    """Median milliseconds of a frame and of its stages while the clip plays."""
    context = show.context
    target = context.framebuffer([context.texture(SIZE, 4)])
    spent: list[dict[str, float]] = []
    for _ in range(FRAMES):
        view.advance(show.actor, 1.0 / 30.0)
        context.finish()
        started = time.perf_counter()
        show.draw(view, SIZE, target)
        context.finish()
        spent.append({**show.milliseconds, "frame": 1e3 * (time.perf_counter() - started)})
    target.release()
    return {
        stage: float(np.median([one.get(stage, 0.0) for one in spent[2:]]))
        for stage in (*STAGES, "frame")
    }


def main() -> None:
    """Every character of the benchmarks, in every number."""
    context, rows = create_context(), []
    with context:
        device = str(context.info["GL_RENDERER"])
        for name, (file, scene, clip) in CHARACTERS.items():
            show = Show(context, cast_of(OUT / file, scene_path(scene), 1, 2), Studio(environment))
            found = show.actor.scene.clip(clip)
            view = View(clip, found.start, brdf="gold", distance=3.0, playing=True)
            for count in COUNTS:
                own = dataclasses.replace(view, copies=count)
                spent = frames(show, own)
                rows.append([name, count, *(f"{spent[stage]:.2f}" for stage in spent),
                             f"{spent['frame'] / count:.2f}"])  # fmt: skip
                print(rows[-1], flush=True)
            show.release()
    context.release()
    columns = ("character", "how many", *STAGES, "frame", "frame, a character")
    size = f"{SIZE[0]} × {SIZE[1]}"
    publish("crowd", columns, rows, note=f"Milliseconds, {size}; OpenGL by {device}.")


if __name__ == "__main__":
    main()
