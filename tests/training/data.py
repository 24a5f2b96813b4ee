"""Datasets in memory: what training reads of one, without rays or files."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.models import random_poses


def memory_dataset(poses=None, visibility=None, clips=3, per_clip=8, joints=4, seed=0):
    """Receivers of a body of balls, one a joint, whose visibility follows the joints smoothly."""
    rng = np.random.default_rng(seed)
    receivers = 60
    owner = np.arange(receivers) * joints // receivers
    count = clips * per_clip if poses is None else len(poses)
    mood = rng.uniform(-1.0, 1.0, (count, 2))  # what moves the body: two numbers
    if poses is None:
        rest = random_poses(1, joints, seed=seed).reshape(joints, 3, 4)
        turns = mood @ rng.normal(size=(2, 3 * joints))
        rotation = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix()
        poses = np.tile(rest, (count, 1, 1, 1)).astype(np.float64)
        poses[..., :3] = poses[..., :3] @ rotation.reshape(count, joints, 3, 3)
        poses = poses.reshape(count, -1)
    if visibility is None:
        mix = 2.0 * rng.normal(size=(2, receivers * 4))
        visibility = 3.5 + np.tanh(mood @ mix).reshape(count, receivers, 4)
    label = np.arange(count) * clips // count
    names = [f"clip{k}" for k in range(clips)]
    arrays = {
        "pose": poses.astype(np.float32),
        "visibility": visibility.astype(np.float32),
        "sources": np.eye(clips, dtype=bool)[label],
        "clip": label,
        "time": np.arange(count, dtype=np.float32) % max(1, count // clips),
    }
    held = [names[-1]] if clips > 1 else []
    training = np.flatnonzero(label < clips - 1) if clips > 1 else np.arange(count)
    # Receivers ride on their joints: their normals and tangents turn with them.
    turned = poses.reshape(count, joints, 3, 4)[..., :3].astype(np.float64)
    relative = turned @ np.linalg.pinv(turned[:1])
    frames = relative[:, owner] @ Rotation.random(receivers, rng=rng).as_matrix()
    arrays["normals"], arrays["tangents"] = frames[..., 2], frames[..., 0]
    positions = (np.eye(3)[owner % 3] + 0.1 * rng.normal(size=(receivers, 3))).astype(np.float32)
    return SimpleNamespace(
        path=Path("memory.zarr"), order=2, clip_names=names, held_out=held,
        clip=label, time=np.arange(count) / 4.0,
        scene_kind="skinned", scene_name="balls", scene_sha256="0", mesh_sha256="0",
        two_sided=False, joint_names=[f"joint{k}" for k in range(joints)],
        joint_parents=np.arange(-1, joints - 1), joint_weights=np.eye(joints)[owner],
        faces=np.arange(receivers).reshape(-1, 3), receiver_of_vertex=np.arange(receivers),
        rest_positions=positions, rest_normals=frames[0, ..., 2], rest_tangents=frames[0, ..., 0],
        rest_pose=np.tile(np.eye(3, 4).ravel(), joints), pose_size=poses.shape[1],
        training_poses=lambda: training,
        held_out_poses=lambda: np.setdiff1d(np.arange(count), training),
        poses_of=lambda name: np.flatnonzero(label == names.index(name)),
        read=lambda name, rows=slice(None): arrays[name][rows],
    )  # fmt: skip
