from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet.errors import PrtnetError
from runtime.camera import Camera
from runtime.draw import opened, render, usable
from runtime.shading import Surface
from tests.runtime.scenes import knot, sky, three_quarters

CAMERA = Camera(eye=(0.0, 0.0, 2.0), target=(0.0, 0.0, 0.0), fov=math.radians(90))


def wall(colour: float) -> Surface:
    """A square that fills the left half of the picture and more."""
    positions = np.array([[-9, -9, 0], [0, -9, 0], [0, 9, 0], [-9, 9, 0]], dtype=np.float32)
    transfer = np.full((4, 1), colour * math.pi, dtype=np.float32)
    return Surface(positions, np.array([[0, 1, 2], [0, 2, 3]]), transfer)


def test_a_wall_shows_its_albedo_times_the_light():
    with opened("cpu") as renderer:
        drawn = render(renderer, wall(0.5), np.array([[1.0, 2, 3]]), CAMERA, (8, 6), albedo=0.6)
    np.testing.assert_allclose(drawn[:, :4], np.broadcast_to([0.3, 0.6, 0.9, 1], (6, 4, 4)))
    assert not drawn[:, 4:].any()


def test_more_samples_soften_edges_and_keep_colour_times_coverage():
    with opened("cpu") as renderer:
        drawn = render(renderer, wall(1.0), np.ones((1, 3)), CAMERA, (9, 5), albedo=1.0)
        hard = render(renderer, wall(1.0), np.ones((1, 3)), CAMERA, (9, 5), 1.0, samples=1)
    np.testing.assert_allclose(drawn[:, 4], 0.5)  # the edge runs through the middle column
    assert set(np.unique(hard)) <= {0.0, 1.0}
    np.testing.assert_array_equal(drawn[:, :4], hard[:, :4])


def test_supersampling_is_the_mean_of_the_finer_picture():
    surface, size = knot(detail=1), (30, 20)
    camera = three_quarters(surface, size)
    with opened("cpu") as renderer:
        fine = render(renderer, surface, sky(), camera, (90, 60), samples=1)
        drawn = render(renderer, surface, sky(), camera, size, samples=9)
    mean = fine.reshape(20, 3, 30, 3, 4).mean(axis=(1, 3))
    np.testing.assert_allclose(drawn, mean, atol=1e-6)


def test_what_cannot_be_drawn_is_said():
    with pytest.raises(PrtnetError, match="did you mean 'gl'"), opened("g"):
        pass
    with opened("cpu") as renderer:
        with pytest.raises(PrtnetError, match="too large"):
            render(renderer, wall(1.0), np.ones((1, 3)), CAMERA, (40_000, 10))
        with pytest.raises(PrtnetError, match="too large"):
            render(renderer, wall(1.0), np.ones((1, 3)), CAMERA, (8_000, 8_000))
        with pytest.raises(ValueError, match="square"):
            render(renderer, wall(1.0), np.ones((1, 3)), CAMERA, (8, 8), samples=3)


@pytest.mark.parametrize(("there", "chosen"), [(True, "gl"), (False, "cpu")])
def test_numpy_draws_where_opengl_does_not(
    monkeypatch: pytest.MonkeyPatch, there: bool, chosen: str
) -> None:
    said: list[str] = []
    monkeypatch.setattr("runtime.gl.available", lambda: there)
    assert usable(said.append) == chosen
    assert bool(said) is not there
