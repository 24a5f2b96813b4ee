from __future__ import annotations

import itertools
import math
import re

import pytest

from runtime.charts import HEIGHT, WIDTH, Axis, Reference, Series, legend, look, marker, scatter

X = Axis("cost", 1.0, 100.0, log=True)
Y = Axis("error, %", 0.0, 10.0)


def numbers(svg: str) -> list[float]:
    return [float(n) for n in re.findall(r'[\s",](-?\d+(?:\.\d+)?)(?=[\s",)])', svg)]


def test_places_are_where_the_scale_says() -> None:
    assert X.place(10.0) == pytest.approx(0.5)
    assert X.place(0.0) == 0.0  # what has no logarithm is at the low end
    assert Y.place(2.5) == 0.25


def test_axes_have_room_for_all_values() -> None:
    for axis, values in (
        (Axis.around("a", [3.0, 700.0], log=True), [3.0, 700.0]),
        (Axis.around("a", [0.0, 5.0]), [0.0, 5.0]),
        (Axis.around("a", [4.0], log=True), [4.0]),
    ):
        assert all(0 <= axis.place(value) < 1 for value in values)
    for empty in (Axis.around("a", []), Axis.around("a", [0.0]), Axis.around("a", [], log=True)):
        assert empty.high > empty.low


@pytest.mark.parametrize("high", [1e-4, 0.027, 0.9, 3.3, 11.7, 99.0, 1e6])
def test_linear_ticks_are_few_round_and_inside(high: float) -> None:
    ticks = Axis("a", 0.0, high).ticks()
    assert 2 <= len(ticks) <= 11
    assert ticks[0] == 0.0
    assert ticks[-1] <= high * (1 + 1e-9)
    assert len({f"{t:g}" for t in ticks}) == len(ticks)


@pytest.mark.parametrize(("low", "high"), [(0.2, 0.6), (3, 150), (1e-6, 1e6), (1.3, 1.9)])
def test_logarithmic_ticks_are_few_and_inside(low: float, high: float) -> None:
    ticks = Axis("a", low, high, log=True).ticks()
    assert 1 <= len(ticks) <= 8
    assert all(low <= t <= high for t in ticks)


def test_points_are_drawn_inside_the_picture_and_say_what_they_are() -> None:
    series = [Series("a <family>", [(1.0, 9.0), (50.0, 2.0)], ["one & only", "two"], joined=True)]
    svg = scatter(series, X, Y, "a chart", [Reference("mean", 8.0)], [(1.0, 9.0), (50.0, 2.0)])
    assert "<title>one &amp; only</title>" in svg
    assert svg.count("<circle") == 2
    assert svg.count('class="line s0"') == svg.count('class="front"') == 1
    assert max(numbers(svg)) <= max(WIDTH, HEIGHT)
    first, second = re.findall(r'<circle cx="([\d.]+)" cy="([\d.]+)"', svg)
    assert float(first[0]) < float(second[0])  # dearer is to the right
    assert float(first[1]) < float(second[1])  # less error is further down
    assert "&lt;family&gt;" in legend(["a <family>"])


@pytest.mark.parametrize("values", [(5.0, 5.2), (5.0, 5.0), (9.9, 9.8), (9.9, 2.0), (1.0, 7.0)])
def test_names_of_lines_close_to_each_other_are_not_written_over_each_other(values) -> None:
    svg = scatter([], X, Y, "a chart", [Reference(f"line {v}", v) for v in values])
    lines = re.findall(r'class="reference" x1="[\d.]+" y1="([\d.]+)"', svg)
    names = re.findall(r'<text x="[\d.]+" y="([\d.]+)" text-anchor="end">line ([\d.]+)<', svg)
    assert [float(name) for _, name in names] == sorted(values, reverse=True)  # from above
    rows = [float(row) for row, _ in names]
    assert rows[1] - rows[0] >= 15  # the height of their letters
    for row, own in zip(rows, map(float, lines), strict=True):
        assert abs(row - own) < 36  # beside its line
        assert row > 25  # inside the picture


def test_front_goes_right_and_then_down() -> None:
    svg = scatter([], X, Y, "a chart", front=[(10.0, 2.0), (1.0, 9.0)])
    (points,) = re.findall(r'class="front" points="([^"]*)"', svg)
    places = [tuple(map(float, pair.split(","))) for pair in points.split()]
    assert places == sorted(places)
    for before, after in itertools.pairwise(places):
        assert before[0] == after[0] or before[1] == after[1]


def test_what_is_not_finite_is_refused() -> None:
    for bad in (math.nan, math.inf):
        with pytest.raises(ValueError, match="not finite"):
            scatter([Series("a", [(1.0, bad)], ["a"])], X, Y, "a chart")


def test_markers_differ() -> None:
    assert len({marker(kind, 10.0, 10.0) for kind in range(6)}) == 6


def test_many_series_differ_in_colour_or_marker() -> None:
    looks = [look(k) for k in range(64)]
    assert len(set(looks)) == 64
    assert looks[:8] == [(k, k) for k in range(8)]
