"""Many of the same character, each in a pose of its own: the clip at a moment of its own."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.modelled_scene import ModelledScene
from runtime.view import View, later

__all__ = ["MOST", "crowd_places", "crowd_poses", "elbow_room"]

MOST = 100  # characters
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0  # of the clip's length: moments never fall together
APART = 1.15  # times what a character is wide


def crowd_places(count: int, spacing: float) -> FloatArray:
    """Where characters stand, (count, 3): the first at the origin, rows beside and behind it."""
    width = math.ceil(math.sqrt(count))
    row, column = np.divmod(np.arange(count), width)
    beside = (column + 1) // 2 * np.where(column % 2 == 1, 1, -1)
    return spacing * np.stack([beside, np.zeros(count), -row], axis=-1).astype(np.float64)


def elbow_room(actor: ModelledScene) -> float:
    """Metres from one character to the next."""
    across = np.ptp(actor.scene.rest().positions[0][:, [0, 2]], axis=0)
    return APART * float(across.max())


def crowd_poses(actor: ModelledScene, view: View, count: int) -> FloatArray:
    """Flattened poses (count, D) of characters: the first is the view's, all others are later."""
    poses = []
    for number in range(count):
        moved = dataclasses.replace(view)
        for clip, time in (("clip", "time"), ("blend_clip", "blend_time")):
            name = getattr(view, clip)
            if name:
                length = actor.scene.clip(name).duration
                own = later(actor, name, getattr(view, time), (number * GOLDEN % 1.0) * length)
                setattr(moved, time, own if number else getattr(view, time))
        poses.append(moved.pose(actor))
    return np.concatenate(poses)
