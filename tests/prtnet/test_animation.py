"""Keyframes, quaternions and hierarchies against closed forms."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation, Slerp

from prtnet.animation import (
    Channel,
    Clip,
    Interpolation,
    LocalPose,
    Rig,
    quaternion_to_matrix,
    slerp,
)

ROUNDING = 1e-12  # float64, a few operations


def quaternions(count: int) -> st.SearchStrategy[Any]:
    rows = arrays(float, (count, 4), elements=st.floats(-1, 1))
    long = rows.filter(lambda q: np.linalg.norm(q, axis=1).min() > 0.1)
    return long.map(lambda q: q / np.linalg.norm(q, axis=1, keepdims=True))


@given(quaternions(5))
def test_matrices_are_those_of_scipy(q: Any) -> None:
    np.testing.assert_allclose(
        quaternion_to_matrix(q), Rotation.from_quat(q).as_matrix(), atol=ROUNDING
    )


@given(quaternions(2), st.floats(0, 1))
def test_slerp_properties(q: Any, t: float) -> None:
    a, b = q
    between = slerp(a, b, np.array(t))
    assert np.linalg.norm(between) == pytest.approx(1.0)
    # The same rotation whichever sign stands for it, and whichever end one starts from.
    for other in (slerp(a, -b, np.array(t)), slerp(b, a, np.array(1 - t))):
        assert abs(np.dot(between, other)) == pytest.approx(1.0, abs=1e-9) or np.isclose(
            np.dot(a, b), 0.0, atol=1e-6  # half a turn: both ways are equally short
        )  # fmt: skip
    whole = (Rotation.from_quat(a).inv() * Rotation.from_quat(b)).magnitude()
    part = (Rotation.from_quat(a).inv() * Rotation.from_quat(between)).magnitude()
    assert part == pytest.approx(t * whole, abs=1e-7)  # constant speed, the short way


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-3, 1.0, np.pi - 1e-6])
def test_slerp_of_near_and_far_quaternions(angle: float) -> None:
    ends = Rotation.from_rotvec([[0, 0, 0], [0, angle, 0]])
    a, b = ends.as_quat()
    expected = Slerp([0, 1], ends)(0.3).as_matrix()
    got = quaternion_to_matrix(slerp(a, b, np.array(0.3)))
    np.testing.assert_allclose(got, expected, atol=1e-9)


def sampled(mode: Interpolation, keys: Any, values: Any, times: Any, path: Any = "scale") -> Any:
    channel = Channel(0, path, np.asarray(keys, float), np.asarray(values, float), mode)
    return channel.sample(np.asarray(times, float))


def test_cubic_spline_reproduces_a_cubic() -> None:
    # A Hermite spline with the true derivatives at its keys is the cubic itself.
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 3.0])
    slope = cubic.deriv()
    keys = np.array([0.0, 0.5, 0.7, 2.0])
    values = np.stack([slope(keys), cubic(keys), slope(keys)], axis=1)[..., None]
    times = np.linspace(0, 2, 41)
    np.testing.assert_allclose(
        sampled("CUBICSPLINE", keys, values, times)[:, 0], cubic(times), atol=ROUNDING
    )


def test_cubic_spline_takes_the_outgoing_then_the_incoming_tangent() -> None:
    values = np.zeros((2, 3, 1))
    values[0, 2], values[1, 0] = 1.0, 10.0  # out of the first key, into the second
    t = np.array([0.25])
    h10, h11 = t**3 - 2 * t**2 + t, t**3 - t**2
    got = sampled("CUBICSPLINE", [0, 2], values, 2 * t)
    np.testing.assert_allclose(got[:, 0], 2 * (h10 + 10 * h11))


def test_rotations_are_unit_in_every_mode() -> None:
    rng = np.random.default_rng(0)
    for mode, shape in (("LINEAR", (3, 4)), ("STEP", (3, 4)), ("CUBICSPLINE", (3, 3, 4))):
        values = 5 * rng.normal(size=shape)
        got = sampled(mode, [0, 1, 2], values, np.linspace(0, 2, 9), "rotation")  # type: ignore[arg-type]
        np.testing.assert_allclose(np.linalg.norm(got, axis=1), 1.0)


@pytest.mark.parametrize("mode", get_args(Interpolation))
def test_ends_hold_their_value(mode: Interpolation) -> None:
    values = np.arange(2 * 3 * 2.0).reshape(2, 3, 2) if mode == "CUBICSPLINE" else [[1, 2], [3, 4]]
    got = sampled(mode, [1.0, 2.0], values, [-9, 1, 2, 99])
    np.testing.assert_array_equal(got[0], got[1])
    np.testing.assert_array_equal(got[2], got[3])
    assert not np.array_equal(got[0], got[3])
    alone = sampled(mode, [1.0], np.asarray(values)[:1], [0, 1, 2])
    np.testing.assert_array_equal(alone, np.repeat(got[:1], 3, axis=0))


def test_step_changes_at_the_key() -> None:
    got = sampled("STEP", [0, 1, 2], [[0], [1], [2]], [0, 0.999, 1, 1.5, 2, 3])
    assert got[:, 0].tolist() == [0, 0, 1, 1, 2, 2]


def test_step_survives_the_rounding_of_times_in_files() -> None:
    keys = (np.arange(3000) / 30).astype(np.float32).astype(float)  # as a file holds them
    values = np.arange(3000.0)[:, None]
    got = sampled("STEP", keys, values, np.arange(3000) / 30)
    np.testing.assert_array_equal(got, values)


def test_equal_times_are_a_jump() -> None:
    got = sampled("LINEAR", [0, 0, 1, 1], [[9], [0], [1], [5]], [-1, 0, 0.5, 1, 2])
    assert got[:, 0].tolist() == [0, 0, 0.5, 5, 5]


def test_times_of_a_clip() -> None:
    clip = Clip("x", 1.0, 3.0)
    np.testing.assert_allclose(clip.times(fps=2), [1, 1.5, 2, 2.5, 3])
    np.testing.assert_allclose(clip.times(count=3), [1, 2, 3])
    assert clip.times(count=1).tolist() == [1.0]
    assert Clip("x", 2.0, 2.0).times(fps=30).tolist() == [2.0]


def chain(count: int) -> Rig:
    rng = np.random.default_rng(count)
    rotation = rng.normal(size=(count, 4))
    offset = np.tile(np.eye(4), (count, 1, 1))
    offset[:, :3] += 0.1 * rng.normal(size=(count, 3, 4))
    return Rig(
        names=tuple("abcdefgh"[:count]),
        parents=np.array([-1, 0, 1, 1, 0][:count]),
        translation=rng.normal(size=(count, 3)),
        rotation=rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        scale=rng.uniform(0.5, 2, (count, 3)),
        offset=offset,
        weights=np.array([0.5, 0.25]),
        weights_of_node={2: slice(0, 2)},
    )


def test_hierarchies_multiply_down_the_chain() -> None:
    rig = chain(5)

    def local(n: int) -> Any:
        matrix = np.eye(4)
        matrix[:3, :3] = Rotation.from_quat(rig.rotation[n]).as_matrix() @ np.diag(rig.scale[n])
        matrix[:3, 3] = rig.translation[n]
        return matrix @ rig.offset[n]

    expected = [local(0)]
    expected += [expected[0] @ local(1)]
    expected += [expected[1] @ local(2), expected[1] @ local(3), expected[0] @ local(4)]
    np.testing.assert_allclose(rig.model_matrices(rig.rest())[0], expected, atol=ROUNDING)
    np.testing.assert_allclose(rig.local_matrices(rig.rest())[0, 3], local(3), atol=ROUNDING)


def test_a_clip_moves_only_what_it_names() -> None:
    rig = chain(4)
    keys, morphs = np.array([0.0, 1.0]), np.array([[0.0, 1.0], [2.0, 3.0]])
    channels = (
        Channel(1, "scale", keys, np.ones((2, 3))),
        Channel(2, "weights", keys, morphs),
    )
    pose = rig.sample(Clip("x", 0, 1, channels), np.array([0.0, 0.5]))
    rest = rig.rest(2)
    np.testing.assert_array_equal(pose.scale[:, 1], 1.0)
    np.testing.assert_array_equal(pose.weights, [[0, 1], [1, 2]])
    np.testing.assert_array_equal(pose.translation, rest.translation)
    np.testing.assert_array_equal(pose.rotation, rest.rotation)
    np.testing.assert_array_equal(pose.scale[:, [0, 2, 3]], rest.scale[:, [0, 2, 3]])
    assert rig.weights.tolist() == [0.5, 0.25]  # the rig itself stays at rest
    assert len(pose) == 2


def random_local(seed: int) -> LocalPose:
    rng = np.random.default_rng(seed)
    turns = Rotation.random(6, rng=rng).as_quat().reshape(2, 3, 4)
    scale = rng.uniform(0.5, 2.0, (2, 3, 3))
    return LocalPose(rng.normal(size=(2, 3, 3)), turns, scale, rng.uniform(size=(2, 4)))


def test_blended_poses_start_at_one_and_end_at_the_other() -> None:
    one, other = random_local(0), random_local(1)
    for share, end in ((0.0, one), (1.0, other)):
        got = one.blended(other, np.full(2, share))
        for name in ("translation", "scale", "weights"):
            np.testing.assert_allclose(getattr(got, name), getattr(end, name), atol=ROUNDING)
        turns = (quaternion_to_matrix(pose.rotation) for pose in (got, end))
        np.testing.assert_allclose(*turns, atol=1e-7)


def test_every_pose_node_and_morph_weight_has_its_own_share() -> None:
    one, other = random_local(0), random_local(1)
    share = np.array([[0.0, 0.3, 1.0], [0.5, 0.2, 0.7]])
    got = one.blended(other, share, np.array([0.25, 0.75]))
    for p in range(2):
        for n in range(3):
            u = share[p, n]
            ends = Rotation.from_quat([one.rotation[p, n], other.rotation[p, n]])
            np.testing.assert_allclose(
                quaternion_to_matrix(got.rotation[p, n]), Slerp([0, 1], ends)(u).as_matrix(),
                atol=1e-7,
            )  # fmt: skip
            expected = (1 - u) * one.translation[p, n] + u * other.translation[p, n]
            np.testing.assert_allclose(got.translation[p, n], expected, atol=ROUNDING)
    morphs = 0.25 * one.weights[1] + 0.75 * other.weights[1]
    np.testing.assert_allclose(got.weights[1], morphs, atol=ROUNDING)
