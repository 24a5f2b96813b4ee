"""Line and bar charts as SVG, written by hand: small files that a page can show."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.sax.saxutils import escape

COLOURS = ("#2563a8", "#d1495b", "#3a8a5f", "#e09f3e", "#6b5b95", "#555555")
WIDTH, HEIGHT = 560, 320
GROUP = 76  # of bars, at least so wide
LEFT, RIGHT, TOP, BOTTOM = 60, 160, 34, 48


def nice_ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Round numbers from at most ``low`` to at least ``high``."""
    raw = max(high - low, 1e-9) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1.0, 2.0, 2.5, 5.0, 10.0) if k * power >= raw * 0.999)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [k * step for k in range(first, last + 1)]


def text(x: float, y: float, words: str, anchor: str = "middle", extra: str = "") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" {extra}>{escape(words)}</text>'


class Chart:
    """Axes with a title; y from zero, or from its own least value."""

    def __init__(
        self, title: str, y_label: str, y_ticks: Sequence[float], width: int = WIDTH
    ) -> None:
        self.low, self.high, self.width = y_ticks[0], y_ticks[-1], width
        self.parts = [
            text(LEFT, 20, title, "start", 'font-weight="bold"'),
            text(14, (TOP + HEIGHT - BOTTOM) / 2, y_label, "middle",
                 f'transform="rotate(-90 14 {(TOP + HEIGHT - BOTTOM) / 2:.0f})"'),
        ]  # fmt: skip
        for tick in y_ticks:
            y = self.y(tick)
            self.parts.append(
                f'<path d="M{LEFT} {y:.1f}H{width - RIGHT}" stroke="#ddd" fill="none"/>'
            )
            self.parts.append(text(LEFT - 6, y + 4, f"{tick:g}", "end"))
        self.named = 0

    def y(self, value: float) -> float:
        return (
            HEIGHT - BOTTOM - (value - self.low) / (self.high - self.low) * (HEIGHT - TOP - BOTTOM)
        )

    def legend(self, name: str, dashed: bool = False) -> str:
        """The colour of the next name."""
        colour = COLOURS[self.named % len(COLOURS)]
        x, y = self.width - RIGHT + 14, TOP + 8 + 18 * self.named
        dash = ' stroke-dasharray="2 4"' if dashed else ""
        self.parts.append(f'<path d="M{x} {y}h18" stroke="{colour}" stroke-width="3"{dash}/>')
        self.parts.append(text(x + 24, y + 4, name, "start"))
        self.named += 1
        return colour

    def save(self, path: Path, x_label: str) -> None:
        self.parts.append(text((LEFT + self.width - RIGHT) / 2, HEIGHT - 10, x_label))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {HEIGHT}" '
            f'font-family="sans-serif" font-size="12">\n'
            f'<rect width="{self.width}" height="{HEIGHT}" fill="white"/>\n'
            + "\n".join(self.parts)
            + "\n</svg>\n",
            encoding="utf-8",
        )


def lines(
    path: Path,
    title: str,
    x_label: str,
    y_label: str,
    x: Sequence[float],
    series: Mapping[str, Sequence[float]],
    even: bool = False,
    dotted: Sequence[str] = (),
) -> None:
    """Curves over common ``x``: to scale, or evenly spaced with every x named."""
    values = [v for row in series.values() for v in row]
    chart = Chart(title, y_label, nice_ticks(min(0.0, *values), max(values)))
    places = [float(k) for k in range(len(x))] if even else [float(k) for k in x]
    ticks = places if even else nice_ticks(min(places), max(places), 7)
    names = [f"{k:g}" for k in (x if even else ticks)]
    low, high = min(*places, *ticks), max(*places, *ticks)

    def across(value: float) -> float:
        return LEFT + 10 + (value - low) / (high - low) * (WIDTH - LEFT - RIGHT - 20)

    for place, name in zip(ticks, names, strict=True):
        chart.parts.append(text(across(place), HEIGHT - BOTTOM + 18, name))
    for name, row in series.items():
        colour = chart.legend(name, name in dotted)
        points = [(across(a), chart.y(b)) for a, b in zip(places, row, strict=True)]
        if name not in dotted:
            line = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
            chart.parts.append(
                f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>'
            )
        if even or name in dotted:
            chart.parts += [
                f'<circle cx="{a:.1f}" cy="{b:.1f}" r="3" fill="{colour}"/>' for a, b in points
            ]
    chart.save(path, x_label)


def bars(
    path: Path,
    title: str,
    y_label: str,
    groups: Sequence[str],
    series: Mapping[str, Sequence[float]],
    spread: Mapping[str, Sequence[float]] | None = None,
) -> None:
    """Groups of bars from zero, with whiskers of ± ``spread`` where it is given.

    Names of groups have up to three lines.
    """
    most = max(
        v + (spread[name][k] if spread else 0.0)
        for name, row in series.items()
        for k, v in enumerate(row)
    )
    width = max(WIDTH, LEFT + RIGHT + GROUP * len(groups))
    chart = Chart(title, y_label, nice_ticks(0.0, most), width)
    room = (width - LEFT - RIGHT) / len(groups)
    thick = 0.8 * room / len(series)
    for k, name in enumerate(groups):
        for row, line in enumerate(name.split("\n")):
            y = HEIGHT - BOTTOM + 14 + 13 * row
            chart.parts.append(text(LEFT + (k + 0.5) * room, y, line, extra='font-size="11"'))
    for number, (name, row) in enumerate(series.items()):
        colour = chart.legend(name)
        for k, value in enumerate(row):
            x = LEFT + k * room + 0.1 * room + number * thick
            y = chart.y(value)
            chart.parts.append(
                f'<rect x="{x:.1f}" y="{y:.1f}" width="{0.92 * thick:.1f}" '
                f'height="{chart.y(0.0) - y:.1f}" fill="{colour}"/>'
            )
            if spread:
                ends = (
                    chart.y(max(0.0, value - spread[name][k])),
                    chart.y(value + spread[name][k]),
                )
                chart.parts.append(
                    f'<path d="M{x + thick / 2:.1f} {ends[0]:.1f}V{ends[1]:.1f}" stroke="#333"/>'
                )
    chart.save(path, "")
