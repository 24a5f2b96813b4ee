"""Write constraints.txt: every package at the version installed here (``make pins``)."""

from __future__ import annotations

from importlib import metadata

from packaging.version import Version

from scripts.dependencies import PYTHONS, REPOSITORY, groups, needed

__all__ = ["CONSTRAINTS", "pins"]

CONSTRAINTS = REPOSITORY / "constraints.txt"
HEAD = f"""\
# Written by `make pins`: all that prtnet, its extras and its tests need, on Linux and
# Python {PYTHONS[0]} to {PYTHONS[-1]}.
"""
# Why a version is held back or matters.
REASONS = {
    "av": "Movies: its wheels bring their own FFmpeg, with H.264.",
    "torch": "2.13.0 has a CPU wheel of modest size; newer default wheels bring gigabytes of CUDA.",
}


def pins() -> str:
    """The text of constraints.txt; a marker where only some Pythons need a package."""
    everything = [text for requirements in groups().values() for text in requirements]
    users: dict[str, list[str]] = {}
    for python in PYTHONS:
        for name in needed(everything, python):
            users.setdefault(name, []).append(python)
    lines = [HEAD]
    for name, pythons in sorted(users.items()):
        marker = " or ".join(f'python_version == "{python}"' for python in pythons)
        pin = f"{name}=={Version(metadata.version(name)).public}"
        lines += [f"# {REASONS[name]}\n"] if name in REASONS else []
        lines.append(f"{pin}\n" if len(pythons) == len(PYTHONS) else f"{pin} ; {marker}\n")
    return "".join(lines)


if __name__ == "__main__":
    CONSTRAINTS.write_text(pins(), encoding="utf-8")
