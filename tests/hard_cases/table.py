"""The page of hard cases: what each measured, how much was allowed, theme by theme."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tests.hard_cases.measured import REFUSED, Check

FOLDER = Path(__file__).parent
THEMES = {
    "Spherical harmonics": ("sh",),
    "Visibility and transfer": ("visibility", "transfer"),
    "Zonal lobes": ("lobes", "lobe_models", "lobe_fields"),
    "Lights and materials": ("lights", "materials", "phong"),
    "All frequencies": ("all_frequency_light", "cpca", "all_frequency_pictures"),
    "Fits and models": ("training", "fits", "borders", "priors", "searches", "evaluations"),
    "Pictures and the viewer": ("pictures", "viewer"),
    "Files, faults and repetition": ("readers", "datasets", "faults", "determinism"),
}
INTRODUCTION = """# Hard cases

Written by `make hard`, which runs tests/hard_cases: input at which this kind of program usually breaks, each with what was measured and what is allowed. A case of many variants stands here with the variant that came nearest to its limit; a line of a case is a check of it, named by its source. *Type* is the precision that the case was run in, and `cuda` where it ran on a GPU; where none is given the code fixes it (float32 in files and pictures, float64 inside of fits); where no case says `cuda`, there was no GPU. *Refused* cases must end in that one line. A case without a measure is a statement that holds, or the tests fail.
"""  # noqa: E501


class Result(NamedTuple):
    """A test that was run."""

    module: str  # without test_
    name: str  # without test_ and parameters
    line: int
    type: str
    checks: tuple[Check, ...]
    ran: bool


def page(results: Iterable[Result]) -> str:
    """The whole page, of results in any order."""
    by_module = defaultdict(list)
    for result in results:
        by_module[result.module].append(result)
    known = [module for modules in THEMES.values() for module in modules]
    themes = {**THEMES, "Others": tuple(sorted(by_module.keys() - set(known)))}
    parts = [INTRODUCTION]
    for theme, modules in themes.items():
        if any(module in by_module for module in modules):
            parts.append(f"## {theme}\n")
        parts += [section(module, by_module[module]) for module in modules if module in by_module]
    return "\n".join(parts)


def section(module: str, results: list[Result]) -> str:
    """A sentence and a table."""
    source = (FOLDER / f"test_{module}.py").read_text(encoding="utf-8")
    sentence = " ".join((ast.get_docstring(ast.parse(source)) or "").split("\n\n")[0].split())
    rows = ["| case | check | type | measured | limit |", "|---|---|---|---:|---:|"]
    last = ""
    for name, kind, check in cases(results):
        rows.append(
            f"| {words(name) if name != last else ''} | {escaped(check.quantity)} | {kind} "
            f"| {escaped(check.measured)} | {check.limit} |"
        )
        last = name
    return f"{sentence}\n\n" + "\n".join(rows) + "\n"


def cases(results: list[Result]) -> Iterable[tuple[str, str, Check]]:
    """A line for each check and type, of the variant nearest to its limit."""
    tests: dict[tuple[int, str], list[Result]] = defaultdict(list)
    for result in sorted(results):
        tests[result.line, result.name].append(result)
    for (_, name), variants in sorted(tests.items()):
        found: dict[tuple[int, str], list[Check]] = defaultdict(list)
        for variant in variants:
            for check in variant.checks:
                line = 0 if check.limit == REFUSED else check.line
                found[line, variant.type].append(check)
        if not found:
            ran = any(variant.ran for variant in variants)
            yield name, "", Check(0, "", "holds" if ran else "not run here", "", 0.0)
        for (_, kind), checks in sorted(found.items()):
            yield name, kind, nearest(checks)


def nearest(checks: list[Check]) -> Check:
    """The one nearest to its limit; of refusals the first, and how many other lines there are."""
    if checks[0].limit != REFUSED:
        return max(checks, key=lambda check: check.nearness)
    lines = sorted({check.measured for check in checks})
    others = f" … and {len(lines) - 1} more" if len(lines) > 1 else ""
    return checks[0]._replace(measured=lines[0] + others)


def words(name: str) -> str:
    """A test's name as a reader wants it."""
    return name.replace("_", " ")


def escaped(text: str) -> str:
    """With no bar that would end a cell of a table."""
    return text.replace("|", "\\|")
