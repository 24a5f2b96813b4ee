"""What is under the mouse, against the rasteriser, which knows what is seen at every pixel."""

from __future__ import annotations

import numpy as np
import pytest

from runtime.camera import Camera
from runtime.pick import picked, projected
from runtime.rasteriser import rasterise
from tests.runtime.scenes import knot_subject, three_quarters

SIZE = (120, 90)


def test_every_pixel_picks_what_the_rasteriser_draws_there():
    """Colours are places in space: the picked vertex is a corner of the triangle drawn there."""
    subject = knot_subject()
    camera = three_quarters(subject, SIZE)
    matrix = camera.matrix(SIZE[0] / SIZE[1])
    white, black = np.ones_like(subject.positions), np.zeros_like(subject.positions)
    arrays = subject.positions, subject.faces
    drawn = rasterise(*arrays, subject.positions, matrix, SIZE)
    sides = rasterise(*arrays, white, matrix, SIZE, black)
    longest = max(np.linalg.norm(subject.positions[subject.faces[:, k]]
                                 - subject.positions[subject.faces[:, k - 1]], axis=1).max()
                  for k in range(3))  # fmt: skip
    rng = np.random.default_rng(0)
    hits = 0
    for x, y in zip(rng.integers(0, SIZE[0], 400), rng.integers(0, SIZE[1], 400), strict=True):
        found = picked(*arrays, matrix, SIZE, (x + 0.5, y + 0.5))
        assert (found is not None) == (drawn[y, x, 3] > 0)
        if found is not None:
            hits += 1
            vertex, back = found
            away = np.linalg.norm(subject.positions[vertex] - drawn[y, x, :3])
            assert away <= 0.8 * longest
            assert back == (sides[y, x, 0] == 0.0)
    assert 100 < hits < 350


def test_of_triangles_that_cross_the_one_in_front_is_picked():
    """Steep ones, so that the depth between corners decides; each has a colour of its own."""
    rng = np.random.default_rng(1)
    positions = rng.uniform(-1.0, 1.0, (36, 3))
    faces = np.arange(36, dtype=np.int32).reshape(12, 3)
    camera = Camera((0.0, 0.0, 4.0), (0.0, 0.0, 0.0))
    matrix = camera.matrix(SIZE[0] / SIZE[1])
    number = np.repeat(np.arange(12), 3)[:, None] * np.ones((1, 3))
    drawn = rasterise(positions, faces, number, matrix, SIZE)
    right, hits = 0, 0
    for y in range(0, SIZE[1], 3):
        for x in range(0, SIZE[0], 3):
            found = picked(positions, faces, matrix, SIZE, (x + 0.5, y + 0.5))
            if found is not None:
                hits += 1
                right += found[0] // 3 == round(drawn[y, x, 0])
    assert hits > 200
    assert right >= 0.99 * hits


def test_the_nearest_corner_of_the_nearest_triangle():
    triangle = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    positions = np.concatenate([triangle - np.eye(3)[2], triangle, triangle - 2 * np.eye(3)[2]])
    faces = np.arange(9).reshape(3, 3)
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    matrix = camera.matrix(1.0)
    places = projected(positions, matrix, (100, 100))
    for corner in (3, 4, 5):
        near = 0.8 * places[corner, :2] + 0.2 * places[3:6, :2].mean(axis=0)
        assert picked(positions, faces, matrix, (100, 100), tuple(near)) == (corner, False)
        turned = picked(positions, faces[:, ::-1], matrix, (100, 100), tuple(near))
        assert turned == (corner, True)
    assert picked(positions, faces, matrix, (100, 100), (1.0, 1.0)) is None


def test_places_are_pixels_from_the_top_left():
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    aside = 5.0 * np.tan(camera.fov / 2)
    points = np.array([[0.0, 0, 0], [2 * aside, aside, 0], [-2 * aside, -aside, 0]])
    places = projected(points, camera.matrix(2.0), (200, 100))
    assert places == pytest.approx(np.array([[100, 50, 5], [200, 0, 5], [0, 100, 5]]), abs=1e-9)


def test_what_is_behind_the_eye_is_not_picked():
    triangle = np.array([[-1.0, -1, 9], [1, -1, 9], [0, 1, 9]])
    camera = Camera((0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
    found = picked(triangle, np.array([[0, 1, 2]]), camera.matrix(1.0), (10, 10), (5.0, 5.0))
    assert found is None
