from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from prtnet.errors import PrtnetError
from prtnet.luminance import luminance
from runtime.picture import (
    Panel,
    auto_exposure,
    backdrop,
    colour_map,
    comparison,
    compose_panels,
    develop,
    rounded_up,
    save_png,
    srgb_encode,
)


def srgb_decode(encoded: np.ndarray) -> np.ndarray:
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def grey_picture(
    value: float, covered: float = 1.0, size: tuple[int, int] = (40, 30)
) -> np.ndarray:
    width, height = size
    picture = np.full((height, width, 4), value * covered, dtype=np.float32)
    picture[..., 3] = covered
    return picture


def test_srgb_is_the_standards_curve():
    # IEC 61966-2-1: the pieces meet at 0.0031308, mid grey 0.2140 is 0.5.
    assert srgb_encode(np.array(0.21404114)) == pytest.approx(0.5, abs=1e-7)
    assert srgb_encode(np.array(0.002)) == pytest.approx(0.02584)
    linear = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb_decode(srgb_encode(linear)), linear, atol=1e-7)


def test_srgb_clips_what_no_screen_can_show():
    values = srgb_encode(np.array([-0.5, 0.0, 1.0, 7.0, np.nan, np.inf, -np.inf]))
    np.testing.assert_allclose(values, [0, 0, 1, 1, 0, 1, 0], rtol=1e-15)
    assert values.max() <= 1


def test_luminance_is_that_of_rec_709():
    assert luminance(np.eye(3)).tolist() == pytest.approx([0.2126, 0.7152, 0.0722])


def test_developing_lays_the_picture_over_the_background():
    background = np.array([0.2, 0.0, 1.0])
    half = develop(grey_picture(0.3, covered=0.5), exposure=2.0, background=background)
    expected = np.rint(255 * srgb_encode(0.5 * 0.6 + 0.5 * background))
    np.testing.assert_array_equal(half[0, 0], expected)


def test_exposure_brings_the_brightest_part_near_white():
    picture = grey_picture(0.02)
    picture[:3, :10, :3] = 4.0  # 2.5 % of the pixels
    assert auto_exposure(picture) == pytest.approx(0.85 / 4.0)
    assert auto_exposure(grey_picture(0.0)) == 1.0
    assert auto_exposure(grey_picture(1.0, covered=0.0)) == 1.0


def test_backdrop_is_calm():
    picture = backdrop((64, 48))
    assert picture.shape == (48, 64, 3)
    assert 0 < picture.min() < picture.max() < 0.2
    assert np.abs(np.diff(picture, axis=0)).max() < 0.02


def test_heat_colours_get_lighter_in_even_steps():
    colours = colour_map(np.linspace(0, 1, 256)).astype(float) / 255
    y = luminance(srgb_decode(colours))
    lightness = 116 * np.cbrt(np.maximum(y, 0.008856)) - 16  # CIE L*
    steps = np.diff(lightness[::15])
    assert (steps > 0).all()
    assert steps.max() < 2.5 * np.median(steps)
    assert lightness[0] < 15
    assert lightness[-1] > 85


def test_heat_colours_of_values_outside_the_scale_are_its_ends():
    ends = colour_map(np.array([0.0, 1.0]))
    np.testing.assert_array_equal(colour_map(np.array([-3.0, np.nan, 9.0])), ends[[0, 0, 1]])


def test_panels_stand_side_by_side_with_captions_below():
    red, blue = (np.full((100, 80, 3), c, dtype=np.uint8) for c in ([200, 0, 0], [0, 0, 200]))
    sheet = compose_panels([Panel(red, "left"), Panel(blue, "right", "a note")])
    assert sheet.dtype == np.uint8
    assert sheet.shape[0] > 130
    assert (sheet[:100, :80] == [200, 0, 0]).all()
    assert (sheet[:100, -80:] == [0, 0, 200]).all()
    caption = sheet[100:]
    plain = compose_panels([Panel(red, ""), Panel(blue, "")])[100:]
    written = (caption != plain).any(axis=-1)
    assert written[:, :80].sum() > 20
    assert written[:, -80:].sum() > 40


def test_the_colour_bar_runs_from_dark_below_to_light_above():
    black = np.zeros((200, 300, 3), dtype=np.uint8)
    sheet = compose_panels([Panel(black, "error", bar=(5.0, "%"))])
    column = next(
        x for x in range(299, 200, -1) if (sheet[70:130, x] != 0).any(axis=-1).all()
        and len(np.unique(sheet[70:130, x], axis=0)) > 20
    )  # fmt: skip
    bar = luminance(sheet[65:135, column].astype(float))
    assert (np.diff(bar) <= 0).all()


def test_comparison_says_where_and_how_much():
    truth, prediction = grey_picture(0.5), grey_picture(0.5)
    prediction[10:20, :20, :3] += 0.05
    sheet, told = comparison(prediction, truth, exposure=1.0)
    # One pixel in six is off by 5 % of white.
    assert told["rms"] == pytest.approx(5 / np.sqrt(6), rel=1e-5)
    assert told["max"] == pytest.approx(5.0, rel=1e-5)
    heat = sheet[:30, -40:]
    np.testing.assert_array_equal(heat[15, 5], colour_map(np.array(1.0)))
    np.testing.assert_array_equal(heat[5, 5], colour_map(np.array(0.0)))
    assert sheet.shape[1] > 3 * 40


def test_comparison_counts_what_is_drawn_only():
    truth = grey_picture(0.5)
    truth[:, 20:] = 0.0
    prediction = truth.copy()
    prediction[:, :20, :3] += 0.1
    assert comparison(prediction, truth, exposure=1.0)[1]["rms"] == pytest.approx(10, rel=1e-5)
    nothing = np.zeros_like(truth)
    assert comparison(nothing, nothing)[1] == {"rms": 0.0, "p99": 0.0, "max": 0.0}


@pytest.mark.parametrize(
    ("value", "top"), [(0, 0.1), (0.1, 0.1), (0.11, 0.2), (3.2, 5), (5.1, 10), (20, 20), (99, 100)]
)
def test_scales_end_at_round_numbers(value, top):
    assert rounded_up(value) == pytest.approx(top)


def test_png_holds_the_bytes(tmp_path):
    picture = np.random.default_rng(0).integers(0, 256, (9, 7, 3)).astype(np.uint8)
    save_png(tmp_path / "a.png", picture)
    with Image.open(tmp_path / "a.png") as image:
        np.testing.assert_array_equal(np.asarray(image), picture)
    assert [p.name for p in tmp_path.iterdir()] == ["a.png"]
    with pytest.raises(PrtnetError, match="cannot be written"):
        save_png(tmp_path / "none" / "a.png", picture)
