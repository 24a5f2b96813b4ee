"""The visibility of one vertex, drawn on a sphere as the camera would see it there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw

from prtnet.arrays import FloatArray
from prtnet.modelled_scene import ModelledScene
from prtnet.sh import evaluate
from runtime.camera import Camera
from runtime.error_pictures import vertex_error
from runtime.pick import projected
from runtime.picture import INK, PAPER, QUIET, font, to_bytes
from runtime.posed_surface import sides
from runtime.reflected import Subject

__all__ = ["inset_of", "marker", "receiver_at", "sphere_picture", "vertex_inset"]

RING = 13  # pixels across, around the vertex
MARGIN = 8  # pixels between the spheres and the edge

BELOW = 0.35  # brightness below the horizon, where visibility is 1 by definition


def sphere_picture(
    visibility: FloatArray, frame: FloatArray, camera: Camera, diameter: int
) -> FloatArray:
    """Visibility by direction, on a sphere seen from the camera: white where light comes in.

    Directions below the vertex's horizon are darker. What an order-limited function has below 0 is
    bluish, above 1 reddish.

    Args:
        visibility: in the vertex's frame, (n²,).
        frame: columns tangent, bitangent, normal, (3, 3) world space.
        camera: whose axes are used; the sphere is seen from far away.
        diameter: pixels.

    Returns:
        (diameter, diameter, 4) uint8, sRGB and coverage, top row first.
    """
    across = (np.arange(diameter) + 0.5) * 2.0 / diameter - 1.0
    x, y = np.meshgrid(across, -across)
    radius = np.hypot(x, y)
    shrunk = np.maximum(radius, 1.0)  # the rim's pixels lie partly outside
    x, y = x / shrunk, y / shrunk
    seen = np.stack([x, y, np.sqrt(np.maximum(0.0, 1.0 - x * x - y * y))], axis=-1)
    local = seen @ camera.view()[:3, :3] @ frame.astype(np.float64)
    order = round(len(visibility) ** 0.5)
    value = evaluate(local, order) @ visibility.astype(np.float64)
    grey = np.clip(value, 0.0, 1.0)
    below, above = np.clip(-value, 0.0, 0.5), np.clip(value - 1.0, 0.0, 0.5)
    colour = np.stack([grey, grey - above, grey - above + 2.0 * below], axis=-1)
    colour = np.clip(colour, 0.0, 1.0) * np.where(local[..., 2:] < 0.0, BELOW, 1.0)
    cover = np.clip((1.0 - radius) * 0.5 * diameter + 0.5, 0.0, 1.0)
    return to_bytes(np.concatenate([0.06 + 0.94 * colour, cover[..., None]], axis=-1))


def vertex_inset(
    title: str,
    visibilities: Sequence[tuple[str, FloatArray]],
    frame: FloatArray,
    camera: Camera,
    diameter: int,
) -> FloatArray:
    """Spheres side by side with their captions, on a dark ground.

    Args:
        title: above them.
        visibilities: a caption and (n²,) for each.
        frame: of the vertex, (3, 3).
        camera: whose axes are used.
        diameter: of a sphere, pixels.

    Returns:
        (H, W, 4) uint8 sRGB and opacity.
    """
    text, gap = max(10, diameter // 9), max(4, diameter // 16)
    size = (
        len(visibilities) * (diameter + gap) + gap,
        diameter + 2 * gap + 3 * text,
    )
    sheet = Image.new("RGBA", size, (*PAPER, 215))
    pen = ImageDraw.Draw(sheet)
    pen.text((gap, 0.3 * text), title, INK, font(text))
    for column, (caption, visibility) in enumerate(visibilities):
        left, top = gap + column * (diameter + gap), gap + round(1.4 * text)
        ball = Image.fromarray(sphere_picture(visibility, frame, camera, diameter))
        sheet.alpha_composite(ball, (left, top))
        middle = left + diameter / 2
        pen.text((middle, top + diameter + 0.2 * text), caption, QUIET, font(text), anchor="ma")
    return np.asarray(sheet)


def inset_of(
    subject: Subject,
    vertex: tuple[int, bool],
    visibilities: Sequence[tuple[str, FloatArray]],
    camera: Camera,
    size: tuple[int, int],
) -> list[tuple[FloatArray, tuple[int, int]]]:
    """Pictures to lay over one of a character: a ring around a vertex, and its spheres.

    Args:
        subject: the character in its pose; visibility is not looked at.
        vertex: of the render mesh, and whether its back is meant.
        visibilities: a caption and the visibility of its receiver, (n²,), for each sphere.
        camera: of the picture.
        size: of the picture, in pixels.

    Returns:
        (H, W, 4) uint8 pictures and where they go, pixels from the left and from the top.
    """
    number, back = vertex
    side = (subject.front, subject.back)[back]
    assert side is not None
    error = ""
    if len(visibilities) == 2:
        one, other = (each[None] for _, each in visibilities)
        error = f", error {100.0 * float(vertex_error(one, other)[0]):.1f} %"
    inset = vertex_inset(
        f"vertex {number}{' (back)' if back else ''}{error}",
        visibilities,
        side.frames[number],
        camera,
        min(max(size[1] // 5, 64), 320),
    )
    matrix = camera.matrix(size[0] / size[1])
    x, y, _ = projected(subject.positions[number : number + 1], matrix, size)[0]
    corner = (size[0] - inset.shape[1] - MARGIN, size[1] - inset.shape[0] - MARGIN)
    return [(marker(RING), (round(x - RING / 2), round(y - RING / 2))), (inset, corner)]


def receiver_at(actor: ModelledScene, vertex: tuple[int, bool]) -> int:
    """The receiver of a vertex of the render mesh, or of its back."""
    receivers = sides(actor)[vertex[1]]
    assert receivers is not None
    return int(receivers[vertex[0]])


def marker(diameter: int) -> FloatArray:
    """A ring to put around a vertex, (diameter, diameter, 4) uint8."""
    across = (np.arange(diameter) + 0.5) * 2.0 / diameter - 1.0
    radius = np.hypot(*np.meshgrid(across, across)) * 0.5 * diameter
    cover = np.clip(1.5 - np.abs(radius - 0.5 * diameter + 1.5), 0.0, 1.0)
    ring: FloatArray = np.empty((diameter, diameter, 4), dtype=np.uint8)
    ring[..., :3] = (255, 196, 64)
    ring[..., 3] = np.round(255.0 * cover)
    return ring
