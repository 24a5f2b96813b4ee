"""A scene with everything that a reader of skinned scenes knows, in a few vertices."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from prtnet.animation import Channel, Clip, Rig
from prtnet.scene import SkinnedScene


def small_scene(flat: bool = False) -> SkinnedScene:
    """Two tetrahedra on a chain of three nodes, with two morph targets and two clips."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    positions = np.concatenate([corners, corners + np.float32(1)])
    faces = np.concatenate([faces, faces + 4])
    weights = np.full((8, 2), 0.5)
    weights[0] = 1.0, 0.0
    if flat:
        weights, positions = weights[faces.ravel()], positions[faces.ravel()]
        faces = np.arange(24).reshape(-1, 3)
    count = len(positions)
    times = np.array([0.0, 0.5, 1.0])
    turn = np.array([[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0, 0, 0, 1]])
    channels = (
        Channel(1, "rotation", times, turn),
        Channel(2, "translation", times, np.ones((3, 3, 3)), "CUBICSPLINE"),
        Channel(0, "weights", times, np.array([[0, 1], [1, 0], [0, 0.5]]), "STEP"),
    )
    rig = Rig(
        ("root", "low", "high"), np.array([-1, 0, 1]), np.ones((3, 3)),
        np.tile([0.0, 0, 0, 1], (3, 1)), np.ones((3, 3)), np.tile(np.eye(4), (3, 1, 1)),
        np.array([0.0, 0.25]), {0: slice(0, 2)},
    )  # fmt: skip
    offsets = np.linspace(-1, 1, 2 * count * 3, dtype=np.float32).reshape(2, count, 3)
    return SkinnedScene(
        "small", None, "", faces.astype(np.int32),
        (Clip("one", 0.0, 1.0, channels), Clip("two", 0.0, 1.0, channels[:1])), rig,
        np.array([1, 2]), np.array([0, 1]), np.tile(np.eye(4)[:3], (2, 1, 1)),
        scipy.sparse.csr_array(weights), positions,
        None if flat else np.tile(np.float32([0, 1, 0]), (count, 1)), offsets, 0 * offsets,
    )  # fmt: skip
