"""What a model gets wrong in a pose, on the character: prediction, truth, and error by vertex."""

from __future__ import annotations

import base64
import dataclasses
import io
import math
from dataclasses import dataclass

import numpy as np
from PIL import Image

from prtnet.arrays import FloatArray
from prtnet.dataset import Dataset
from prtnet.luminance import luminance
from runtime.camera import Camera
from runtime.draw import Renderer, render, render_colours
from runtime.picture import (
    auto_exposure,
    backdrop,
    colour_map,
    develop,
    rounded_up,
    srgb_encode,
    to_bytes,
)
from runtime.posed_surface import recorded_surface
from runtime.shading import Surface

__all__ = ["ErrorPictures", "data_uri", "draw_error", "error_scale", "vertex_error"]


@dataclass(frozen=True, eq=False)
class ErrorPictures:
    """Three pictures of one pose, each (H, W, 3) uint8 sRGB."""

    prediction: FloatArray
    truth: FloatArray
    error: FloatArray


def vertex_error(predicted: FloatArray, truth: FloatArray) -> FloatArray:
    """‖ṽ − v‖ of receivers (V, n²) over that of an open one, √(4π): (V,), a fraction."""
    return np.linalg.norm(predicted - truth, axis=-1) / math.sqrt(4.0 * math.pi)


def error_scale(errors: FloatArray) -> float:
    """A round per cent at the top of the colours, for vertex errors (...) as fractions."""
    return rounded_up(100.0 * float(np.quantile(errors, 0.99)))


def draw_error(
    renderer: Renderer,
    dataset: Dataset,
    row: int,
    predicted: FloatArray,
    light: FloatArray,
    top: float,
    size: tuple[int, int] = (480, 480),
) -> ErrorPictures:
    """Draw one pose three times, in the same view and exposure.

    Args:
        renderer: from ``runtime.draw.opened``.
        dataset: holds the pose and its ray-traced visibility.
        row: the pose.
        predicted: visibility in local frames, (V, n²).
        light: SH coefficients of the environment's radiance, (n², 3).
        top: vertex error at the end of the colours, per cent of an open vertex.
        size: width and height in pixels.
    """
    truth = dataset.read("visibility", row)
    surface = recorded_surface(dataset, row, truth)
    camera = Camera.framing(surface.positions, size[0] / size[1])
    shaded = render(renderer, surface, light, camera, size)
    exposure = auto_exposure(shaded)
    guess = render(renderer, recorded_surface(dataset, row, predicted), light, camera, size)
    wrong = painted(surface, 100.0 * vertex_error(predicted, truth) / top)
    heat = render_colours(renderer, wrong, camera, size)
    return ErrorPictures(develop(guess, exposure), develop(shaded, exposure), heat_picture(heat))


def painted(surface: Surface, values: FloatArray) -> Surface:
    """The surface with a grey of its own at every vertex: values of receivers (V,)."""
    grey = np.repeat(values.astype(np.float32)[:, None], 3, axis=1)
    fronts = len(surface.positions)
    back = None if surface.back_transfer is None else grey[fronts:]
    return dataclasses.replace(surface, transfer=grey[:fronts], back_transfer=back)


def heat_picture(rgba: FloatArray) -> FloatArray:
    """Heat colours of a rendered grey (H, W, 4), over the background of other pictures."""
    cover = rgba[..., 3:]
    value = luminance(rgba[..., :3])[..., None] / np.maximum(cover, 1e-6)
    behind = to_bytes(srgb_encode(backdrop((rgba.shape[1], rgba.shape[0]))))
    mixed = cover * colour_map(value[..., 0]) + (1.0 - cover) * behind
    return (mixed + 0.5).astype(np.uint8)


def data_uri(picture: FloatArray) -> str:
    """A picture (H, W, 3) uint8 as a PNG inside a ``data:`` address."""
    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
