"""Command-line arguments, parsed and checked before any work: whatever is wrong is one line.

A command's arguments are a few frozen dataclasses side by side: its files, the configuration of the
package it drives, and what all commands share. Spellings are the same everywhere: ``--clips A,B``
for lists and ``--size WxH`` for pictures.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from prtnet.errors import PrtnetError
from prtnet.places import is_remote, known

__all__ = [
    "check_output",
    "check_report",
    "input_file",
    "named_options",
    "output_folder",
    "parse",
    "pictures_folder",
    "refuse",
    "value_of",
]


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
    # A default narrows the type to as many strings as it has.
    if get_origin(info.type) is not tuple or {*get_args(info.type)} - {str, ...}:
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
    if get_origin(info.type) is not tuple or get_args(info.type) != (int, int):
        return None
    return PrimitiveConstructorSpec(
        nargs=1,
        metavar="WxH",
        instance_from_str=lambda words: parse_size(words[0]),
        is_instance=lambda value: isinstance(value, tuple),
        str_from_instance=lambda value: ["x".join(map(str, value))],
    )


def parse(
    command: str, argv: Sequence[str], parts: Sequence[Any], description: str, example: str
) -> tuple[Any, ...]:
    """One instance of every dataclass of ``parts``, filled from ``argv``.

    Args:
        command: its name.
        argv: the words after it.
        parts: dataclasses, or instances of them whose values are the defaults.
        description: for ``--help``, which ends with the example.
        example: a whole command line.

    Raises:
        PrtnetError: the arguments do not fit.
        SystemExit: with status 0 after ``--help``.
    """
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            form = tyro.cli(
                side_by_side(parts),
                prog=f"prtnet {command}",
                description=description,
                args=list(argv),
                registry=registry,
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        if not stop.code:
            print(f"\nexample:\n  {example}")  # noqa: T201 - the end of tyro's own help
            raise
        raise PrtnetError(
            command, f"{one_line(complaint.getvalue())}; see prtnet {command} --help"
        ) from None
    return tuple(getattr(form, field.name) for field in dataclasses.fields(form))


def value_of(option: str, argv: Sequence[str]) -> str | None:
    """The value of ``--option VALUE`` or ``--option=VALUE``, before anything is parsed."""
    for word, following in zip(argv, [*argv[1:], ""], strict=True):
        if word == option:
            return following
        if word.startswith(f"{option}="):
            return word.partition("=")[2]
    return None


def named_options(argv: Sequence[str]) -> dict[str, str]:
    """The options that are given, whatever their values, as fields and as they are written."""
    words = (word.partition("=")[0] for word in argv if word.startswith("--"))
    return {word[2:].replace("-", "_"): word for word in words}


def refuse(named: Mapping[str, str], whys: Mapping[str, str]) -> None:
    """Refuse options that are given and would do nothing.

    Args:
        named: those that are given, as ``named_options`` tells.
        whys: why each that would do nothing does not, and what to do.

    Raises:
        PrtnetError: one is given.
    """
    for name, why in whys.items():
        if name in named:
            raise PrtnetError(named[name], why)


def side_by_side(parts: Sequence[Any]) -> Any:
    """A dataclass of all ``parts`` whose options have no prefix."""
    fields: list[Any] = []
    for index, part in enumerate(parts):
        is_type = isinstance(part, type)
        kind: Any = part if is_type else type(part)
        default = dataclasses.field() if is_type else dataclasses.field(default=part)
        fields.append((f"part{index}", Annotated[kind, tyro.conf.arg(name="")], default))
    return dataclasses.make_dataclass("Arguments", fields, kw_only=True)


def one_line(box: str) -> str:
    """What tyro's box of an error says, without its frame, its help texts and its pointers.

    Where the terminal's letters are ASCII the frame is of blanks and dashes.
    """
    sections: list[list[str]] = [[]]
    for line in box.splitlines():
        text = line.strip("│ ")
        if line.startswith(("╭", "╰")) or not text.strip("─- "):
            sections.append([])
        else:
            sections[-1].append(text)
    told = [" ".join(section) for section in sections if section]
    told = told if "╭" in box else told[1:]  # without the title, else in the frame
    return ". ".join(text for text in told if not text.startswith(("For full", "Argument help")))


def input_file(path: Path, folder: bool = False) -> Path:
    """``path``, if it can be read.

    Args:
        path: what the user named.
        folder: a folder will do as well: datasets are folders.

    Raises:
        PrtnetError: there is nothing of that name, or it is a folder.
    """
    if not known(path):
        raise PrtnetError(path, "does not exist; check the name")
    if is_remote(path):
        return path
    if path.is_dir() and not folder:
        raise PrtnetError(path, "is a folder where a file is wanted; name the file in it")
    if not os.access(path, os.R_OK):
        raise PrtnetError(path, "cannot be read; check its permissions")
    return path


def check_output(path: Path | None, *inputs: Path, replaces: str | None = None) -> None:
    """Refuse, before the work rather than after it, an output that could not be written.

    Args:
        path: the output; None is fine.
        inputs: files it must not overwrite, and datasets it must not be put in.
        replaces: for folders, a file that only folders of this kind have: what stands there is
            deleted, so it had better be an earlier output, or empty.

    Raises:
        PrtnetError: it cannot be written, or something else stands there.
    """
    if path is None or is_remote(path):
        return  # what a store holds is looked at where it is written
    for other in inputs:
        inside = is_dataset(other) and other.resolve() in path.resolve().parents
        if inside or path.resolve() == other.resolve():
            raise PrtnetError(path, "is also an input, or in one; give another output")
    if replaces is None and path.is_dir():
        raise PrtnetError(path, "is a folder where a file would be written; give another output")
    if replaces is None and path.exists() and not path.is_file():
        raise PrtnetError(path, "is no regular file; give another output")
    if replaces is not None and path.exists() and not path.is_dir():
        raise PrtnetError(path, "is a file where a folder would be written; give another output")
    if path.is_dir() and not (path / str(replaces)).exists() and any(path.iterdir()):
        raise PrtnetError(path, "is a folder of other files, not replaced; give another output")
    check_writable(path)


def check_report(path: Path | None, *options: Any) -> None:
    """Check where ``--json`` writes: nowhere that the command reads or writes besides.

    Args:
        path: the file; None is fine.
        options: dataclasses of options.

    Raises:
        PrtnetError: it cannot be written, or another option names it.
    """
    values = [getattr(part, field.name) for part in options for field in dataclasses.fields(part)]
    texts = [value for value in values if isinstance(value, str)]  # a light may be a file
    others = [value for value in values if isinstance(value, Path)]
    others += [Path(text) for text in texts if Path(text).is_file()]
    if path is not None and any(path.resolve() == other.resolve() for other in others):
        raise PrtnetError(path, "is named twice; give --json a file of its own")
    check_output(path, *others)


def is_dataset(path: Path) -> bool:
    """Whether a Zarr group stands there."""
    return (path / "zarr.json").is_file()


def output_folder(path: Path) -> None:
    """Make a folder to put files in, or take the one that is there.

    Raises:
        PrtnetError: it can neither be made nor written.
    """
    if path.exists() and not path.is_dir():
        raise PrtnetError(path, "is a file where a folder is wanted; give another output")
    check_writable(path)
    path.mkdir(exist_ok=True)


def pictures_folder(path: Path) -> None:
    """Refuse what is no folder to save pictures in.

    Raises:
        PrtnetError: it is none.
    """
    if not path.is_dir():
        raise PrtnetError(path, "is no folder to save pictures in; make it, or give another")


def check_writable(path: Path) -> None:
    """Refuse a file or folder that the operating system will not let us write."""
    parent = path.absolute().parent
    if re.match(r"[\w+.-]{2,}:[/\\]", str(path)) and not parent.exists():
        raise PrtnetError(path, "is a URL; only datasets may be in a store, give a file's name")
    if not parent.is_dir():
        raise PrtnetError(path, f"cannot be written (there is no folder {parent}); make it first")
    if not os.access(parent, os.W_OK) or (path.exists() and not os.access(path, os.W_OK)):
        raise PrtnetError(path, "cannot be written (permission denied); give another output")
