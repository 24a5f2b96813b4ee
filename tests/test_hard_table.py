"""The checks of hard cases fail where they must, and the page tells the nearest to its limit."""

from __future__ import annotations

import math

import pytest
import torch

from prtnet.errors import PrtnetError
from tests.hard_cases.measured import (
    CHECKS,
    REFUSED,
    Check,
    above,
    at_least,
    at_most,
    below,
    close,
    equal,
    finite,
    refuses,
    says,
)
from tests.hard_cases.table import Result, page


@pytest.mark.parametrize(
    ("check", "given"),
    [
        (below, (1.0, 1.0)), (below, (math.nan, 1.0)), (at_most, ([0.0, 2.0], 1.0)),
        (above, (1.0, 1.0)), (at_least, (math.nan, 0.0)), (finite, ([0.0, math.inf],)),
        (equal, ([1.0, 2.0], [1.0, 3.0])), (close, (1.0 + 1e-6, 1.0)),
        (close, (1e6 + 0.2, 1e6, None, 0.1)), (close, (torch.ones(2), math.nan)),
        (says, ("x: is wrong\nand long", "wrong")), (says, ("x: is right", "wrong")),
    ],
)  # fmt: skip
def test_checks_fail(check, given):
    with pytest.raises(AssertionError):
        check(*given)


def test_a_check_keeps_the_worst_of_its_line():
    CHECKS.clear()
    for error in (1e-4, 3e-3, 2e-5):
        below(2.0 * error, 1e-2)
    close(torch.tensor([1.0, 2.02]), [1.0, 2.0], 0.1)
    for name in ("/tmp/a.glb", "/tmp/b.glb"):
        with refuses(match="odd"):
            raise PrtnetError(name, "is odd beside '/tmp/c.bin'")
    first, second, third = CHECKS.values()
    assert first[1:4] == ("`2.0 * error`", "0.006", "< 0.01")
    assert first.nearness == pytest.approx(0.6)
    assert second[1:4] == ("error of `torch.tensor([1.0, 2.02])`", "0.01", "≤ 0.1 of it")
    assert third[1:] == ("", "is odd beside 'c.bin'", REFUSED, 0.0)


def test_the_page_has_a_line_for_every_check_and_type():
    def result(name, line, kind, *checks, ran=True):
        return Result("sh", name, line, kind, checks, ran)

    def error(measured, nearness):
        return Check(9, "`a | b`", measured, "< 1", nearness)

    text = page([
        result("it_holds", 7, ""), result("not_here", 8, "", ran=False),
        result("near", 3, "float64", error("0.1", 0.1)),
        result("near", 3, "float32", error("0.2", 0.2)), result("near", 3, "float32",
                                                                error("0.9", 0.9)),
        result("bad", 1, "", Check(4, "", "b", REFUSED, 0.0), Check(5, "", "a", REFUSED, 0.0)),
    ])  # fmt: skip
    rows = [line for line in text.splitlines() if line.startswith("| ")][1:]
    assert rows == [
        "| bad |  |  | a … and 1 more | refused |",
        "| near | `a \\| b` | float32 | 0.9 | < 1 |",
        "|  | `a \\| b` | float64 | 0.1 | < 1 |",
        "| it holds |  |  | holds |  |",
        "| not here |  |  | not run here |  |",
    ]
    assert "## Spherical harmonics" in text
