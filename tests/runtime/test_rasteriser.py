from __future__ import annotations

import math

import numpy as np
import pytest

from runtime import rasteriser
from runtime.camera import Camera
from runtime.rasteriser import rasterise

GREY = np.full((3, 3), 0.5)


def pixels(points: np.ndarray, size: tuple[int, int], z: float = 0.0) -> np.ndarray:
    """Positions (N, 3) that the identity matrix puts at pixel coordinates (x right, y down)."""
    points = np.asarray(points, dtype=float)
    x, y = points[:, 0] / size[0] * 2 - 1, 1 - points[:, 1] / size[1] * 2
    return np.stack([x, y, np.full(len(points), z)], axis=1)


def brute_coverage(corners: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Whether each pixel's centre is strictly inside, by cross products, in the obvious way."""
    y, x = np.mgrid[: size[1], : size[0]] + 0.5
    sides = []
    for k in range(3):
        p, q = corners[k], corners[(k + 1) % 3]
        sides.append((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]))
    sides = np.stack(sides)
    return (sides > 0).all(axis=0) | (sides < 0).all(axis=0)


def test_covers_the_pixels_whose_centres_are_inside():
    rng = np.random.default_rng(0)
    size = (37, 23)
    for _ in range(50):
        # An odd multiple of 1/512 off the grid of centres: none is on an edge after snapping.
        corners = np.round(rng.uniform(-9, 45, (3, 2)) * 64) / 64 + 1 / 256
        drawn = rasterise(pixels(corners, size), np.array([[0, 1, 2]]), GREY, np.eye(4), size)
        expected = brute_coverage(corners, size)
        edge = brute_coverage(corners + 1e-9, size) != brute_coverage(corners - 1e-9, size)
        np.testing.assert_array_equal((drawn[..., 3] == 1)[~edge], expected[~edge])


def test_first_row_is_the_top():
    size = (8, 8)
    corners = pixels(np.array([[0, 0], [8, 0], [0, 4]]), size)
    drawn = rasterise(corners, np.array([[0, 1, 2]]), GREY, np.eye(4), size)
    assert drawn[0, 0, 3] == 1
    assert drawn[4:, :, 3].sum() == 0


def test_the_nearer_surface_hides_the_farther_whichever_comes_first():
    size = (16, 16)
    square = np.array([[0, 0], [16, 0], [16, 16], [0, 16]])
    near, far = pixels(square, size, -0.5), pixels(square, size, 0.5)
    red, green = np.tile([1.0, 0, 0], (4, 1)), np.tile([0.0, 1, 0], (4, 1))
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    for first, second, colours in [(near, far, (red, green)), (far, near, (green, red))]:
        drawn = rasterise(
            np.concatenate([first, second]), np.concatenate([faces, faces + 4]),
            np.concatenate(colours), np.eye(4), size,
        )  # fmt: skip
        assert (drawn == [1, 0, 0, 1]).all()


