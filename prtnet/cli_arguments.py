"""Command-line arguments, parsed and checked before any work: whatever is wrong is one line.

A command's arguments are a few frozen dataclasses side by side: its files, the configuration of the
package it drives, and what all commands share. Spellings are the same everywhere: ``--clips A,B``
for lists and ``--size WxH`` for pictures.
"""

from __future__ import annotations

import contextlib
import io
import os
import types
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from prtnet.errors import PrtnetError

__all__ = ["check_output", "input_file", "parse"]


registry = ConstructorRegistry()


def split_names(text: str) -> tuple[str, ...]:
    """The names in ``A,B``, without blanks around them."""
    return tuple(name for part in text.split(",") if (name := part.strip()))


def parse_size(text: str) -> tuple[int, int]:
    """Width and height of ``WxH``."""
    width, times, height = text.lower().partition("x")
    if not (times and width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise ValueError(f"'{text}' is no size; write width x height, as in 640x480")
    return int(width), int(height)


@registry.primitive_rule
def names_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """``tuple[str, ...]`` is written A,B."""
    if info.type != tuple[str, ...]:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="A,B",
        instance_from_str=lambda words: split_names(words[0]),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: [",".join(value)],
    )


@registry.primitive_rule
def size_rule(info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """``tuple[int, int]`` is written WxH."""
    if info.type != tuple[int, int]:
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="WxH",
        instance_from_str=lambda words: parse_size(words[0]),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: ["x".join(map(str, value))],
    )


def parse(
    command: str, argv: Sequence[str], parts: Sequence[type], description: str, example: str
) -> tuple[Any, ...]:
    """One instance of every dataclass of ``parts``, filled from ``argv``.

    Raises:
        PrtnetError: the arguments do not fit.
        SystemExit: with status 0 after ``--help``, which ends with the example.
    """
    # Nameless sides: one flat list of options, whichever dataclass each comes from.
    sides = tuple(Annotated[part, tyro.conf.arg(name="")] for part in parts)
    form: Any = types.GenericAlias(tuple, sides)
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                form,
                prog=f"prtnet {command}",
                description=description,
                args=list(argv),
                registry=registry,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if not stop.code:
            print(f"example:\n  {example}")  # noqa: T201 - the end of tyro's own help
            raise
        raise PrtnetError(
            command, f"{one_line(complaint.getvalue())}; see prtnet {command} --help"
        ) from None


def one_line(box: str) -> str:
    """What tyro's box of an error says, without its frame, its help texts and its pointers."""
    sections: list[list[str]] = [[]]
    for line in box.splitlines():
        text = line.strip("│╭╮╰╯ ")
        if line.startswith("│") and text.strip("─"):
            sections[-1].append(text)
        else:
            sections.append([])
    told = [" ".join(section) for section in sections if section]
    return ". ".join(text for text in told if not text.startswith(("For full", "Argument help")))


def input_file(path: Path, folder: bool = False) -> Path:
    """``path``, if it can be read.

    Args:
        path: what the user named.
        folder: a folder will do as well: datasets are folders.

    Raises:
        PrtnetError: there is nothing of that name, or it is a folder.
    """
    if not path.exists():
        raise PrtnetError(path, "does not exist; check the name")
    if path.is_dir() and not folder:
        raise PrtnetError(path, "is a folder where a file is wanted; name the file in it")
    if not os.access(path, os.R_OK):
        raise PrtnetError(path, "cannot be read; check its permissions")
    return path


def check_output(path: Path | None, *inputs: Path, folder: bool = False) -> None:
    """Refuse, before the work rather than after it, an output that could not be written.

    Args:
        path: the output; None is fine.
        inputs: files it must not overwrite.
        folder: the output is a folder, which may exist.

    Raises:
        PrtnetError: it cannot be written, or is one of the inputs.
    """
    if path is None:
        return
    if any(path.resolve() == other.resolve() for other in inputs):
        raise PrtnetError(path, "is also an input; give another output")
    if path.is_dir() and not folder:
        raise PrtnetError(path, "is a folder where a file would be written; give another output")
    if folder and path.is_file():
        raise PrtnetError(path, "is a file where a folder would be written; give another output")
    parent = path.absolute().parent
    if not parent.is_dir():
        raise PrtnetError(path, f"cannot be written (there is no folder {parent}); make it first")
    if not os.access(parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise PrtnetError(path, "cannot be written (permission denied); give another output")
