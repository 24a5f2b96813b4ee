"""The one exception that reaches the user: a file, what is wrong with it, what to do about it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path

__all__ = ["MISFITS", "PrtnetError", "nearest_name"]

# What taking damaged headers and arrays apart may raise.
MISFITS = (ArithmeticError, AttributeError, IndexError, KeyError, TypeError, ValueError)

LONGEST = 1200  # characters; a file may hold anything under any name


class PrtnetError(Exception):
    """Bad input or an impossible request, told in one line.

    The command line prints ``prtnet: error: SUBJECT: MESSAGE`` and exits with status 2.

    Args:
        subject: the file or option at fault.
        message: what is wrong and what to do, on one line; of a longer one than ``LONGEST`` the
            middle is left out.
    """

    def __init__(self, subject: str | Path, message: str) -> None:
        self.subject = str(subject)
        # What files say of themselves, lone surrogates too, must not break the line.
        line = " ".join(message.split()).encode("utf-8", "replace").decode()
        half = LONGEST // 2
        self.message = line if len(line) <= LONGEST else f"{line[:half]} … {line[-half:]}"
        super().__init__(f"{self.subject}: {self.message}")

    def __reduce__(self) -> tuple[type[PrtnetError], tuple[str, str]]:
        """Two texts, on the way from another process."""
        return PrtnetError, (self.subject, self.message)


def nearest_name(name: str, known: Iterable[str]) -> str:
    """A clause that lists the known names and suggests the closest one to ``name``."""
    names = list(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    hint = f"did you mean '{close[0]}'? " if close else ""
    return f"{hint}known: {', '.join(names) if names else 'none'}"
