from __future__ import annotations

from pathlib import Path

from prtnet.errors import PrtnetError, nearest_name


def test_message_is_one_line() -> None:
    error = PrtnetError(Path("a/b.glb"), "first\n  second\tthird")
    assert str(error) == f"{Path('a/b.glb')}: first second third"
    assert (error.subject, error.message) == (str(Path("a/b.glb")), "first second third")


def test_nearest_name_suggests_a_close_one_and_lists_all() -> None:
    assert nearest_name("Wlak", ["Run", "Walk"]) == "did you mean 'Walk'? known: Run, Walk"


def test_nearest_name_suggests_nothing_that_is_far_off() -> None:
    assert nearest_name("zzz", iter(["Run", "Walk"])) == "known: Run, Walk"
    assert nearest_name("Walk", []) == "known: none"
