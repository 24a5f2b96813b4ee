from __future__ import annotations

import numpy as np
import pytest

from tests.models import random_poses
from training.inputs import (
    fit_joint_angles,
    fit_local_joints,
    fit_occluders,
    interior_edges,
    moving_joints,
    same_scale,
)


def test_interior_edges_of_a_strip():
    """Two quads side by side: five triangles' worth of edges, of which three are inside."""
    faces = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]])
    edges = interior_edges(faces, np.arange(6)).edge
    assert sorted(map(tuple, np.sort(edges[:, :2], axis=1).tolist())) == [(0, 4), (1, 4), (1, 5)]
    for start, end, left, right in edges.tolist():
        assert any({start, end, left} == set(face) for face in faces.tolist())
        assert any({start, end, right} == set(face) for face in faces.tolist())
        assert left != right


def test_split_vertices_are_welded():
    faces = np.array([[0, 1, 2], [3, 5, 4]])  # 3 is 0 again and 4 is 1 again
    assert len(interior_edges(faces, np.arange(6)).edge) == 0
    assert len(interior_edges(faces, np.array([0, 1, 2, 0, 1, 5])).edge) == 1


def test_edges_of_three_faces_and_of_no_length_are_harmless():
    faces = np.array([[0, 1, 2], [1, 0, 3], [1, 0, 4], [5, 5, 0]])
    assert len(interior_edges(faces, np.arange(6)).edge) == 1


def test_joints_that_never_move_are_dropped():
    poses = random_poses(6, 4)
    poses.reshape(6, 4, 12)[:, 2] = poses.reshape(6, 4, 12)[0, 2]
    features = fit_joint_angles(poses, np.array([-1, -1, -1, -1]))
    assert features.joint.tolist() == [0, 1, 3]
    assert moving_joints(np.zeros((5, 12))).tolist() == []


@pytest.mark.parametrize("joints", [1, 3])
def test_occluders_of_other_joints_only(joints):
    rng = np.random.default_rng(0)
    owner = rng.integers(0, joints, 300)
    rest = rng.normal(size=(300, 3)) * 0.1 + np.eye(3)[owner % 3]
    weights = np.eye(joints)[owner]
    rest_pose = np.tile(np.eye(3, 4).ravel(), joints)
    slots = np.argsort(owner, kind="stable").reshape(6, 50).astype(np.int32)
    poses = np.concatenate([random_poses(4, joints), rest_pose[None].astype(np.float32)])
    features = fit_occluders(poses, slots, rest, rest, weights, rest_pose, points=2, near=5)
    assert features.near.shape == (6, 5 if joints > 1 else 1)
    if joints > 1:
        foreign = features.spheres.joint[features.near] != features.cluster_joint[:, None]
        assert foreign.all()
    assert np.isfinite(features(poses)).all()


def test_nearest_occluders_come_first():
    """Of two balls of one joint, a cluster on the other joint keeps the one beside it."""
    rng = np.random.default_rng(1)
    places = np.array([[0, 0, 0], [0.6, 0, 0], [9.0, 0, 0]])
    part = np.repeat([0, 1, 2], 100)
    rest = places[part] + 0.1 * rng.normal(size=(300, 3))
    weights = np.eye(2)[np.array([0, 1, 1])[part]]
    rest_pose = np.tile(np.eye(3, 4).ravel(), 2)
    slots = np.arange(100, dtype=np.int32)[None]
    features = fit_occluders(
        rest_pose[None].astype(np.float32), slots, rest, rest, weights, rest_pose,
        points=1, near=1, spheres=3,
    )  # fmt: skip
    centre = features.spheres.centre[features.near[0, 0]]
    assert abs(centre[0] - 0.6) < 0.2


def test_rigs_that_scale_their_joints_apart_are_noticed():
    assert same_scale(random_poses(4, 3, one_scale=True), 3)
    assert not same_scale(random_poses(4, 3), 3)


def test_local_joints_look_from_the_dominant_joint_at_the_scale_of_the_scene():
    """Joint 1 is scaled by four at rest: its reach is a quarter as many of its own units."""
    rng = np.random.default_rng(2)
    rest = np.array([0.5, 2.0, 0.5]) * rng.uniform(0, 1, (40, 3))
    rest[:2] = [[0, 0, 0], [0.5, 2.0, 0.5]]
    weights = np.eye(2)[np.repeat([0, 1], 20)]
    pose = np.stack([np.eye(3, 4), 4.0 * np.eye(3, 4)]).ravel()
    slots = np.stack([np.arange(20, 40), np.arange(20), np.r_[0:15, 20:24, -1]])
    features = fit_local_joints(slots, rest, weights, pose)
    assert features.cluster_joint.tolist() == [1, 0, 0]
    assert np.allclose(features.reach, 0.15 * 2.0 / np.array([4.0, 1.0, 1.0]))
