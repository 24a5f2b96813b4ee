import hashlib

import numpy as np
import pytest

from data_gen import mannequin_motion as motion
from data_gen import mannequin_rig
from data_gen.mannequin_shape import body
from data_gen.procedural import HELD_OUT, arm, mannequin
from prtnet.errors import PrtnetError
from prtnet.scene import face_normals

CLIPS = {"range_of_motion": 8.2, "walk": 2.2, "reach": 4.0, "dance": 4.0}
MIRROR = np.array([-1.0, 1.0, 1.0])


def directed_edges(faces):
    return np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def volume(positions, faces):
    a, b, c = np.moveaxis(positions[faces].astype(np.float64), 1, 0)
    return np.sum(a * np.cross(b, c)) / 6


def corner_angles(positions, faces):
    corners = positions[faces].astype(np.float64)
    u, v = np.roll(corners, -1, axis=1) - corners, np.roll(corners, -2, axis=1) - corners
    cosine = np.sum(u * v, -1) / (np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


@pytest.mark.parametrize(
    ("make", "size"),
    [(mannequin, 0.016), (mannequin, 0.04), (mannequin, 0.06), (arm, 28), (arm, 3), (arm, 8)],
)
def test_surface_is_one_closed_oriented_sphere(make, size):
    scene = make(size)
    edges = directed_edges(scene.faces)
    keys = edges[:, 0].astype(np.int64) * scene.vertex_count + edges[:, 1]
    back = edges[:, 1].astype(np.int64) * scene.vertex_count + edges[:, 0]
    assert len(np.unique(keys)) == len(keys)  # no edge is run twice the same way,
    assert set(keys) == set(back)  # and each is run back by exactly one neighbour
    assert scene.vertex_count - len(edges) // 2 + len(scene.faces) == 2
    assert len(np.unique(scene.faces)) == scene.vertex_count
    assert volume(scene.positions, scene.faces) > 0


def test_mannequin_is_a_standing_adult():
    scene = mannequin()
    low, high = scene.positions.min(axis=0), scene.positions.max(axis=0)
    assert 5500 <= scene.vertex_count <= 6500
    assert abs(low[1]) < 1e-3
    assert high[1] == pytest.approx(1.70, abs=0.02)
    assert high[0] == pytest.approx(0.69, abs=0.02)  # hands away from the thighs
    assert high[2] > -low[2]  # the feet point to +z
    assert volume(scene.positions, scene.faces) == pytest.approx(0.06, abs=0.015)  # m³: 60 kg


def test_small_mannequin_has_the_same_body():
    small, whole = mannequin(0.04), mannequin()
    assert small.vertex_count < 1100
    assert small.joint_names == whole.joint_names
    with pytest.raises(PrtnetError, match="needs edges"):
        mannequin(0.2)
    ratio = volume(small.positions, small.faces) / volume(whole.positions, whole.faces)
    assert ratio == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("make", [mannequin, arm])
def test_normals_are_unit_and_agree_with_the_faces(make):
    scene = make()
    np.testing.assert_allclose(np.linalg.norm(scene.normals, axis=1), 1, atol=1e-6)
    faces = face_normals(scene.positions.astype(np.float64), scene.faces)
    mean = scene.normals[scene.faces].mean(axis=1)
    cosine = np.sum(faces * mean, axis=1) / np.linalg.norm(faces, axis=1)
    assert cosine.min() > 0.2
    assert np.mean(cosine) > 0.98


def test_triangles_are_well_shaped():
    angles = corner_angles(mannequin().positions, mannequin().faces)
    assert angles.min() > 10
    assert np.percentile(angles.min(axis=1), 5) > 30
    assert corner_angles(arm().positions, arm().faces).min() > 10


@pytest.mark.parametrize("make", [mannequin, arm])
def test_weights_sum_to_one_over_at_most_four_joints(make):
    scene = make()
    weights = scene.joint_weights
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)
    assert weights.min() >= 0
    assert np.count_nonzero(weights, axis=1).max() <= 4
    assert weights.max(axis=0).min() > 0.6  # every joint has skin of its own


def test_joints_and_bones_lie_inside_the_body():
    segments, _ = mannequin_rig.bones()
    along = np.linspace(0, 1, 9)[:, None, None]
    bones = (1 - along) * segments[:, 0] + along * segments[:, 1]
    assert body(mannequin_rig.POSITIONS).max() < -0.008
    assert body(bones.reshape(-1, 3)).max() < -0.008


def test_limbs_do_not_pull_on_each_other():
    scene = mannequin()
    weight = {name: scene.joint_weights[:, k] for k, name in enumerate(scene.joint_names)}
    x, y, _ = scene.positions.T
    assert weight["left_hand"][y < 0.8].max() == 0
    assert weight["left_hand"][x < 0.45].max() < 0.01
    assert weight["left_shin"][x < 0].max() == 0
    assert weight["left_thigh"][(x < 0) & (y < 0.65)].max() < 0.05
    assert weight["left_upper_arm"][y < 1.05].max() < 0.05


def test_mannequin_is_its_own_mirror_image():
    scene = mannequin()
    weights = scene.joint_weights
    swap = [
        scene.joint_names.index(
            name.replace("left", "?").replace("right", "left").replace("?", "right")
        )
        for name in scene.joint_names
    ]
    rows = np.concatenate([scene.positions, scene.normals, weights], axis=1)
    mirrored = np.concatenate(
        [scene.positions * MIRROR, scene.normals * MIRROR, weights[:, swap]], axis=1
    )
    order, other = (np.lexsort(np.round(r[:, :3].T, 4) + 0.0) for r in (rows, mirrored))
    np.testing.assert_allclose(rows[order][:, :3], mirrored[other][:, :3], atol=1e-4)
    np.testing.assert_allclose(rows[order][:, 3:6], mirrored[other][:, 3:6], atol=1e-2)
    np.testing.assert_allclose(rows[order][:, 6:], mirrored[other][:, 6:], atol=0.05)


