"""What prtnet, its extras and its tests need, and what these need in turn, as installed here."""

from __future__ import annotations

import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

__all__ = ["PYTHONS", "REPOSITORY", "groups", "needed"]

REPOSITORY = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13")


def groups() -> dict[str, list[str]]:
    """Requirements of prtnet itself, named ``prtnet``, then of every extra."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {"prtnet": project["dependencies"], **project["optional-dependencies"]}


def needed(requirements: list[str], python: str) -> set[str]:
    """Canonical names of the packages that requirements ask for, in turn, on one Python.

    Raises:
        SystemExit: a package is not installed here, so that nobody knows what it needs.
    """
    version = {"python_version": python, "python_full_version": f"{python}.0"}
    asked, found = [(text, "") for text in requirements], set[tuple[str, str]]()
    while asked:
        text, extra = asked.pop()
        requirement = Requirement(text)
        if requirement.marker and not requirement.marker.evaluate({**version, "extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        for each in {"", *requirement.extras} - {had for what, had in found if what == name}:
            found.add((name, each))
            try:
                asked += [(line, each) for line in metadata.requires(name) or ()]
            except metadata.PackageNotFoundError:
                raise SystemExit(
                    f"{name}: is needed on Python {python} and not installed; install it"
                ) from None
    return {name for name, _ in found}
