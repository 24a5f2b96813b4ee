"""Checks that keep what they measured and how much was allowed, for the table of hard cases."""

from __future__ import annotations

import ast
import contextlib
import linecache
import re
import sys
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from prtnet.errors import PrtnetError


class Check(NamedTuple):
    """What one line of a test measured, where it came nearest to its limit."""

    line: int
    quantity: str
    measured: str
    limit: str
    nearness: float  # 0: nothing missed, 1: at the limit


REFUSED = "refused"
CHECKS: dict[tuple[int, str], Check] = {}
"""Of the test that is running: for each line the nearest to its limit, or every refusal."""


def close(actual: Any, desired: Any, rtol: float | None = None, atol: float = 0.0) -> None:
    """|actual − desired| ≤ atol + rtol · |desired| everywhere; rtol is 1e-7 where atol is 0."""
    rtol = (0.0 if atol else 1e-7) if rtol is None else rtol
    found, wanted = numbers(actual), numbers(desired)
    np.testing.assert_allclose(found, wanted, rtol, atol)
    sound = np.isfinite(wanted) & np.isfinite(found)
    if not sound.any():
        return
    found, wanted = np.broadcast_arrays(found, wanted)
    found, wanted = (a[sound].astype(np.float64) for a in (found, wanted))
    missed, allowed = np.abs(found - wanted), atol + rtol * np.abs(wanted)
    share = np.divide(missed, allowed, out=np.zeros_like(missed), where=allowed > 0.0)
    worst = share.argmax()
    if atol == 0.0:
        keep(short(share[worst] * rtol), f"≤ {short(rtol)} of it", share[worst], "error of `{}`")
    else:
        keep(short(missed[worst]), f"≤ {short(allowed[worst])}", share[worst], "error of `{}`")


def equal(actual: Any, desired: Any) -> None:
    """The same numbers everywhere, as NumPy's assert_array_equal."""
    np.testing.assert_array_equal(numbers(actual), numbers(desired))
    keep("equal", "equal", 0.0)


def finite(values: Any) -> None:
    """Neither infinite nor NaN anywhere."""
    assert np.isfinite(numbers(values)).all()
    keep("finite", "finite", 0.0)


def below(value: Any, limit: Any) -> None:
    """Less, everywhere."""
    compare(value, limit, np.less, "<")


def at_most(value: Any, limit: Any) -> None:
    """Less or equal, everywhere."""
    compare(value, limit, np.less_equal, "≤")


def above(value: Any, limit: Any) -> None:
    """Greater, everywhere."""
    compare(value, limit, np.greater, ">")


def at_least(value: Any, limit: Any) -> None:
    """Greater or equal, everywhere."""
    compare(value, limit, np.greater_equal, "≥")


@contextlib.contextmanager
def refuses(
    error: type[Exception] = PrtnetError, match: str | None = None
) -> Iterator[pytest.ExceptionInfo[Exception]]:
    """What is inside must raise this; the message goes into the table."""
    with pytest.raises(error, match=match) as caught:
        yield caught
    keep_words(str(caught.value))


def says(message: str, words: str) -> None:
    """One line with these words, as it is told to the user or as the exception holds it."""
    assert words in message
    assert "\n" not in message.removesuffix("\n")
    keep_words(message)


def compare(value: Any, limit: Any, holds: Callable[..., Any], sign: str) -> None:
    """An inequality at every place."""
    found, bound = np.broadcast_arrays(numbers(value), numbers(limit))
    true = holds(found, bound)
    assert true.all(), f"{found[~true][0]} is not {sign} {bound[~true][0]}"
    if not true.size:
        return
    found, bound = found.astype(np.float64), bound.astype(np.float64)
    gap, size = np.abs(found - bound), np.maximum(np.abs(found), np.abs(bound))
    share = 1.0 - np.divide(gap, size, out=np.ones_like(gap), where=size > 0.0)
    worst = np.unravel_index(share.argmax(), share.shape)
    keep(short(found[worst]), f"{sign} {short(bound[worst])}", share[worst])


def short(value: float) -> str:
    """Three digits, or the whole part: what is near its limit should not look like it."""
    return f"{value:.0f}" if 1000.0 <= abs(value) < 1e6 else f"{value:.3g}"


def numbers(values: Any) -> np.ndarray:
    """A NumPy array of what may be a tensor on any device."""
    return values.detach().cpu().numpy() if isinstance(values, torch.Tensor) else np.asarray(values)


def keep(measured: str, limit: str, nearness: float, form: str = "`{}`") -> None:
    """Remember a check, and the source of what it checked."""
    frame = caller()
    known = CHECKS.get((frame.f_lineno, ""))
    if known is None or nearness > known.nearness:
        quantity = form.format(first_argument(frame))
        CHECKS[frame.f_lineno, ""] = Check(
            frame.f_lineno, quantity, measured, limit, float(nearness)
        )


def keep_words(message: str) -> None:
    """Remember a refusal without the file that it names, which is another every time."""
    message = message.strip().removeprefix("prtnet: error: ")
    subject, _, rest = message.partition(": ")
    message, line = rest if rest and "/" in subject else message, caller().f_lineno
    message = re.sub(r"/[^\s']*/", "", message)
    CHECKS[line, message] = Check(line, "", message, REFUSED, 0.0)


def caller() -> Any:
    """Of whatever is here, the frame of the test."""
    frame: Any = sys._getframe()
    while frame.f_code.co_filename in (__file__, contextlib.__file__):
        frame = frame.f_back
    return frame


def first_argument(frame: Any, longest: int = 60) -> str:
    """The source of what the call that a frame is at is given first."""
    first, last, start, end = list(frame.f_code.co_positions())[frame.f_lasti // 2]
    lines = linecache.getlines(frame.f_code.co_filename)[first - 1 : last]
    lines[-1] = lines[-1].encode()[:end].decode()
    lines[0] = lines[0].encode()[start:].decode()
    call: Any = ast.parse("".join(lines), mode="eval").body
    text = ast.unparse(call.args[0])
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
