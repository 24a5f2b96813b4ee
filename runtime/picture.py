"""From linear radiance to a PNG: exposure, sRGB, heat maps, captioned panels side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from prtnet.arrays import FloatArray
from prtnet.files import writing
from prtnet.luminance import luminance

__all__ = [
    "Panel",
    "auto_exposure",
    "backdrop",
    "colour_map",
    "comparison",
    "compose_panels",
    "develop",
    "laid_over",
    "save_png",
    "srgb_encode",
]

WHITE_POINT = 0.85  # linear value the brightest part of a surface is exposed to
PAPER, INK, QUIET = (24, 25, 28), (236, 237, 240), (150, 153, 160)


def srgb_encode(linear: FloatArray) -> FloatArray:
    """Linear values to sRGB ones, both in [0, 1] and clipped to it (IEC 61966-2-1)."""
    linear = np.clip(np.nan_to_num(linear), 0.0, 1.0)
    curve = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(linear <= 0.0031308, 12.92 * linear, curve)


def auto_exposure(rgba: FloatArray) -> float:
    """The factor that brings the brightest hundredth of what is drawn close to white.

    Args:
        rgba: from ``render``, (H, W, 4). Give the same exposure to pictures to be compared.
    """
    drawn = luminance(rgba[rgba[..., 3] == 1.0, :3])
    bright = float(np.quantile(drawn, 0.99)) if drawn.size else 0.0
    return WHITE_POINT / bright if math.isfinite(bright) and bright > 1e-12 else 1.0


def backdrop(size: tuple[int, int]) -> FloatArray:
    """A studio background, linear RGB (H, W, 3): grey, lighter behind the middle."""
    width, height = size
    x = (np.arange(width) + 0.5 - 0.5 * width) / height
    y = (np.arange(height) + 0.5 - 0.55 * height) / height
    glow = np.exp(-2.2 * (x * x + (1.3 * y[:, None]) ** 2))
    edge, middle = np.array([0.018, 0.019, 0.022]), np.array([0.115, 0.12, 0.13])
    return edge + glow[..., None] * (middle - edge)


def develop(rgba: FloatArray, exposure: float, background: FloatArray | None = None) -> FloatArray:
    """Expose a rendered picture, lay it over a background and encode it.

    Args:
        rgba: from ``render``, (H, W, 4).
        exposure: factor on linear colour.
        background: linear RGB that (H, W, 3) can be broadcast from; None for ``backdrop``.

    Returns:
        (H, W, 3) uint8 sRGB.
    """
    if background is None:
        background = backdrop((rgba.shape[1], rgba.shape[0]))
    linear = exposure * rgba[..., :3] + (1.0 - rgba[..., 3:]) * background
    return to_bytes(srgb_encode(linear))


def to_bytes(encoded: FloatArray) -> FloatArray:
    """[0, 1] to 0 … 255, rounded."""
    return (encoded * 255.0 + 0.5).astype(np.uint8)


def colour_map(values: FloatArray) -> FloatArray:
    """Heat colours (..., 3) uint8 sRGB of values in [0, 1], clipped to it.

    A path through OKLab [1] of even steps in lightness, from near-black blue over magenta and
    orange to pale yellow, so that equal steps of the value look equal, also in grey.

    [1] Ottosson, "A perceptual color space for image processing", 2020.
    """
    t = np.clip(np.nan_to_num(values), 0.0, 1.0)
    lightness = 0.17 + 0.79 * t
    hue = np.radians(-85.0 + 190.0 * t)
    chroma = 0.06 + 0.42 * t * (1 - t) * (1.15 - 0.35 * t)
    a, b = chroma * np.cos(hue), chroma * np.sin(hue)
    lab = np.stack([lightness, a, b], axis=-1)
    to_lms = np.array(
        [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728],
         [1, -0.0894841775, -1.2914855480]]
    )  # fmt: skip
    to_rgb = np.array(
        [[4.0767416621, -3.3077115913, 0.2309699292], [-1.2684380046, 2.6097574011, -0.3413193965],
         [-0.0041960863, -0.7034186147, 1.7076147010]]
    )  # fmt: skip
    return to_bytes(srgb_encode((lab @ to_lms.T) ** 3 @ to_rgb.T))


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture of a row.

    Attributes:
        picture: (H, W, 3) uint8 sRGB.
        caption: a line of text.
        note: a second, quieter line.
        bar: the value at the top of the colour bar and its unit; None for no bar.
    """

    picture: FloatArray
    caption: str
    note: str = ""
    bar: tuple[float, str] | None = None


