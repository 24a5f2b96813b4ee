"""What prtnet is made of, and what it ships: pins, licences, distributions, vulnerabilities."""

from __future__ import annotations

import json
import sys
from email.message import Message
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from scripts.audit import UNCHECKED, verdict
from scripts.dependencies import groups, needed
from scripts.distributions import PACKAGES, strangers
from scripts.licences import COPYLEFT, PAGE, licence, page, unexplained
from scripts.pins import CONSTRAINTS, pins

# What is installed differs elsewhere: fewer back-ports, and a torch with CUDA.
HERE = sys.version_info[:2] == (3, 11)
EVERYTHING = [text for group in groups().values() for text in group] if HERE else []
as_pinned = pytest.mark.skipif(not HERE, reason="pins and licences are those of Python 3.11")


def package(**about: str) -> Any:
    """A distribution with such metadata."""
    message = Message()
    for name, value in about.items():
        message[name.replace("_", "-")] = value
    return SimpleNamespace(name="thing", metadata=message, files=[])


@as_pinned
def test_constraints_pin_everything_that_is_installed() -> None:
    assert pins() == CONSTRAINTS.read_text(encoding="utf-8"), "run `make pins`"


@as_pinned
def test_page_of_licences_is_of_what_is_installed() -> None:
    assert page() == PAGE.read_text(encoding="utf-8"), "run `make pins`"


@as_pinned
@pytest.mark.parametrize("name", sorted(needed(EVERYTHING, "3.11")))
def test_licence_asks_for_no_more_than_a_notice_or_has_a_note(name: str) -> None:
    assert unexplained(metadata.distribution(name)) == []


def test_dependencies_are_followed_through_extras_and_markers() -> None:
    assert {"pytest", "pluggy"} <= needed(["pytest"], "3.11")
    assert needed(["pluggy ; python_version < '3.12'"], "3.12") == set()
    assert "distributed" not in needed(["dask"], "3.11")
    assert "distributed" in needed(["dask", "dask[distributed]"], "3.11")
    with pytest.raises(SystemExit, match=r"no-such-thing: .* not installed"):
        needed(["no_such.thing"], "3.11")


def test_licences_are_read_from_metadata_of_every_age() -> None:
    assert licence(package(License_Expression="MIT OR Apache-2.0")) == "MIT OR Apache-2.0"
    assert licence(package(License="Apache 2.0")) == "Apache-2.0"
    classifier = "License :: OSI Approved :: MIT License"
    assert licence(package(License="The whole text", Classifier=classifier)) == "MIT"
    with pytest.raises(SystemExit, match="thing: says no licence"):
        licence(package(License="BSD"))


def test_copyleft_without_a_note_is_found() -> None:
    assert unexplained(package(License_Expression="MIT AND GPL-3.0-or-later")) == [
        "GPL-3.0-or-later"
    ]
    thing = package(License="MIT")
    thing.files = [Path("thing.libs/libx264-d6533a8d.so.165"), Path("thing/libgomp.so.1")]
    assert unexplained(thing) == ["libx264-d6533a8d.so.165", "libgomp.so.1"]
    assert not COPYLEFT.search("thing/libgompertz.so")


def test_strangers_in_a_distribution_are_found() -> None:
    files = {
        "prtnet/sh.py": b"x",
        "prtnet/py.typed": b"",
        "README.md": b"",
        "shared/robot.glb": b"",
        "prtnet/robot.glb": b"",
        "prtnet/paths.py": b"open('/home/somebody/x')",
    }
    found = strangers(files, PACKAGES, [Path("/home/somebody")])
    assert found == ["shared/robot.glb", "prtnet/robot.glb", "prtnet/paths.py"]


def test_audit_calls_nothing_clean_that_was_not_checked() -> None:
    fine = {"name": "a", "version": "1", "vulns": []}
    flaw = {"id": "CVE-1", "fix_versions": ["3"]}
    bad = {"name": "b", "version": "2", "vulns": [flaw]}
    lost = {"name": "c", "skip_reason": "not found"}

    def said(*packages: Any) -> tuple[int, str]:
        return verdict(json.dumps({"dependencies": packages}))

    assert said(fine) == (0, "no known vulnerability in 1 packages")
    assert said(fine, bad, lost) == (1, "b 2: CVE-1, mended in 3")
    assert said(fine, lost)[0] == said(lost)[0] == verdict("")[0] == UNCHECKED
    assert "could not be checked: c" in said(fine, lost)[1]
    assert "nothing was checked" in verdict("")[1]
    assert verdict("no JSON") == verdict("[]") == verdict("")
