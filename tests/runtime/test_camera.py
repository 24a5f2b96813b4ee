from __future__ import annotations

import math

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from runtime.camera import Camera


def project(camera: Camera, points: np.ndarray, aspect: float) -> np.ndarray:
    """Normalised device coordinates (N, 3) of points."""
    clip = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ camera.matrix(aspect).T
    return clip[:, :3] / clip[:, 3:]


def test_the_view_is_rigid_and_right_handed():
    view = Camera(eye=(1.0, 2.0, 3.0), target=(-2.0, 0.5, 0.0)).view()
    np.testing.assert_allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3), atol=1e-15)
    assert np.linalg.det(view[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(view @ [1, 2, 3, 1], [0, 0, 0, 1], atol=1e-15)


def test_what_is_seen_where():
    camera = Camera(
        eye=(0.0, 0.0, 5.0), target=(0.0, 0.0, 0.0), fov=math.radians(90), near=1, far=9
    )
    points = np.array([[0, 0, 0], [5, 0, 0], [0, 5, 0], [0, 0, 4], [0, 0, -4]], dtype=float)
    seen = project(camera, points, aspect=2.0)
    # At distance 5 half the picture's height is 5·tan 45°; it is twice as wide as high.
    np.testing.assert_allclose(seen[:3, :2], [[0, 0], [0.5, 0], [0, 1]], atol=1e-15)
    np.testing.assert_allclose(seen[3:, 2], [-1, 1], atol=1e-14)


def test_straight_down_has_a_definite_up():
    camera = Camera(eye=(0.0, 5.0, 0.0), target=(0.0, 0.0, 0.0))
    seen = project(camera, np.array([[0.1, 0, 0], [0, 0, -0.1]]), 1.0)
    assert np.isfinite(seen).all()
    assert abs(np.linalg.det(seen[:, :2])) > 0


clouds = st.tuples(st.integers(0, 2**31), st.floats(1e-3, 1e5), st.floats(0, 1e3)).map(
    lambda a: (np.random.default_rng(a[0]).normal(size=(3, 30, 3)) * [1, 3, 0.5] + a[2]) * a[1]
)


@given(clouds, st.floats(0.3, 3), st.floats(-3.2, 3.2), st.floats(-1.2, 1.2))
def test_framing_is_the_tightest_that_sees_all_poses(points, aspect, azimuth, elevation):
    camera = Camera.framing(points, aspect, azimuth, elevation, margin=1.0)
    seen = project(camera, points.reshape(-1, 3), aspect)
    assert np.abs(seen[:, 2]).max() < 1
    low, high = seen[:, :2].min(axis=0), seen[:, :2].max(axis=0)
    tolerance = 1e-6 * (1 + np.abs(points).max() / np.ptp(points))
    assert max(high.max(), -low.min()) <= 1 + tolerance
    if camera.near > 0.26 * (camera.far / 2 - 2 * camera.near):  # not held back by the near plane
        # Both sides of the direction that decides are touched.
        assert np.minimum(high, -low).max() >= 1 - tolerance


@pytest.mark.parametrize("offset", [1e3, -1e5, 1e8])
def test_framing_goes_along_with_its_subject(offset):
    """Also where it is seen edge-on: what is thin along the view."""
    points = np.random.default_rng(1).normal(size=(50, 3)) * [1.0, 1.0, 1e-3]
    near = Camera.framing(points, 1.0, 0.0, 0.0)
    far = Camera.framing(points + offset, 1.0, 0.0, 0.0)
    loose = 1e-15 * abs(offset) * 100
    np.testing.assert_allclose(np.array(far.eye) - offset, near.eye, atol=loose)
    np.testing.assert_allclose([far.near, far.far], [near.near, near.far], atol=loose)


def test_margin_shrinks_the_subject():
    points = np.random.default_rng(0).normal(size=(50, 3))
    seen = project(Camera.framing(points, 1.5, margin=1.25), points, 1.5)
    assert np.abs(seen[:, :2]).max() == pytest.approx(1 / 1.25)


def test_azimuth_looks_at_the_face_and_then_at_the_left_side():
    points = np.random.default_rng(0).normal(size=(50, 3))
    front = Camera.framing(points, 1.0, azimuth=0.0, elevation=0.0)
    left = Camera.framing(points, 1.0, azimuth=math.pi / 2, elevation=0.0)
    above = Camera.framing(points, 1.0, azimuth=0.0, elevation=1.0)
    assert front.eye[2] > 3
    assert left.eye[0] > 3
    assert above.eye[1] > 3


@pytest.mark.parametrize(
    "points", [np.zeros((1, 3)), np.full((4, 3), np.nan), np.full((2, 3), 7.0), np.empty((0, 3))]
)
def test_a_point_or_nothing_still_makes_a_camera(points):
    camera = Camera.framing(points, 1.0)
    assert np.isfinite(camera.matrix(1.0)).all()
    assert 0 < camera.near < camera.far
