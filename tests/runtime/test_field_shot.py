"""Pictures of fields: strips and blocks are the whole picture, and bound what it takes."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from prtnet.canvas import Canvas, plane, vase
from prtnet.environment import environment
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.transfer import TransferField
from runtime import lobe_picture
from runtime.camera import Camera
from runtime.draw import RendererName
from runtime.field_shot import FieldShot
from runtime.gl import available
from tests.runtime.test_lobe_stage import bumpy, own_mesh

RENDERERS: list[RendererName] = ["cpu", "gl"] if available() else ["cpu"]


def shot(canvas: Canvas, order: int, size: tuple[int, int]) -> FieldShot:
    """From above, so that the picture is not symmetric."""
    camera = Camera.framing(canvas.positions, size[0] / size[1], 0.4, 0.5)
    return FieldShot(canvas, environment("studio").harmonics(order), camera, size)


FIELDS = {
    "transfer": lambda: (bumpy(1, 4), vase(3, 0.8)),
    "lobes": lambda: (lobe_field(bumpy(1, 4), 3), vase(3, 0.8).twisted(0.7)),
    "glossy lobes": lambda: (lobe_field(bumpy(3, 4), 2), vase(3, 0.8)),
    "a mesh": lambda: own_mesh(2, 4, 3),
}


@pytest.mark.parametrize(
    ("name", "renderer"),
    [*((name, "cpu") for name in FIELDS), *((name, "gl") for name in list(FIELDS)[1:])],
)
def test_strips_and_blocks_are_the_picture(name, renderer, monkeypatch):
    field, canvas = FIELDS[name]()
    if renderer not in RENDERERS:
        pytest.skip("no OpenGL")
    taken = shot(canvas, 4, (30, 21))
    whole = taken.draw(field, renderer)
    assert 0.1 < (whole[..., 3] > 0).mean() < 0.9
    for strip, block in ((1, 1 << 14), (60 * 12, 300)):
        monkeypatch.setattr(lobe_picture, "STRIP", strip)
        monkeypatch.setattr(lobe_picture, "BLOCK", block)
        again = taken.draw(field, renderer)
        assert again.shape == whole.shape
        if renderer == "cpu":
            np.testing.assert_allclose(again, whole, atol=1e-6)
        else:  # a rasteriser may cut triangles anew in another framebuffer
            assert (np.abs(again - whole).max(axis=-1) < 1e-3).mean() > 0.999


@pytest.mark.parametrize(("size", "scale"), [((640, 480), 1), ((640, 480), 2), ((8192, 3), 4)])
def test_a_strip_has_whole_pixels(size, scale):
    rows = lobe_picture.strip_rows(size, scale)
    assert rows % scale == 0
    assert rows > 0
    assert rows == scale or rows * size[0] <= lobe_picture.STRIP


def peak(field: LobeField | TransferField, canvas: Canvas, size: tuple[int, int]) -> int:
    """Bytes that a picture takes beside itself, at most."""
    taken = shot(canvas, field.order, size)
    tracemalloc.start()
    picture = taken.draw(field, samples=1)
    found = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return found - 2 * picture.nbytes


def test_memory_is_that_of_a_strip(monkeypatch):
    """A picture sixteen times as large takes hardly more."""
    monkeypatch.setattr(lobe_picture, "STRIP", 1 << 12)
    monkeypatch.setattr(lobe_picture, "BLOCK", 1 << 9)
    field, canvas = bumpy(3, 4), plane(2)
    small, large = peak(field, canvas, (48, 48)), peak(field, canvas, (192, 192))
    assert large < 1.25 * small + (1 << 18)
