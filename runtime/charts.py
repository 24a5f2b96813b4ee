"""Small charts as hand-written SVG, to stand inside an HTML page without a script.

Colours are classes (``s0`` … ``s7``, ``axis``, ``grid``, ``front``), set by the page's style sheet
for light and dark; eight series have a marker of their own besides, so that colour is not needed.
"""

from __future__ import annotations

import html
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Axis", "Reference", "Series", "legend", "marker", "scatter"]

WIDTH, HEIGHT = 480, 360
LEFT, RIGHT, TOP, BOTTOM = 62, 20, 14, 54  # margins around the plot
SERIES = 8  # colours and markers, then the same colours with other markers
MOST_TICKS = 7
TEXT_HEIGHT = 18
LOG_STEPS = (
    (1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8),
    (1, 1.5, 2, 3, 5, 7),
    (1, 2, 5),
    (1, 3),
    (1,),
)


@dataclass(frozen=True)
class Series:
    """Points of one kind.

    Attributes:
        name: for the legend.
        points: (x, y) of each.
        labels: shown when a point is pointed at.
        joined: whether a line goes from point to point.
    """

    name: str
    points: Sequence[tuple[float, float]]
    labels: Sequence[str]
    joined: bool = False


@dataclass(frozen=True)
class Reference:
    """A horizontal line with a word on it."""

    name: str
    y: float


