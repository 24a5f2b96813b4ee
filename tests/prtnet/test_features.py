from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.features import (
    DihedralAngles,
    JointAngles,
    LocalJoints,
    Occluders,
    features_from_arrays,
)
from prtnet.occluders import Spheres, cap_integrals
from tests.models import random_features, random_poses


def moved(poses, joints, rotation, offset):
    """The whole scene turned and shifted."""
    matrices = poses[:, : 12 * joints].reshape(len(poses), joints, 3, 4).astype(np.float64)
    matrices = rotation @ matrices
    matrices[..., 3] += offset
    return np.concatenate(
        [matrices.reshape(len(poses), -1), poses[:, 12 * joints :]], axis=1
    ).astype(np.float32)


def slow_occluders(features, pose):
    """One pose, one cluster, one point, one sphere at a time."""
    joints = pose[: 12 * features.joints].reshape(-1, 3, 4).astype(np.float64)
    clusters, points, _ = features.point.shape
    result = np.zeros((clusters, points, features.order**2))
    for c in range(clusters):
        home = joints[features.cluster_joint[c]]
        scale = np.linalg.norm(home[:, 0])
        for m in range(points):
            for s in features.near[c]:
                rides = joints[features.spheres.joint[s]]
                centre = rides[:, :3] @ features.spheres.centre[s] + rides[:, 3]
                radius = features.spheres.radius[s] * np.linalg.norm(rides[:, 0])
                viewer = home[:, :3] @ features.point[c, m] + home[:, 3]
                away = (home[:, :3] / scale).T @ (centre - viewer)
                distance = np.linalg.norm(away)
                cosine = np.sqrt(max(0.0, 1.0 - (radius / distance) ** 2))
                integrals = cap_integrals(np.array(cosine), features.order)
                y = sh.evaluate_reference(away / distance, features.order)
                for degree in range(features.order):
                    band = slice(degree**2, (degree + 1) ** 2)
                    result[c, m, band] += 2 * np.pi * integrals[degree] * y[band]
    return result.reshape(clusters, -1)


@pytest.mark.parametrize("order", [1, 3, 4])
def test_occluders_equal_the_slow_reference(order):
    features = random_features("occluders", joints=5, clusters=3, order=order)
    poses = random_poses(4, 5)
    expected = np.stack([slow_occluders(features, pose) for pose in poses])
    assert np.allclose(features(poses), expected, rtol=1e-4, atol=1e-4)


def slow_local_joints(features, pose):
    """One pose, one cluster, one joint at a time."""
    joints = pose[: 12 * features.joints].reshape(-1, 3, 4).astype(np.float64)
    result = np.zeros((len(features.cluster_joint), 3, features.joints))
    for c, home in enumerate(features.cluster_joint):
        frame = np.concatenate([joints[home], [[0, 0, 0, 1]]])
        for j in range(features.joints):
            p = (np.linalg.inv(frame) @ np.append(joints[j, :, 3], 1.0))[:3]
            result[c, :, j] = p / (np.linalg.norm(p) + features.reach[c])
    return result.reshape(len(result), -1)


def test_local_joints_equal_the_slow_reference():
    features = random_features("local_joints", joints=5, clusters=3, order=3)
    poses = random_poses(4, 5)
    expected = np.stack([slow_local_joints(features, pose) for pose in poses])
    assert np.allclose(features(poses), expected, atol=1e-5)


@pytest.mark.parametrize("scale", [1e-3, 1e5])
def test_local_joints_do_not_depend_on_the_unit_of_length(scale):
    features = random_features("local_joints", joints=4, clusters=3, order=3)
    reach = (features.reach * scale).astype(np.float32)
    poses = random_poses(3, 4)
    scaled = poses.reshape(3, 4, 3, 4).copy()
    scaled[..., 3] *= scale
    other = LocalJoints(features.cluster_joint, reach, 4)
    assert np.allclose(features(poses), other(scaled.reshape(3, -1)), atol=1e-4)


@pytest.mark.parametrize("kind", ["joint_angles", "local_joints", "occluders"])
def test_global_motion_changes_nothing_but_the_roots(kind):
    features = random_features(kind, joints=4, clusters=3, order=4)
    if kind == "joint_angles":  # joint 0 is the root: its local rotation is the global one
        features = JointAngles(np.array([1, 2, 3]), np.array([0, 1, 2]), 4)
    poses = random_poses(3, 4)
    turned = moved(poses, 4, Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix(), [3.0, 1.0, -2.0])
    assert np.allclose(features(poses), features(turned), atol=2e-4)
    assert np.ptp(features(poses), axis=0).max() > 0.1


