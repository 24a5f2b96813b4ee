from __future__ import annotations

import numpy as np
import pytest

from prtnet.errors import PrtnetError
from runtime import gl
from runtime.draw import opened, render
from runtime.gl import GLRenderer, texture_data
from runtime.shading import Surface
from tests.runtime.scenes import knot, sky, three_quarters


def test_texture_keeps_every_vertex_in_whole_texels():
    transfer = np.arange(5000 * 9, dtype=np.float32).reshape(5000, 9)
    data = texture_data(transfer)
    columns = gl.TEXTURE_WIDTH // 3
    assert data.shape == (-(-5000 // columns), columns * 3, 4)
    vertex = 1234
    texels = data[vertex // columns, (vertex % columns) * 3 :][:3].ravel()
    np.testing.assert_array_equal(texels[:9], transfer[vertex])
    np.testing.assert_array_equal(texels[9:], 0)


def test_without_egl_the_user_is_told_what_to_do(monkeypatch):
    def broken(*_args: object, **_kwargs: object) -> None:
        raise Exception("libEGL not loaded")  # as bare as glcontext's

    monkeypatch.setattr(gl.moderngl, "create_context", broken)
    assert not gl.available()
    with pytest.raises(PrtnetError, match=r"libEGL not loaded.*--renderer cpu"):
        GLRenderer()


@pytest.mark.gl
def test_available_here():
    assert gl.available()


@pytest.mark.gl
@pytest.mark.parametrize("order", [1, 2, 3, 4, 5, 6])
def test_every_order_fills_its_texels(order):
    surface, light, size = knot(order), sky(order), (64, 48)
    with opened("gl") as renderer:
        drawn = render(renderer, surface, light, three_quarters(surface, size), size, samples=1)
    with opened("cpu") as renderer:
        expected = render(renderer, surface, light, three_quarters(surface, size), size, samples=1)
    assert drawn[..., 3].mean() > 0.2
    # Drivers snap corners for coverage but need not for colour: up to 1/512 pixel of its slope.
    assert np.mean(np.abs(drawn - expected).max(-1) > 1e-3) < 1e-3


@pytest.mark.gl
def test_the_front_and_the_back_have_their_own_transfer():
    size = (16, 16)
    positions = np.array([[-1, -1, 0], [3, -1, 0], [-1, 3, 0]], dtype=np.float32)
    front, back = np.full((3, 4), 1.0), np.full((3, 4), 2.0)
    light = np.zeros((4, 3))
    light[0] = 1.0
    with GLRenderer() as renderer:
        for faces, expected in [([[0, 1, 2]], 1.0), ([[0, 2, 1]], 2.0)]:
            surface = Surface(positions, np.array(faces), front, back)
            drawn = renderer.draw(surface, light, np.eye(4), size)
            assert (drawn[..., :3] == expected).all()
        single = Surface(positions, np.array([[0, 2, 1]]), front)
        assert (renderer.draw(single, light, np.eye(4), size)[..., :3] == 1.0).all()


@pytest.mark.gl
def test_one_renderer_draws_many_pictures_and_contexts_do_not_disturb_each_other():
    small, large = knot(2, detail=1), knot(4, two_sided=True)
    size = (40, 30)
    with GLRenderer() as first:
        alone = render(first, large, sky(4), three_quarters(large, size), size)
        with GLRenderer() as second:
            render(second, small, sky(2), three_quarters(small, size), (20, 20))
            again = render(first, large, sky(4), three_quarters(large, size), size)
        after = render(first, large, sky(4), three_quarters(large, size), size)
    np.testing.assert_array_equal(alone, again)
    np.testing.assert_array_equal(alone, after)


@pytest.mark.gl
def test_a_mesh_that_fits_no_texture_is_refused(monkeypatch):
    monkeypatch.setattr(gl, "TEXTURE_WIDTH", 4)
    count = 17_000
    surface = Surface(
        np.zeros((count, 3), np.float32), np.zeros((1, 3), np.int32), np.zeros((count, 16))
    )
    with GLRenderer() as renderer, pytest.raises(PrtnetError, match="do not fit"):
        renderer.draw(surface, np.zeros((16, 3)), np.eye(4), (8, 8))