@dataclass(frozen=True)
class Axis:
    """A scale from ``low`` to ``high``, and its title with the unit."""

    title: str
    low: float
    high: float
    log: bool = False

    @classmethod
    def around(cls, title: str, values: Sequence[float], log: bool = False) -> Axis:
        """An axis that shows all values with some room; linear ones start at 0."""
        top = max(values, default=0.0)
        if not log:
            return cls(title, 0.0, 1.08 * top if top > 0 else 1.0)
        positive = [value for value in values if value > 0] or [1.0]
        return cls(title, min(positive) / 1.4, max(positive) * 1.4, log=True)

    def place(self, value: float) -> float:
        """Where a value is, 0 at the low end and 1 at the high."""
        if self.log:
            value = max(value, self.low)
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def ticks(self) -> list[float]:
        """Round numbers along the axis, at most ``MOST_TICKS``."""
        if not self.log:
            span = self.high - self.low
            power = 10.0 ** math.floor(math.log10(span / MOST_TICKS))
            step = next(k * power for k in (1, 2, 5, 10) if span / (k * power) <= MOST_TICKS)
            return [k * step for k in range(math.floor(self.high / step + 1e-9) + 1)]
        for steps in LOG_STEPS:
            powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
            found = [k * 10.0**p for p in powers for k in steps
                     if self.low <= k * 10.0**p <= self.high]  # fmt: skip
            if len(found) <= MOST_TICKS:
                return found
        return found[:: -(-len(found) // MOST_TICKS)]


def scatter(
    series: Sequence[Series],
    x: Axis,
    y: Axis,
    description: str,
    references: Sequence[Reference] = (),
    front: Sequence[tuple[float, float]] = (),
) -> str:
    """A chart of points.

    Args:
        series: the first eight differ in colour and in marker, more in one of both.
        x: the horizontal axis.
        y: the vertical axis.
        description: what the chart shows, for readers who do not see it.
        references: horizontal lines.
        front: points that no other beats, joined by steps.

    Raises:
        ValueError: a number is not finite.
    """
    every = [p for each in series for p in each.points] + list(front)
    numbers = [x.low, x.high, y.low, y.high, *(r.y for r in references), *np.ravel(every)]
    if not np.isfinite(numbers).all():
        raise ValueError("a chart has no place for what is not finite")
    parts = [*axes(x, y), *reference_lines(references, y)]
    if front:
        parts.append(steps(front, x, y))
    for index, each in enumerate(series):
        places = [at(point, x, y) for point in each.points]
        kind, shape = look(index)
        if each.joined and len(places) > 1:
            line = " ".join(f"{a:.1f},{b:.1f}" for a, b in places)
            parts.append(f'<polyline class="line s{kind}" points="{line}"/>')
        for place, label in zip(places, each.labels, strict=True):
            parts.append(
                f'<g class="s{kind}"><title>{html.escape(label)}</title>{marker(shape, *place)}</g>'
            )
    body = "\n".join(parts)
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{html.escape(description, quote=True)}">\n{body}\n</svg>'
    )


def look(index: int) -> tuple[int, int]:
    """Colour and marker of a series: no two of the first 64 have both in common."""
    return index % SERIES, (index + index // SERIES) % SERIES


def at(point: tuple[float, float], x: Axis, y: Axis) -> tuple[float, float]:
    """Pixels of a point."""
    wide, high = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM
    return LEFT + wide * x.place(point[0]), TOP + high * (1.0 - y.place(point[1]))


def axes(x: Axis, y: Axis) -> list[str]:
    """Grid, ticks and titles."""
    floor, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    parts = []
    for value in y.ticks():
        row = at((x.low, value), x, y)[1]
        parts.append(line(LEFT, row, right, row, "grid"))
        parts.append(text(LEFT - 7, row + 5, f"{value:g}", "end"))
    for value in x.ticks():
        column = at((value, y.low), x, y)[0]
        parts.append(line(column, TOP, column, floor, "grid"))
        parts.append(text(column, floor + 19, f"{value:g}", "middle"))
    parts.append(line(LEFT, floor, right, floor, "axis"))
    parts.append(text((LEFT + right) / 2, HEIGHT - 10, x.title, "middle"))
    middle = (TOP + floor) / 2
    parts.append(
        f'<text transform="translate(16 {middle:.1f}) rotate(-90)" text-anchor="middle">'
        f"{html.escape(y.title)}</text>"
    )
    return parts


def reference_lines(references: Sequence[Reference], y: Axis) -> list[str]:
    """Dashed lines across the plot, each with its name above its right end.

    The name is below where the plot ends above, or where the name of a line close by is.
    """
    height, right = HEIGHT - TOP - BOTTOM, WIDTH - RIGHT
    parts, taken = [], -math.inf
    for reference in sorted(references, key=lambda reference: -reference.y):
        row = TOP + height * (1.0 - y.place(reference.y))
        above = row > TOP + TEXT_HEIGHT and row - 5 >= taken + TEXT_HEIGHT
        taken = row - 5 if above else max(row + 16, taken + TEXT_HEIGHT)
        parts.append(line(LEFT, row, right, row, "reference"))
        parts.append(text(right - 3, taken, reference.name, "end"))
    return parts


def steps(front: Sequence[tuple[float, float]], x: Axis, y: Axis) -> str:
    """The edge of what is possible: from each point right, then down to the next."""
    places = [at(point, x, y) for point in sorted(front)]
    path = [places[0]]
    for before, place in itertools.pairwise(places):
        path += [(place[0], before[1]), place]
    path.append((float(WIDTH - RIGHT), places[-1][1]))
    drawn = " ".join(f"{a:.1f},{b:.1f}" for a, b in path)
    return f'<polyline class="front" points="{drawn}"/>'


def line(x1: float, y1: float, x2: float, y2: float, kind: str) -> str:
    """A straight line of a class."""
    return f'<line class="{kind}" x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"/>'


def text(x: float, y: float, words: str, anchor: str) -> str:
    """A word at a place."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(words)}</text>'


def marker(kind: int, x: float, y: float, size: float = 5.5) -> str:
    """One of eight shapes about a point."""
    if kind == 0:
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{size:.1f}"/>'
    if kind == 1:
        corner, side = 0.9 * size, 1.8 * size
        return (
            f'<rect x="{x - corner:.1f}" y="{y - corner:.1f}" width="{side:.1f}" '
            f'height="{side:.1f}"/>'
        )
    shapes = {
        2: [(0.0, -1.3), (1.2, 0.9), (-1.2, 0.9)],
        3: [(0.0, -1.4), (1.2, 0.0), (0.0, 1.4), (-1.2, 0.0)],
        4: [(0.0, 1.3), (1.2, -0.9), (-1.2, -0.9)],
        5: [(-1.2, -0.4), (-0.4, -0.4), (-0.4, -1.2), (0.4, -1.2), (0.4, -0.4), (1.2, -0.4),
            (1.2, 0.4), (0.4, 0.4), (0.4, 1.2), (-0.4, 1.2), (-0.4, 0.4), (-1.2, 0.4)],
        6: [(1.3, 0.0), (-0.9, 1.2), (-0.9, -1.2)],
        7: [(-1.3, -0.5), (1.3, -0.5), (1.3, 0.5), (-1.3, 0.5)],
    }  # fmt: skip
    corners = " ".join(f"{x + a * size:.1f},{y + b * size:.1f}" for a, b in shapes[kind])
    return f'<polygon points="{corners}"/>'


def legend(names: Sequence[str]) -> str:
    """A list of the series with their markers, as HTML."""
    items = "".join(
        f'<li><svg class="key" viewBox="0 0 16 16" aria-hidden="true"><g class="s{colour}">'
        f"{marker(shape, 8.0, 8.0)}</g></svg>{html.escape(name)}</li>"
        for name, (colour, shape) in zip(names, map(look, range(len(names))), strict=True)
    )
    return f'<ul class="legend">{items}</ul>'
