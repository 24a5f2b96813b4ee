"""The work of ``prtnet demo``: the other commands, one after another, on a bundled character."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

__all__ = ["demo_steps", "edge"]

# What the demonstration spends, in generate and in train.
DEMO_EFFORT = ["--fps", "8", "--rays", "256", "--sample", "150"]
DEMO_FIT = ["--preset", "small"]
QUICK_EFFORT = ["--fps", "2", "--rays", "32", "--sample", "8"]
QUICK_FIT = [*DEMO_FIT, "--clusters", "4", "--threads", "1"]  # too small for more threads


def edge(quick: bool) -> float:
    """Of the character's mesh, metres."""
    return 0.06 if quick else 0.016


def demo_steps(out: Path, held_out: Sequence[str], quick: bool = False) -> list[list[str]]:
    """The command lines of the demonstration, or of a coarse one in seconds."""
    effort, fit = (QUICK_EFFORT, QUICK_FIT) if quick else (DEMO_EFFORT, DEMO_FIT)
    scene, data, model = (str(out / f"mannequin.{kind}") for kind in ("glb", "zarr", "safetensors"))
    holdout, errors = ",".join(held_out), str(out / "errors.json")
    picture = ["--clip", held_out[0], "--compare", "truth", "--out", str(out / "frame.png")]
    return [
        ["generate", scene, "--out", data, "--holdout", holdout, *effort],
        ["train", data, "--out", model, *fit],
        ["export", model, "--out", str(out / "export")],
        ["render", model, scene, *picture],
        ["evaluate", model, data, "--json", errors],
    ]
