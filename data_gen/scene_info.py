"""What is in a scene, in words and numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from prtnet.animation import Clip
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.scene import Scene, SkinnedScene, unique_rows

__all__ = ["describe", "moving_joints"]

RELATIVE_MOTION = 1e-6  # of the largest entry: float32 matrices cannot tell less from rest


def describe(scene: Scene) -> dict[str, Any]:
    """Facts about a scene that can be written as JSON: counts, metres and seconds."""
    rest = scene.rest().positions[0]
    used = np.unique(scene.faces)
    edges = open_edges(rest, scene.faces)
    facts: dict[str, Any] = {
        "kind": "skinned" if isinstance(scene, SkinnedScene) else "point_cache",
        "vertices": scene.vertex_count,
        "receivers": len(scene.receivers()),
        "triangles": len(scene.faces),
        "open_edges": edges,
        "closed": edges == 0,
        "box_min": rounded(rest[used].min(axis=0)),
        "box_max": rounded(rest[used].max(axis=0)),
        "clips": {clip.name: clip_facts(clip, scene) for clip in scene.clips},
    }
    if isinstance(scene, SkinnedScene):
        moving = moving_joints(scene)
        names = scene.joint_names
        facts["joints"] = scene.joint_count
        facts["joints_that_never_move"] = [
            name for name, moves in zip(names, moving, strict=True) if not moves
        ]
        facts["morph_targets"] = scene.morph_count
        facts["flat_shaded"] = scene.normals is None
    facts["mesh_sha256"] = scene.mesh_sha256
    return facts


def rounded(point: FloatArray) -> list[float]:
    """A point to the micrometre, without negative zeros."""
    return [round(float(coordinate), 6) + 0.0 for coordinate in point]


def clip_facts(clip: Clip, scene: Scene) -> dict[str, float]:
    """Length of a clip and its number of distinct key times or frames."""
    if clip.channels:
        keys = len(np.unique(np.concatenate([channel.times for channel in clip.channels])))
    else:
        keys = len(getattr(scene, "frames", ()))
    return {"seconds": round(clip.duration, 6), "keys": keys}


def moving_joints(scene: SkinnedScene, samples: int = 256) -> BoolArray:
    """Which joints move in model space in any clip, (J,), judged at evenly spaced times."""
    low = np.full((scene.joint_count, 3, 4), np.inf)
    high = -low
    for clip in scene.clips:
        matrices = scene.joint_matrices(scene.poses(clip, clip.times(count=samples)))
        low = np.minimum(low, matrices.min(axis=0))
        high = np.maximum(high, matrices.max(axis=0))
    size = np.maximum(np.abs(low), np.abs(high)).max(axis=(0, 1))  # by column
    size[:3] = size[:3].max()
    return ((high - low) > RELATIVE_MOTION * size).any(axis=(1, 2))


def open_edges(positions: FloatArray, faces: IntArray) -> int:
    """Number of edges with one face only, vertices at one place taken as one."""
    _, place = unique_rows(positions)
    faces = place[faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]  # without those of no area
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges[:, 0] * len(place) + edges[:, 1], return_counts=True)
    return int((counts == 1).sum())