def compose_panels(panels: Sequence[Panel]) -> FloatArray:
    """Panels of equal height side by side with their captions below, (H', W', 3) uint8."""
    height = panels[0].picture.shape[0]
    text = max(11, round(height * 0.032))
    gap, foot = max(4, text // 2), round(3.9 * text)
    width = sum(panel.picture.shape[1] + gap for panel in panels) - gap
    sheet = Image.new("RGB", (width, height + foot), PAPER)
    pen = ImageDraw.Draw(sheet)
    left = 0
    for panel in panels:
        sheet.paste(Image.fromarray(panel.picture), (left, 0))
        pen.text((left + text, height + 0.6 * text), panel.caption, INK, font(text))
        pen.text((left + text, height + 2.1 * text), panel.note, QUIET, font(0.85 * text))
        if panel.bar is not None:
            draw_bar(sheet, pen, left + panel.picture.shape[1], height, text, panel.bar)
        left += panel.picture.shape[1] + gap
    return np.asarray(sheet)


def font(size: float) -> Any:
    """Pillow's own font: the only one that is there on every machine."""
    return ImageFont.load_default(size=size)


def draw_bar(
    sheet: Image.Image,
    pen: ImageDraw.ImageDraw,
    right: int,
    height: int,
    text: int,
    bar: tuple[float, str],
) -> None:
    """A colour bar inside a panel, at its right edge, with its ends and unit written beside it."""
    top_value, unit = bar
    length, width = round(0.4 * height), max(6, round(0.7 * text))
    x, y = right - text - width, (height - length) // 2
    ramp = colour_map(np.linspace(1.0, 0.0, length))
    sheet.paste(Image.fromarray(np.repeat(ramp[:, None], width, axis=1)), (x, y))
    pen.rectangle((x - 1, y - 1, x + width, y + length), outline=QUIET)
    small = font(0.8 * text)
    for where, label in [(y, f"{top_value:.3g}"), (y + length // 2, f"{top_value / 2:.3g}"),
                         (y + length, "0")]:  # fmt: skip
        pen.text((x - 0.4 * text, where), label, INK, small, anchor="rm")
    pen.text((x + width, y - 0.8 * text), unit, INK, small, anchor="rs")


def laid_over(picture: FloatArray, over: FloatArray, place: tuple[int, int]) -> FloatArray:
    """A picture with a smaller one laid over it.

    Args:
        picture: (H, W, 3) uint8 sRGB.
        over: (h, w, 4) uint8 sRGB and opacity; what lies outside the picture is cut off.
        place: pixels from the left and from the top; may be negative.

    Returns:
        (H, W, 3) uint8.
    """
    sheet = Image.fromarray(picture).convert("RGBA")
    layer = Image.new("RGBA", sheet.size, (0, 0, 0, 0))
    layer.paste(Image.fromarray(over), place)
    return np.asarray(Image.alpha_composite(sheet, layer).convert("RGB"))


def comparison(
    prediction: FloatArray,
    truth: FloatArray,
    captions: tuple[str, str] = ("prediction", "ray-traced truth"),
    exposure: float | None = None,
    top: float | None = None,
) -> tuple[FloatArray, dict[str, float]]:
    """Prediction, truth, and where they differ.

    The error is the difference in luminance of the exposed pictures, in per cent of white.

    Args:
        prediction: from ``render``, (H, W, 4).
        truth: the same view of the same pose, (H, W, 4).
        captions: what to write below the first two.
        exposure: factor on linear colour; None for ``auto_exposure`` of the truth.
        top: error at the top of the scale, per cent of white; None for one that fits.

    Returns:
        (H', W', 3) uint8 and the error's ``rms``, ``p99`` and ``max`` over drawn pixels.
    """
    exposure = auto_exposure(truth) if exposure is None else exposure
    error = 100.0 * exposure * np.abs(luminance(prediction[..., :3] - truth[..., :3]))
    drawn = error[truth[..., 3] > 0]
    drawn = drawn if drawn.size else np.zeros(1, dtype=error.dtype)
    told = {
        "rms": float(np.sqrt(np.mean(np.square(drawn, dtype=np.float64)))),
        "p99": float(np.quantile(drawn, 0.99)),
        "max": float(drawn.max()),
    }
    top = rounded_up(told["p99"]) if top is None else top
    cover = truth[..., 3:]
    heat = (cover * colour_map(error / top) + (1 - cover) * np.array(PAPER)).astype(np.uint8)
    note = "rms {rms:.2f} %, 99 % below {p99:.2f} %, max {max:.1f} %".format(**told)
    panels = [
        Panel(develop(prediction, exposure), captions[0]),
        Panel(develop(truth, exposure), captions[1]),
        Panel(heat, "error", note, bar=(top, "% of white")),
    ]
    return compose_panels(panels), told


def rounded_up(value: float) -> float:
    """The next of 1, 2, 5, 10, … (times a power of ten), at least 0.1."""
    power = 10.0 ** math.floor(math.log10(max(value, 0.1)))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= value * 0.999)


def save_png(path: str | Path, picture: FloatArray) -> None:
    """Write (H, W, 3) uint8 sRGB; the file appears whole or not at all.

    Raises:
        PrtnetError: it cannot be written.
    """
    with writing(path) as partial:
        Image.fromarray(picture).save(partial, format="PNG")
