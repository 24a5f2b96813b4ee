"""The work of ``prtnet demo``: the other commands, one after another, on a bundled character."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

__all__ = ["demo_steps"]

# What the demonstration spends, in generate and in train.
DEMO_EFFORT = ["--fps", "8", "--rays", "256", "--sample", "150"]
DEMO_FIT = ["--preset", "small"]


def demo_steps(out: Path, held_out: Sequence[str]) -> list[list[str]]:
    """The command lines of the demonstration."""
    scene, data, model = (str(out / f"mannequin.{kind}") for kind in ("glb", "zarr", "safetensors"))
    holdout, errors = ",".join(held_out), str(out / "errors.json")
    picture = ["--clip", held_out[0], "--compare", "truth", "--out", str(out / "frame.png")]
    return [
        ["generate", scene, "--out", data, "--holdout", holdout, *DEMO_EFFORT],
        ["train", data, "--out", model, *DEMO_FIT],
        ["export", model, "--out", str(out / "export")],
        ["render", model, scene, *picture],
        ["evaluate", model, data, "--json", errors],
    ]