@pytest.mark.parametrize("scale", [1e-3, 1e5])
def test_occluders_do_not_depend_on_the_unit_of_length(scale):
    """Metres or millimetres: joint offsets, spheres and points all in the other unit."""
    features = random_features("occluders", joints=4, clusters=3, order=4)
    spheres = Spheres(
        features.spheres.joint,
        (features.spheres.centre * scale).astype(np.float32),
        (features.spheres.radius * scale).astype(np.float32),
    )
    point = (features.point * scale).astype(np.float32)
    other = Occluders(spheres, features.cluster_joint, point, features.near, 4, 4)
    poses = random_poses(3, 4)
    scaled = poses.reshape(3, 4, 3, 4).copy()
    scaled[..., 3] *= scale
    assert np.allclose(features(poses), other(scaled.reshape(3, -1)), rtol=1e-3, atol=1e-3)


def test_joint_angles_are_two_columns_of_the_local_rotation():
    features = JointAngles(np.array([0, 1]), np.array([-1, 0]), 2)
    parent, child = Rotation.random(2, rng=np.random.default_rng(3)).as_matrix()
    pose = np.zeros((1, 2, 3, 4), dtype=np.float32)
    pose[0, 0, :, :3], pose[0, 1, :, :3] = 3.0 * parent, 0.5 * parent @ child
    expected = np.concatenate([parent[:, :2].ravel(), child[:, :2].ravel()])
    assert np.allclose(features(pose.reshape(1, -1))[0, 0], expected, atol=1e-6)


def test_morph_weights_pass_through():
    for kind in ("joint_angles", "local_joints", "occluders"):
        poses = random_poses(2, 4, morphs=3)
        values = random_features(kind, joints=4, clusters=2, order=3)(poses)
        assert np.array_equal(values[:, -1, -3:], poses[:, -3:])


def test_a_point_inside_a_sphere_and_one_at_its_centre_are_finite():
    spheres = Spheres(np.zeros(2, np.int32), np.zeros((2, 3), np.float32), np.ones(2, np.float32))
    point = np.array([[[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]], dtype=np.float32)
    near = np.array([[0, 1]], dtype=np.int32)
    pose = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1).reshape(1, -1)
    values = Occluders(spheres, np.zeros(1, np.int32), point, near, 3, 1)(pose.astype(np.float32))
    assert np.isfinite(values).all()
    # Inside, the cap is the half-space: 2 spheres of 2π steradians each, times y_00.
    assert values[0, 0, 9] == pytest.approx(2 * 2 * np.pi * np.sqrt(0.25 / np.pi), rel=1e-5)


def hinge(angle, scale=1.0):
    """A square folded along its diagonal by ``angle``: flat at 0, a valley above."""
    c, s = np.cos(angle), np.sin(angle)
    points = np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0], [-c, s, 0.0]]) * scale
    return points.reshape(1, -1).astype(np.float32)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
def test_dihedral_angle_of_a_hinge(scale):
    features = DihedralAngles(np.array([[0, 1, 2, 3]], dtype=np.int32))
    for angle in np.linspace(-2.9, 2.9, 21):
        value = features(hinge(angle, scale)).item()
        assert abs(value) == pytest.approx(abs(2 * np.sin(angle / 2)), abs=1e-3)
    assert features(hinge(0.5)).item() == pytest.approx(-features(hinge(-0.5)).item(), abs=1e-6)


def test_folded_and_vanished_faces_are_finite():
    features = DihedralAngles(np.array([[0, 1, 2, 3]], dtype=np.int32))
    for pose in (hinge(np.pi), hinge(0.0) * 0.0, hinge(0.0) * np.array([1, 1, 0] * 4)):
        value = features(pose.astype(np.float32)).item()
        assert np.isfinite(value)
        assert abs(value) < 10.0


@pytest.mark.parametrize("kind", ["joint_angles", "dihedral_angles", "local_joints", "occluders"])
def test_arrays_round_trip(kind):
    features = random_features(kind, joints=4, clusters=2, order=4)
    again = features_from_arrays(kind, features.arrays())
    poses = random_poses(2, 4)
    assert np.array_equal(features(poses), again(poses))
    with pytest.raises(KeyError):
        features_from_arrays("palm_reading", features.arrays())


def test_one_scale_is_exact_where_all_joints_are_scaled_alike():
    features = random_features("occluders", joints=4, clusters=3, order=3)
    poses = random_poses(3, 4, one_scale=True)
    simpler = dataclasses.replace(features, one_scale=True)
    assert np.allclose(features(poses), simpler(poses), atol=1e-5)
    assert not np.allclose(features(random_poses(3, 4)), simpler(random_poses(3, 4)), atol=1e-2)


@pytest.mark.parametrize("kind", ["joint_angles", "local_joints", "occluders"])
def test_features_of_some_clusters_are_a_part_of_all(kind):
    features = random_features(kind, 5, 7, 3)
    poses, some = random_poses(4, 5, morphs=2), np.array([5, 0, 2])
    part, every = features.of_clusters(some)(poses), features(poses)
    assert np.array_equal(part, every if kind == "joint_angles" else every[:, some])