def test_crossing_surfaces_cut_each_other_where_they_meet():
    size = (20, 20)
    flat = pixels(np.array([[0, 0], [20, 0], [20, 20], [0, 20]]), size, 0.0)
    tilted = flat + np.array([[0, 0, -0.5], [0, 0, 0.5], [0, 0, 0.5], [0, 0, -0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    colours = np.repeat([[1.0, 0, 0], [0, 1.0, 0]], 4, axis=0)
    drawn = rasterise(
        np.concatenate([flat, tilted]), np.concatenate([faces, faces + 4]), colours, np.eye(4), size
    )
    assert (drawn[:, :10, 1] == 1).all()
    assert (drawn[:, 10:, 0] == 1).all()


@pytest.mark.parametrize("step", [1, 7, 40])
def test_strips_are_the_picture(step):
    """Bit for bit, also where triangles cross, share edges and leave the picture."""
    rng = np.random.default_rng(4)
    size = (50, 40)
    points = pixels(rng.uniform(-20, 70, (60, 2)), size)
    points[:, 2] = rng.uniform(-0.9, 0.9, 60)
    faces, colours, back = rng.integers(0, 60, (90, 3)), *rng.random((2, 60, 5))
    given = points, faces, colours, np.eye(4), size, back
    whole = rasterise(*given)
    strips = [rasterise(*given, (top, min(top + step, 40))) for top in range(0, 40, step)]
    np.testing.assert_array_equal(np.concatenate(strips), whole)
    assert len(np.unique(whole[..., 0])) > 500


@pytest.mark.parametrize("block", [1, 1000])
def test_of_equally_deep_surfaces_the_first_drawn_stays(monkeypatch, block):
    monkeypatch.setattr(rasteriser, "FACE_BLOCK", block)
    size = (6, 6)
    corners = pixels(np.array([[0, 0], [12, 0], [0, 12]]), size)
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    colours = np.repeat([[1.0, 0, 0], [0, 1.0, 0]], 3, axis=0)
    drawn = rasterise(np.concatenate([corners, corners]), faces, colours, np.eye(4), size)
    assert (drawn == [1, 0, 0, 1]).all()


def test_each_side_has_its_own_colour():
    size = (6, 6)
    corners = pixels(np.array([[0, 0], [0, 12], [12, 0]]), size)  # counter-clockwise, y down
    front, back = np.tile([1.0, 0, 0], (3, 1)), np.tile([0, 0, 1.0], (3, 1))
    seen = rasterise(corners, np.array([[0, 1, 2]]), front, np.eye(4), size, back)
    turned = rasterise(corners, np.array([[0, 2, 1]]), front, np.eye(4), size, back)
    single = rasterise(corners, np.array([[0, 2, 1]]), front, np.eye(4), size)
    assert (seen[0, 0] == [1, 0, 0, 1]).all()
    assert (turned[0, 0] == [0, 0, 1, 1]).all()
    assert (single[0, 0] == [1, 0, 0, 1]).all()


def test_colour_is_linear_on_the_surface_not_on_the_screen():
    # A floor seen at a slant, coloured by its own position: each pixel must show the place that
    # the ray through its centre hits.
    camera = Camera(eye=(0.3, 1.0, 2.0), target=(0.0, 0.0, -1.0), near=0.1, far=50.0)
    corners = np.array([[-4, 0, 1], [4, 0, 1], [4, 0, -9], [-4, 0, -9]], dtype=float)
    size = (64, 48)
    drawn = rasterise(
        corners, np.array([[0, 1, 2], [0, 2, 3]]), corners, camera.matrix(64 / 48), size
    )
    row, column = np.nonzero(drawn[..., 3])
    assert len(row) > 1000
    unproject = np.linalg.inv(camera.matrix(64 / 48))
    x, y = (column + 0.5) / 64 * 2 - 1, 1 - (row + 0.5) / 48 * 2
    ends = [np.stack([x, y, np.full(len(x), z), np.ones(len(x))], 1) @ unproject.T for z in (-1, 1)]
    near, far = (end[:, :3] / end[:, 3:] for end in ends)
    hit = near + (near[:, 1] / (near[:, 1] - far[:, 1]))[:, None] * (far - near)
    distance = np.linalg.norm(hit - camera.eye, axis=1)
    # Snapping moves corners by up to 1/512 pixel, and a pixel is a longer piece of floor far away.
    error = np.abs(drawn[row, column, :3] - hit).max(axis=1)
    assert (error < 2e-3 * (distance / 3) ** 2).all()


def test_a_floor_through_the_eye_is_cut_at_the_near_plane():
    # The floor runs under and behind the camera: everything below the horizon shows it.
    camera = Camera(eye=(0.0, 1.0, 0.0), target=(0.0, 1.0, -1.0), near=0.01, far=1e5)
    corners = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]]) * 4e4
    drawn = rasterise(
        corners, np.array([[0, 1, 2], [0, 2, 3]]), np.ones((4, 3)), camera.matrix(1.0), (64, 64)
    )
    assert (drawn[33:, :, 3] == 1).all()
    assert (drawn[:32, :, 3] == 0).all()
    np.testing.assert_allclose(drawn[33:, :, :3], 1.0)


def test_what_is_behind_the_camera_or_beyond_far_is_not_drawn():
    camera = Camera(eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, -1.0), near=0.1, far=10.0)
    for z in (5.0, -0.05, -20.0):
        corners = np.array([[-1, -1, z], [1, -1, z], [0, 1, z]])
        drawn = rasterise(corners, np.array([[0, 1, 2]]), GREY, camera.matrix(1.0), (16, 16))
        assert not drawn.any()


def test_blocks_do_not_show(monkeypatch):
    rng = np.random.default_rng(4)
    corners = np.concatenate([rng.uniform(-1.3, 1.3, (90, 2)), rng.uniform(-1, 1, (90, 1))], 1)
    faces = np.arange(90).reshape(-1, 3)
    colours = rng.uniform(size=(90, 3))
    whole = rasterise(corners, faces, colours, np.eye(4), (50, 40))
    monkeypatch.setattr(rasteriser, "BLOCK", 97)
    monkeypatch.setattr(rasteriser, "FACE_BLOCK", 7)
    np.testing.assert_array_equal(rasterise(corners, faces, colours, np.eye(4), (50, 40)), whole)


def test_nothing_to_draw():
    empty = np.empty((0, 3))
    drawn = rasterise(empty, np.empty((0, 3), dtype=int), empty, np.eye(4), (5, 4))
    assert drawn.shape == (4, 5, 4)
    assert not drawn.any()


@pytest.mark.parametrize("fov", [10.0, 60.0, 120.0])
def test_a_sphere_has_the_outline_of_a_cone(fov):
    # A sphere of radius r at distance d fills the cone sin(angle) = r/d around its axis.
    from trimesh.creation import icosphere

    sphere = icosphere(subdivisions=5)
    camera = Camera(eye=(0.0, 0.0, 6.0), target=(0.0, 0.0, 0.0), fov=math.radians(fov), near=1.0)
    colours = np.ones((len(sphere.vertices), 3))
    drawn = rasterise(sphere.vertices, sphere.faces, colours, camera.matrix(1.0), (200, 200))
    radius = math.tan(math.asin(1 / 6)) / math.tan(math.radians(fov) / 2) * 100
    area = min(math.pi * radius**2, 200 * 200)
    if radius < 100:
        # Chords cut a little off the outline; counting centres errs by less than the perimeter.
        assert drawn[..., 3].sum() == pytest.approx(area, abs=0.004 * area + 0.5 * radius)
