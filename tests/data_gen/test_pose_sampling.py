from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from data_gen.branches import branches, path_between
from data_gen.pose_sampling import LIBRARY_FPS, PoseSampler, library
from data_gen.procedural import arm, mannequin
from data_gen.readers import read_scene
from prtnet.animation import Channel, Clip
from prtnet.errors import PrtnetError
from prtnet.scene import SkinnedScene
from tests.data_gen.meshes import cache


@pytest.fixture(scope="module")
def body() -> SkinnedScene:
    return mannequin()


@pytest.fixture(scope="module")
def sampler(body: SkinnedScene) -> PoseSampler:
    return PoseSampler(body, body.clips[:3], seed=1)


def rotations(scene: SkinnedScene, poses: np.ndarray) -> Rotation:
    """Every joint's rotation relative to its parent joint, flattened over (P, J)."""
    turn = scene.joint_matrices(poses)[..., :3].astype(np.float64)
    turn = turn / np.linalg.norm(turn, axis=-2, keepdims=True)
    parents = scene.joint_parents
    local = np.where((parents >= 0)[:, None, None], turn[:, parents].swapaxes(-1, -2) @ turn, turn)
    return Rotation.from_matrix(local.reshape(-1, 3, 3))


def test_a_pose_is_the_same_whoever_asks(body: SkinnedScene, sampler: PoseSampler) -> None:
    together, sources = sampler.sample(np.arange(6))
    alone, alone_sources = PoseSampler(body, body.clips[:3], seed=1).sample(np.array([4]))
    np.testing.assert_array_equal(alone[0], together[4])
    np.testing.assert_array_equal(alone_sources[0], sources[4])
    assert together.dtype == np.float32
    assert together.shape == (6, body.pose_size)


def test_seeds_and_numbers_give_different_poses(body: SkinnedScene, sampler: PoseSampler) -> None:
    poses, _ = sampler.sample(np.arange(3))
    other, _ = PoseSampler(body, body.clips[:3], seed=2).sample(np.arange(3))
    stacked = np.concatenate([poses, other])
    assert len(np.unique(stacked, axis=0)) == 6


@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_joints_stay_within_the_range_they_were_seen_in(body: SkinnedScene, margin: float) -> None:
    """Rotation vectors about the mean rotation, recomputed from the poses themselves."""
    sampler = PoseSampler(body, body.clips[:3], seed=1, margin=margin)
    outside = 0.0
    seen = np.concatenate([body.poses(clip, clip.times(LIBRARY_FPS)) for clip in body.clips[:3]])
    sampled, _ = sampler.sample(np.arange(40))
    joints = body.joint_count
    observed, made = rotations(body, seen), rotations(body, sampled)
    for joint in range(joints):
        own = observed[joint::joints]
        quaternions = own.as_quat()
        mean = Rotation.from_quat(np.linalg.eigh(quaternions.T @ quaternions)[1][:, -1])
        range_ = (mean.inv() * own).as_rotvec()
        turns = (mean.inv() * made[joint::joints]).as_rotvec()
        if np.abs(range_).max() > 3.0:
            continue  # beyond half a turn the vector may come from either side
        below, above = range_.min(axis=0) - turns, turns - range_.max(axis=0)
        outside = max(outside, below.max(), above.max())
        assert outside <= margin + 1e-4
    assert outside >= 0.9 * margin


def test_joints_that_never_move_get_no_noise() -> None:
    still = arm(segments=10)
    clip = Clip("still", 0.0, 1.0)
    poses, _ = PoseSampler(still, [clip], seed=0).sample(np.arange(3))
    np.testing.assert_allclose(poses, np.tile(still.rest_pose(), (3, 1)), atol=1e-6)


def test_poses_are_new(body: SkinnedScene, sampler: PoseSampler) -> None:
    """No moment of the clips has the same joints; noise keeps joints apart even so."""
    seen = np.concatenate([body.poses(clip, clip.times(30)) for clip in body.clips[:3]])
    sampled, _ = sampler.sample(np.arange(10))
    nearest = np.linalg.norm(sampled[:, None] - seen[None], axis=2).min(axis=1)
    assert nearest.min() > 0.05


def test_half_of_the_poses_come_from_one_clip(sampler: PoseSampler) -> None:
    _, sources = sampler.sample(np.arange(200))
    assert sources.any(axis=1).all()
    single = np.mean(sources.sum(axis=1) == 1)
    assert 0.4 < single < 0.62
    assert (sources.mean(axis=0) > 0.3).all()


def test_poses_show_the_clips_they_name() -> None:
    """Two clips that move the root to opposite sides: only blends of both are in between."""
    scene = arm(segments=10)
    root = int(scene.joint_nodes[0])
    rest = scene.rig.translation[root]

    def beside(name: str, x: float) -> Clip:
        place = np.array([rest + np.array([x, 0, 0])] * 2)
        return Clip(name, 0.0, 1.0, (Channel(root, "translation", np.array([0.0, 1.0]), place),))

    clips = [beside("left", 1.0), beside("right", -1.0)]
    poses, sources = PoseSampler(scene, clips, seed=0).sample(np.arange(100))
    x = scene.joint_matrices(poses)[:, 0, 0, 3] - rest[0]
    only = sources.sum(axis=1) == 1
    np.testing.assert_allclose(x[only], np.where(sources[only, 0], 1.0, -1.0), atol=1e-5)
    between = np.abs(x) < 0.99
    assert between.any()
    assert sources[between].all()


