"""The command line: one function a command, thin over the packages it drives.

This is the one module of ``prtnet`` that may import ``data_gen``, ``training`` and ``runtime``, and
it does so inside the commands, so that ``prtnet --help`` answers at once.
"""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import prtnet
from prtnet.errors import PrtnetError, nearest_name

if TYPE_CHECKING:
    from prtnet.console import Console

__all__ = ["COMMANDS", "main", "run"]


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        run: parses the arguments and does the work.
        summary: what it does, in a line.
        example: a line to copy.
    """

    run: Callable[[Sequence[str]], None]
    summary: str
    example: str


@dataclass(frozen=True)
class Session:
    """How one run of a command talks back."""

    console: Console
    json: Path | None

    def finish(self, results: dict[str, Any]) -> None:
        """Write the machine-readable results, where they are wanted."""
        from prtnet.console import write_json

        if self.json is not None:
            write_json(self.json, results)


def main() -> None:
    """Entry point: leaves with 0, 2 after an error, 130 after Ctrl-C."""
    if not sys.warnoptions and "--debug" not in sys.argv:
        warnings.simplefilter("ignore")  # libraries' deprecations are no news to the user
    sys.exit(run(sys.argv[1:]))


def run(argv: Sequence[str]) -> int:
    """Run one command line and return its exit status."""
    debug = "--debug" in argv
    try:
        dispatch(argv)
        sys.stdout.flush()
    except SystemExit as stop:
        return int(stop.code or 0)
    except KeyboardInterrupt:
        return fail("interrupted", 130, debug)
    except BrokenPipeError:  # whoever read our output has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except PrtnetError as error:
        return fail(f"{error.subject}: {error.message}", 2, debug)
    except OSError as error:
        what = error.strerror or str(error)
        return fail(f"{error.filename or 'system'}: {what}; check it and try again", 2, debug)
    except Exception as error:  # a bug; still one line
        what = " ".join(f"{type(error).__name__}: {error}".split())
        return fail(f"internal: {what}; please report it with the output of --debug", 2, debug)
    return 0


def fail(text: str, status: int, debug: bool) -> int:
    """Print the error, after its traceback if asked for, and return the exit status."""
    if debug:
        traceback.print_exc()
    sys.stderr.write(f"prtnet: error: {text}\n")
    return status


def dispatch(argv: Sequence[str]) -> None:
    """Hand the arguments to the command they begin with."""
    name = argv[0] if argv else ""
    if name in ("-h", "--help"):
        sys.stdout.write(overview())
    elif name == "--version":
        sys.stdout.write(f"prtnet {prtnet.__version__}\n")
    elif name in COMMANDS:
        COMMANDS[name].run(argv[1:])
    elif name:
        raise PrtnetError(name, f"is no command; {nearest_name(name, COMMANDS)}")
    else:
        raise PrtnetError("command", f"is missing; {nearest_name('', COMMANDS)}")


def overview() -> str:
    """What ``prtnet --help`` prints."""
    width = max(map(len, COMMANDS))
    lines = "\n".join(f"  {name:<{width}}  {each.summary}" for name, each in COMMANDS.items())
    return (
        "usage: prtnet COMMAND [OPTIONS]\n\n"
        "Learned soft self-shadows for animated characters and cloth.\n\n"
        f"commands:\n{lines}\n\n"
        "Every command knows --help, --quiet, --json FILE and --debug.\n\n"
        f"example:\n  {COMMANDS['info'].example}\n"
    )


def arguments(name: str, argv: Sequence[str], *parts: type) -> tuple[Any, ...]:
    """The options of a command, one instance of each of ``parts``, and its session."""
    from prtnet.cli_arguments import check_output, parse
    from prtnet.cli_options import Common
    from prtnet.console import Console

    command = COMMANDS[name]
    *options, common = parse(name, argv, (*parts, Common), command.summary, command.example)
    check_output(common.json)
    return (*options, Session(Console(common.quiet), common.json))


def info(argv: Sequence[str]) -> None:
    """Describe a scene, a dataset or a model."""
    from prtnet.cli_arguments import input_file
    from prtnet.cli_options import InfoFiles

    files, session = arguments("info", argv, InfoFiles)
    path = input_file(files.file, folder=True)
    if path.suffix == ".safetensors":
        from prtnet.model import VisibilityModel

        facts = VisibilityModel.load(path).metadata
    elif path.is_dir():
        from prtnet.dataset import Dataset

        facts = Dataset.open(path).attributes
    else:
        from data_gen.readers import read_scene
        from data_gen.scene_info import describe

        facts = describe(read_scene(path))
    session.console.facts(list(facts.items()))
    session.finish(facts)


COMMANDS = {
    "info": Command(info, "describe a scene, a dataset or a model", "prtnet info robot.glb"),
}