def test_clips_have_their_names_and_lengths():
    assert {clip.name: clip.duration for clip in mannequin().clips} == pytest.approx(CLIPS)
    assert set(HELD_OUT) < set(CLIPS)
    assert {clip.name: clip.duration for clip in arm().clips} == {"bend": 4.0}


@pytest.mark.parametrize("name", CLIPS)
def test_clip_stands_on_the_floor_without_tearing(name):
    scene = mannequin()
    clip = scene.clip(name)
    geometry = scene.geometry(scene.poses(clip, clip.times(fps=5)))
    assert np.isfinite(geometry.positions).all()
    np.testing.assert_allclose(np.linalg.norm(geometry.normals, axis=-1), 1, atol=1e-5)
    lowest = geometry.positions[..., 1].min(axis=1)
    assert lowest.min() > -0.025
    assert lowest.max() < 0.02
    edges = directed_edges(scene.faces)
    posed = np.linalg.norm(np.diff(geometry.positions[:, edges], axis=2)[:, :, 0], axis=-1)
    rest = np.linalg.norm(np.diff(scene.positions[edges], axis=1)[:, 0], axis=-1)
    assert np.quantile(posed / rest, 0.999) < 2.5
    volumes = [volume(p, scene.faces) for p in geometry.positions]
    assert np.min(volumes) > 0.85 * volume(scene.positions, scene.faces)


def winding_numbers(points, positions, faces):
    """How often the surface surrounds each point (van Oosterom and Strackee's solid angles)."""
    a, b, c = (positions[faces[:, k]] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    triple = np.sum(a * np.cross(b, c), axis=-1)
    rest = la * lb * lc + np.sum(a * b, -1) * lc + np.sum(b * c, -1) * la + np.sum(c * a, -1) * lb
    return np.arctan2(triple, rest).sum(axis=1) / (2 * np.pi)


def buried(scene, geometry):
    """Share of the vertices, of one pose, that another part of the body has swallowed."""
    outside = geometry.positions[0] + 0.003 * geometry.normals[0]
    return np.mean(winding_numbers(outside[::4], geometry.positions[0], scene.faces) > 0.5)


def test_body_does_not_cut_itself_at_rest():
    assert buried(mannequin(0.04), mannequin(0.04).rest()) == 0


@pytest.mark.parametrize("name", CLIPS)
def test_clip_hardly_cuts_the_body(name):
    scene = mannequin(0.04)
    for time in scene.clip(name).times(count=7):
        pose = scene.poses(scene.clip(name), np.array([time]))
        assert buried(scene, scene.geometry(pose)) < 0.02


@pytest.mark.parametrize("name", CLIPS)
def test_clip_stays_in_the_ranges(name):
    times = np.linspace(0, CLIPS[name], 400)
    keys = {"range_of_motion": motion.RANGE_OF_MOTION, "reach": motion.REACH, "dance": motion.DANCE}
    walks = name == "walk"
    curves = motion.walk_curves(times) if walks else motion.control_curves(keys[name], times)
    assert set(curves) == set(motion.RANGES)
    for control, (least, _, greatest) in motion.RANGES.items():
        assert curves[control].min() >= least - 1e-9, control
        assert curves[control].max() <= greatest + 1e-9, control
        if name == "range_of_motion":
            assert np.ptp(curves[control]) > 0.25 * (greatest - least), control


def test_walk_repeats_without_a_jump():
    scene = mannequin(0.04)
    clip = scene.clip("walk")
    first, half, last = scene.poses(clip, np.array([0.0, clip.end / 2, clip.end]))
    np.testing.assert_allclose(first, half, atol=1e-5)
    np.testing.assert_allclose(first, last, atol=1e-5)
    mid = scene.poses(clip, np.array([0.275]))[0]
    assert np.abs(mid - first).max() > 0.1


def test_arm_bends_about_z_to_its_limit_and_back():
    scene = arm(8)
    matrices = scene.joint_matrices(scene.poses(scene.clip("bend"), np.array([0.0, 2.0, 4.0])))
    angle = np.radians(140)
    bent = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    np.testing.assert_allclose(matrices[:, 0, :, :3], np.tile(np.eye(3), (3, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(matrices[1, 1, :, :3], bent, atol=1e-6)
    np.testing.assert_allclose(matrices[[0, 2], 1, :, :3], np.tile(np.eye(3), (2, 1, 1)), atol=1e-6)
    np.testing.assert_allclose(matrices[:, 1, :, 3], np.tile([0.3, 0, 0], (3, 1)), atol=1e-6)


def test_arm_size_follows_its_segments():
    assert 1900 <= arm().vertex_count <= 2200
    assert arm(8).vertex_count < 250
    with pytest.raises(PrtnetError, match="at least 3"):
        arm(2)


def test_characters_are_the_same_every_time():
    def fingerprint(scene):
        return hashlib.sha256(scene.positions.tobytes() + scene.sha256.encode()).hexdigest()

    first = fingerprint(mannequin(0.04))
    mannequin.cache_clear()
    assert fingerprint(mannequin(0.04)) == first
    assert fingerprint(arm(8)) == fingerprint(arm(8)) != fingerprint(arm(9))
