"""What receivers see, against loops over receivers and occluders; what it must not depend on."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.occluders import cap_integrals
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.surroundings import SOFTEST
from tests.models import random_poses
from tests.skin import random_skin


def slow_cap(away, sine2, order):
    """One cap's harmonics, faded over the horizon."""
    direction = away / np.linalg.norm(away)
    above = np.clip(0.5 + 0.5 * direction[2] / max(np.sqrt(sine2), SOFTEST), 0, 1)
    integrals = 2 * np.pi * cap_integrals(np.array(np.sqrt(1 - sine2)), order)
    return above * integrals[sh.bands(order)] * sh.evaluate(direction, order)


def slow(skin: SkinSurroundings, pose: np.ndarray, receiver: int) -> np.ndarray:
    """Features (4 · n²) by the definition, one occluder after the other."""
    joints = pose[: 12 * skin.joints].astype(float).reshape(-1, 3, 4)
    carry = np.tile(np.eye(4), (skin.joints, 1, 1))
    for joint, matrix in enumerate(joints):
        placed, back = np.eye(4), np.eye(4)
        placed[:3] = matrix
        placed[:3, 3] = (matrix[:, 3] - joints[0, :, 3]) / skin.size
        back[:3] = skin.rest_inverse[joint]
        carry[joint] = placed @ back

    def blend(joint, weight):
        return sum(w * carry[j] for j, w in zip(joint, weight, strict=True))

    def cofactor(matrix):
        return np.linalg.det(matrix[:3, :3]) * np.linalg.inv(matrix[:3, :3]).T

    own = blend(skin.skin_joint[receiver], skin.skin_weight[receiver])
    place = own[:3, :3] @ skin.position[receiver] + own[:3, 3]
    normal = cofactor(own) @ skin.normal[receiver]
    normal /= np.linalg.norm(normal)
    tangent = own[:3, :3] @ skin.tangent[receiver]
    tangent -= tangent @ normal * normal
    tangent /= np.linalg.norm(tangent)
    frame = np.stack([tangent, np.cross(normal, tangent), normal])
    sums = np.zeros((4, skin.order**2))
    cluster = skin.cluster[receiver]
    for k in skin.near_spheres[cluster]:
        matrix = carry[skin.sphere_joint[k]]
        away = matrix[:3, :3] @ skin.sphere_centre[k] + matrix[:3, 3] - place
        radius2 = skin.sphere_radius[k] ** 2 * np.sum(matrix[:3, :3] ** 2) / 3
        home = skin.sphere_joint[k] == skin.own_joint[cluster]
        sums[int(home)] += slow_cap(frame @ away, min(radius2 / (away @ away), 1), skin.order)
    for k in skin.near_patches[cluster]:
        matrix = blend(skin.patch_joint[k], skin.patch_weight[k])
        away = matrix[:3, :3] @ skin.patch_centre[k] + matrix[:3, 3] - place
        facing = -(cofactor(matrix) @ skin.patch_area[k]) @ away / np.linalg.norm(away)
        sine2 = abs(facing) / (np.pi * away @ away + abs(facing))
        sums[2 if facing > 0 else 3] += slow_cap(frame @ away, sine2, skin.order)
    return sums.ravel()


@pytest.mark.parametrize("order", [1, 3, 4])
def test_equals_the_definition(order):
    skin = random_skin(order=order)
    poses = random_poses(3, 5)
    seen = skin(poses)
    assert seen.shape == (3, 40, skin.feature_count)
    for pose in range(3):
        for receiver in (0, 7, 39):
            expected = slow(skin, poses[pose], receiver)
            assert np.allclose(seen[pose, receiver], expected, rtol=2e-5, atol=2e-5)


def test_some_receivers_see_what_they_see_among_all():
    skin = random_skin()
    pose = random_poses(1, 5)
    own = np.array([5, 1, 30])
    assert np.array_equal(skin.at(pose[0], own), skin(pose)[0, own])


def moved(poses: np.ndarray, joints: int, turn: np.ndarray, scale: float, to: np.ndarray):
    """Poses whose joints are turned, scaled and moved together."""
    matrices = poses[:, : 12 * joints].astype(float).reshape(len(poses), joints, 3, 4)
    matrices = scale * (turn @ matrices)
    matrices[..., 3] += to
    return np.concatenate([matrices.reshape(len(poses), -1), poses[:, 12 * joints :]], axis=1)


@pytest.mark.parametrize("place", [0.0, 1.0, 1e5])
def test_turning_and_moving_the_body_changes_nothing(place):
    skin, poses = random_skin(), random_poses(4, 5)
    turn = Rotation.random(rng=1).as_matrix()
    elsewhere = moved(poses, 5, turn, 1.0, place * np.array([1.0, -2.0, 0.5]))
    assert np.allclose(skin(elsewhere), skin(poses), atol=2e-5)


@pytest.mark.parametrize("scale", [1e-3, 1e5])
def test_units_change_nothing(scale):
    skin, poses = random_skin(), random_poses(4, 5)
    larger = dataclasses.replace(
        skin, size=skin.size * scale, rest_inverse=skin.rest_inverse / np.float32(scale)
    )
    scaled = moved(poses, 5, np.eye(3), scale, np.zeros(3))
    # rest_inverse takes the scale of the joints away again; the units of length are `size`.
    matrices = scaled.reshape(4, 5, 3, 4)
    assert np.allclose(larger(matrices.reshape(4, -1)), skin(poses), atol=2e-5)


def test_arrays_round_trip():
    skin = random_skin()
    again = SkinSurroundings.from_arrays(skin.arrays())
    poses = random_poses(2, 5)
    assert np.array_equal(again(poses), skin(poses))


@pytest.mark.parametrize("name", ["skin_joint", "near_patches", "cluster"])
def test_indices_outside_their_table_are_refused(name):
    arrays = random_skin().arrays()
    arrays[name] = arrays[name] + 100
    with pytest.raises(ValueError, match=f"{name} points outside"):
        SkinSurroundings.from_arrays(arrays)


def test_coinciding_and_vanishing_things_stay_finite():
    skin = random_skin()
    flat = dataclasses.replace(
        skin,
        patch_centre=np.zeros_like(skin.patch_centre), patch_area=np.zeros_like(skin.patch_area),
        position=np.zeros_like(skin.position), normal=np.zeros_like(skin.normal),
        sphere_centre=np.zeros_like(skin.sphere_centre),
        sphere_radius=np.zeros_like(skin.sphere_radius),
    )  # fmt: skip
    poses = random_poses(2, 5)
    for pose in (poses, np.zeros_like(poses)):
        assert np.isfinite(flat(pose)).all()
        assert np.isfinite(skin(pose)).all()
