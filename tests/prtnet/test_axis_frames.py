import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.axis_frames import any_tangent, frame_about, rolled

EXACT = 1e-14
NORMS = (1.0, 1e-3, 1e-7, 1e-12, 1e-160, 5e-324, 0.0)  # sines: of squares that vanish, too


def beside(sine: float, z: float) -> np.ndarray:
    """A direction so far from a pole."""
    return np.array([0.6 * sine, -0.8 * sine, math.copysign(math.sqrt(1.0 - sine * sine), z)])


DIRECTIONS = np.concatenate(
    [
        sh.fibonacci_sphere(200),
        np.eye(3),
        -np.eye(3),
        [beside(sine, z) for sine in NORMS for z in (1.0, -1.0)],
    ]
)


@st.composite
def unit_vectors(draw) -> np.ndarray:
    return Rotation.random(rng=draw(st.integers(0, 2**32 - 1))).as_matrix()[0]


def test_frames_are_rotations_that_end_in_the_axis():
    frames = frame_about(DIRECTIONS)
    np.testing.assert_array_equal(frames[..., 2], DIRECTIONS)
    gram = np.swapaxes(frames, -1, -2) @ frames
    np.testing.assert_allclose(gram, np.broadcast_to(np.eye(3), gram.shape), atol=EXACT)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=EXACT)
    np.testing.assert_array_equal(frame_about(DIRECTIONS[7]), frames[7])
    pairs = DIRECTIONS[:200].reshape(50, 4, 3)
    np.testing.assert_array_equal(frame_about(pairs), frames[:200].reshape(50, 4, 3, 3))


def test_frames_turn_by_the_shortest_way():
    """By the angle to the axis, about what is perpendicular to it and to +z."""
    frames = frame_about(DIRECTIONS)
    cosine = (np.trace(frames, axis1=-2, axis2=-1) - 1.0) / 2.0
    np.testing.assert_allclose(cosine, DIRECTIONS[:, 2], atol=EXACT)
    still = np.cross([0.0, 0.0, 1.0], DIRECTIONS)
    np.testing.assert_allclose((frames @ still[..., None])[..., 0], still, atol=EXACT)


def test_frames_of_neighbours_are_alike_but_around_the_far_pole():
    turn = np.linspace(0.0, 2.0 * math.pi, 361)
    for height in (0.999, 0.5, 1e-9, -1e-9, -0.5):
        radius = math.sqrt(1.0 - height**2)
        ring = np.stack(
            [radius * np.cos(turn), radius * np.sin(turn), np.full(361, height)], axis=1
        )
        assert np.abs(np.diff(frame_about(ring), axis=0)).max() < 0.06
    across = frame_about(np.stack([beside(0.999999, 1.0), beside(0.999999, -1.0)]))
    assert np.abs(np.diff(across, axis=0)).max() < 0.003


@given(unit_vectors(), unit_vectors(), unit_vectors())
def test_rolling_is_the_turn_about_what_is_perpendicular_to_both(vector, start, end):
    across = np.cross(start, end)
    sine = float(np.linalg.norm(across))
    assume(sine > 1e-3)
    turn = Rotation.from_rotvec(across / sine * math.atan2(sine, float(start @ end)))
    got = rolled(vector, start, end)
    np.testing.assert_allclose(got, turn.apply(vector), atol=1e-12)
    np.testing.assert_allclose(rolled(start, start, end), end, atol=EXACT)
    np.testing.assert_allclose(rolled(got, end, start), vector, atol=1e-12)


@given(unit_vectors(), st.sampled_from(NORMS))
def test_rolling_to_the_opposite_and_beside_it_is_a_rotation(start, step):
    """Also where a sum of squares, or 1 + cos, is nothing."""
    end = -start + step * any_tangent(start)
    end /= np.linalg.norm(end)
    turned = rolled(np.eye(3), start, end)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(turned) == pytest.approx(1.0)
    np.testing.assert_allclose(rolled(start, start, end), end, atol=1e-15)


@given(unit_vectors(), unit_vectors())
def test_nothing_is_rolled_where_nothing_turns(vector, start):
    np.testing.assert_allclose(rolled(vector, start, start), vector, atol=EXACT)


def test_rows_of_vectors_roll_each_by_its_own():
    vectors, start, end = DIRECTIONS[:60], DIRECTIONS[60:120], DIRECTIONS[120:180]
    together = rolled(vectors, start, end)
    assert together.shape == (60, 3)
    for row in range(60):
        one = rolled(vectors[row], start[row], end[row])
        np.testing.assert_allclose(together[row], one, atol=EXACT)


def test_a_tangent_of_any_normal():
    tangents = any_tangent(DIRECTIONS)
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0, atol=EXACT)
    np.testing.assert_allclose((tangents * DIRECTIONS).sum(axis=1), 0.0, atol=EXACT)
    assert any_tangent(DIRECTIONS.astype(np.float32)).dtype == np.float32