def test_clips_of_morph_weights_count_only_where_there_are_some() -> None:
    scene = arm(segments=10)
    clips = [dataclasses.replace(scene.clips[0], name=name) for name in ("a", "b")]
    poses, sources = PoseSampler(scene, clips, seed=0).sample(np.arange(60))
    more = PoseSampler(with_morph(scene), clips, seed=0)
    poses_of_more, sources_of_more = more.sample(np.arange(60))
    np.testing.assert_array_equal(poses, poses_of_more[:, :-1])  # the same draws
    assert (sources <= sources_of_more).all()
    assert (sources < sources_of_more).any()


def with_morph(scene: SkinnedScene) -> SkinnedScene:
    rig = dataclasses.replace(scene.rig, weights=np.zeros(1), weights_of_node={0: slice(0, 1)})
    shape = (1, scene.vertex_count, 3)
    return dataclasses.replace(
        scene, rig=rig, morph_positions=np.ones(shape), morph_normals=np.zeros(shape)
    )


def test_morph_weights_stay_within_their_range() -> None:
    scene = arm(segments=10)
    morphed = with_morph(scene)
    times, values = np.array([0.0, 1.0]), np.array([[0.2], [0.7]])
    clip = Clip("grow", 0.0, 1.0, (Channel(0, "weights", times, values),))
    weights = PoseSampler(morphed, [clip], seed=0).sample(np.arange(100))[0][:, -1]
    assert weights.min() >= 0.2 - 1e-6
    assert weights.max() <= 0.7 + 1e-6
    assert np.std(weights) > 0.05


def test_point_caches_cannot_be_sampled() -> None:
    scene = cache(np.zeros((2, 3, 3)), np.array([[0, 1, 2]]))
    with pytest.raises(PrtnetError, match="--sample: recombines the limbs of skinned scenes"):
        PoseSampler(scene, scene.clips, 0)


def test_a_body_has_limbs_trunk_and_head(body: SkinnedScene) -> None:
    """Both arms, both legs, trunk, head and hips move apart; a hand goes with its arm."""
    branch = branches(body, library(body, body.clips)[0])
    of_joint = dict(zip(body.joint_names, branch[body.joint_nodes], strict=True))
    count = len(set(of_joint.values()))
    assert 6 <= count <= 8
    for node, parent in enumerate(body.rig.parents):
        siblings = np.sum(body.rig.parents == parent)
        if parent >= 0 and siblings == 1:
            assert branch[node] == branch[parent]


def test_a_shin_that_hangs_on_the_root_goes_with_its_leg(body: SkinnedScene) -> None:
    """The same motion with one shin baked into the root's space, as exporters of IK rigs do."""
    rig = body.rig
    shin = rig.names.index("left_shin")
    thigh = int(rig.parents[shin])
    clip = max(body.clips, key=lambda each: each.duration)
    times = clip.times(LIBRARY_FPS)
    world = rig.model_matrices(rig.sample(clip, times))
    local = np.linalg.inv(world[:, 0]) @ world[:, shin]
    baked = (
        Channel(shin, "translation", times, local[:, :3, 3]),
        Channel(shin, "rotation", times, Rotation.from_matrix(local[:, :3, :3]).as_quat()),
    )
    kept = tuple(channel for channel in clip.channels if channel.node != shin)
    moved = Clip(clip.name, clip.start, clip.end, kept + baked)
    parents = rig.parents.copy()
    parents[shin] = 0
    loose = dataclasses.replace(body, rig=dataclasses.replace(rig, parents=parents))
    branch = branches(loose, library(loose, [moved])[0])
    assert branch[thigh] == branch[shin]
    assert len(np.unique(branch)) > 3  # the rest can still be recombined


def test_the_way_between_two_nodes() -> None:
    parents = np.array([-1, 0, 1, 1, 3])
    assert path_between(parents, 2, 4) == [2, 4, 3]
    assert path_between(parents, 1, 4) == [4, 3]
    assert path_between(parents, 4, -1) == [4, 3, 1, 0]


def test_limbs_of_a_robot_whose_feet_hang_on_its_root(shared_data: Path) -> None:
    robot = read_scene(shared_data / "robot.glb")
    assert isinstance(robot, SkinnedScene)
    branch = branches(robot, library(robot, robot.clips)[0])
    of = dict(zip(robot.joint_names, branch[robot.joint_nodes], strict=True))
    assert of["Foot.L_2"] == of["LowerLeg.L_2"] == of["UpperLeg.L"] == of["Body"]
    assert of["LowerArm.L"] == of["Index2.L"] == of["Thumb.L"]
    apart = ("Body", "Torso_2", "Head_2", "LowerArm.L", "LowerArm.R")
    assert len({of[name] for name in apart}) == 5
