"""What the benchmarks share: the sample scenes, datasets made once, and tables for the docs.

A script prints its table and, with ``--write``, puts it into docs/benchmarks.md between the
markers of its name.
"""

from __future__ import annotations

import datetime
import os
import platform
import re
import statistics
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from data_gen.generate import GenerateConfig, generate
from data_gen.readers import read_scene
from prtnet.arrays import FloatArray
from prtnet.dataset import Dataset
from prtnet.metrics import ErrorSum

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT.parent / "shared" / "data"
OUT = ROOT / "bench" / "out"
PAGE = ROOT / "docs" / "benchmarks.md"

ROBOT_HELD_OUT = ("Robot_WalkJump", "Robot_Yes", "Robot_No", "Robot_Standing")
ROBOT = GenerateConfig(count=20, holdout=ROBOT_HELD_OUT)
CLOTH = GenerateConfig(fps=15, two_sided=True, holdout=("cloth_train@9:12",))
HUMAN = GenerateConfig(fps=8, holdout=("Playground_A",), sample=600)
CHARACTERS = {
    "robot": ("robot neural, occluders.safetensors", "robot.glb", "Robot_WalkJump"),
    "human": (
        "human clips and 600 sampled poses, neural, occluders, 14 latents.safetensors",
        "human.glb", "Playground_A",
    ),
}  # fmt: skip
"""Models made by models.py, their scenes, and clips that they have not seen."""


def scene_path(name: str) -> Path:
    """A sample scene; the script ends with a word where it is absent."""
    path = SCENES / name
    if not path.exists():
        print(f"{path} is absent: nothing measured")
        sys.exit(0)
    return path


def gpu_milliseconds(work: Callable[[], object], context: Any, repeats: int = 30) -> float:
    """Median, until the GPU of an OpenGL context is done."""
    taken = []
    for _ in range(repeats + 3):
        context.finish()
        started = time.perf_counter()
        work()
        context.finish()
        taken.append(time.perf_counter() - started)
    return 1e3 * statistics.median(taken[3:])


def dataset(name: str, scene: str, config: GenerateConfig) -> Dataset:
    """The named dataset under bench/out, made when it is not there."""
    path = OUT / f"{name}.zarr"
    if not path.exists() or not made_with(Dataset.open(path), config):
        OUT.mkdir(parents=True, exist_ok=True)
        source = read_scene(scene_path(scene))

        def report(what: str, done: int, total: int, detail: str = "") -> None:
            print(f"\r{name}: {what} {done}/{total} {detail}", end="")

        generate(source, config, path, report)
        print()
    return Dataset.open(path)


def made_with(data: Dataset, config: GenerateConfig) -> bool:
    """Whether a dataset was generated with these options."""
    wanted = {
        "order": config.order, "rays": config.rays, "sample": config.sample, "seed": config.seed,
        "margin": config.margin, "fps": config.rate, "count": config.count,
        "held_out": list(config.holdout), "two_sided": config.two_sided,
    }  # fmt: skip
    return all(data.attributes.get(name) == value for name, value in wanted.items())


def held_out_errors(
    data: Dataset, predict: Callable[[FloatArray], FloatArray], every: int = 1
) -> dict[str, float]:
    """``rms``, ``p99`` and ``max`` of predictions of every so many held-out poses."""
    total, rows = ErrorSum(), data.held_out_poses()[::every]
    for start in range(0, len(rows), 8):
        block = rows[start : start + 8]
        total.add(predict(data.read("pose", block)), data.read("visibility", block))
    return total.summary()


def machine() -> str:
    """Processor, cores and date: a table without them means nothing."""
    model = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").exists():
        found = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text())
        model = found.group(1) if found else model
    cores = len(os.sched_getaffinity(0))
    return f"{model}, {cores} core{'s' * (cores > 1)}, {datetime.date.today():%Y-%m-%d}"


def markdown(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table; every column but the first is flush right."""
    head = "| " + " | ".join(columns) + " |"
    rule = "|---|" + "---:|" * (len(columns) - 1)
    return "\n".join([head, rule, *("| " + " | ".join(map(str, row)) + " |" for row in rows)])


def publish(
    name: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[object]],
    note: str = "",
    page: Path = PAGE,
    figure: str = "",
) -> None:
    """Print a table; with ``--write`` on the command line also put it into a page of the docs."""
    parts = [markdown(columns, rows), figure, f"{note} ({machine()})".strip()]
    text = "\n\n".join(part for part in parts if part)
    print(text)
    if "--write" not in sys.argv:
        return
    begin, end = f"<!-- begin {name} -->", f"<!-- end {name} -->"
    words = page.read_text(encoding="utf-8")
    if begin not in words or end not in words:
        sys.exit(f"{page} has no markers for '{name}'")
    before, rest = words.split(begin)
    page.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def per_cent(value: float | None) -> str:
    """A fraction as a reader wants it."""
    return "–" if value is None else f"{100 * value:.2f} %"
