"""Tangent frames: how smooth over the surface, and how steady in time, against simpler ones.

    python bench/frames.py [SCENE …] [--write]

For each scene, over some poses of its first clip:

- turn: mean angle between the tangents of neighbours, after parallel transport, in degrees;
- jumps: share of neighbours that differ by more than 45 degrees;
- visibility: relative RMS difference of the local-frame visibility of neighbours;
- drift: mean angle a frame between a tangent and where the surface carried it, in degrees.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
from tables import per_cent, publish, scene_path

from data_gen.readers import read_scene
from data_gen.visibility import trace_pose
from prtnet.arrays import FloatArray, IntArray
from prtnet.axis_frames import rolled
from prtnet.frames import FrameField, orthonormal_frames, rest_tangents
from prtnet.scene import Geometry, Receivers, Scene
from prtnet.tangents import perpendicular, tangents_beside

STEP = 1 / 30  # seconds between the two poses that drift is measured over


class EdgeFrames(FrameField):
    """The naive frame: the first edge of the first triangle around a receiver."""

    def __init__(self, scene: Scene, receivers: Receivers) -> None:
        self.scene, self.receivers = scene, receivers
        corners = receivers.of_vertex[scene.faces].ravel()
        first = np.unique(corners, return_index=True)[1]
        self.start, self.end = (
            scene.faces.ravel()[first],
            np.roll(scene.faces, -1, 1).ravel()[first],
        )

    def frames(self, poses: FloatArray, surface: Geometry | None = None) -> FloatArray:
        surface = surface or self.receivers.gather(self.scene.geometry(poses))
        points = self.scene.geometry(poses).positions
        edges = points[:, self.end] - points[:, self.start]
        return orthonormal_frames(edges, surface.normals).astype(np.float32)


class NormalFrames(FrameField):
    """A frame that depends on the normal alone: the same whatever the surface does."""

    def __init__(self, scene: Scene, receivers: Receivers) -> None:
        self.scene, self.receivers = scene, receivers

    def frames(self, poses: FloatArray, surface: Geometry | None = None) -> FloatArray:
        surface = surface or self.receivers.gather(self.scene.geometry(poses))
        axis = np.broadcast_to([1.0, 0.0, 0.0], surface.normals.shape)
        return orthonormal_frames(axis, surface.normals).astype(np.float32)


def angles(a: FloatArray, b: FloatArray) -> FloatArray:
    """Angles between unit vectors in degrees."""
    return np.degrees(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1)))


def smoothness(frames: FloatArray, edges: IntArray) -> tuple[float, float]:
    """Mean turn, and share of jumps, over neighbours on the smooth surface."""
    i, j = edges
    t, n = frames[..., 0].astype(np.float64), frames[..., 2].astype(np.float64)
    turn = angles(rolled(t[:, i], n[:, i], n[:, j]), t[:, j])
    return float(turn.mean()), float(np.mean(turn > 45))


def drift(scene: Scene, receivers: Receivers, field: FrameField, times: FloatArray) -> float:
    """Mean angle between a tangent and where the triangles around it carried the last one."""
    clip = scene.clips[0]
    now, then = scene.poses(clip, times), scene.poses(clip, times + STEP)
    before, after = field.frames(now), field.frames(then)
    a, b = scene.geometry(now).positions, scene.geometry(then).positions
    corners = receivers.of_vertex[scene.faces]
    total = np.zeros((*before.shape[:2], 3))
    for corner in range(3):
        r = corners[:, corner]
        t = before[..., 0][:, r].astype(np.float64)
        old, new = (
            (p[:, scene.faces[:, 1:]] - p[:, scene.faces[:, :1]]).astype(np.float64) for p in (a, b)
        )  # edges [P, T, 2, 3]
        metric = old @ old.swapaxes(-1, -2)
        share = np.linalg.pinv(metric) @ (old @ t[..., None])
        carried = (new.swapaxes(-1, -2) @ share)[..., 0]
        for pose in range(len(total)):
            np.add.at(total[pose], r, carried[pose])
    n = after[..., 2].astype(np.float64)
    carried = tangents_beside(perpendicular(total, n), n)
    return float(angles(carried, after[..., 0].astype(np.float64)).mean())


def measure(path: Path, count: int, rays: int) -> list[list[str]]:
    """A row for each kind of frames."""
    scene = read_scene(path)
    receivers = scene.receivers()
    corners = receivers.of_vertex[scene.faces]
    edges = np.stack([corners, np.roll(corners, -1, 1)], -1).reshape(-1, 2).T
    clip = scene.clips[0]
    times = np.linspace(clip.start, clip.end - STEP, count)
    poses = scene.poses(clip, times)
    rows = []
    for name, field in (
        ("prtnet", FrameField(scene, receivers, rest_tangents(scene, receivers))),
        ("first edge", EdgeFrames(scene, receivers)),
        ("normal only", NormalFrames(scene, receivers)),
    ):
        turn, jumps = smoothness(field.frames(poses), edges)
        v = trace_pose(scene, receivers, field, poses, 4, rays, os.cpu_count() or 1)
        change = v[:, edges[0]] - v[:, edges[1]]
        visibility = float(np.sqrt(np.sum(change**2) / np.sum(v[:, edges[0]] ** 2)))
        moved = drift(scene, receivers, field, times)
        numbers = [f"{turn:.1f}°", per_cent(jumps), per_cent(visibility), f"{moved:.2f}°"]
        rows.append([f"{scene.name}: {name}", *numbers])
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--poses", type=int, default=3)
    parser.add_argument("--rays", type=int, default=512)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    default = ("human.glb", "robot.glb", "fox.glb", "cloth_train.npz")
    paths = arguments.scenes or [scene_path(name) for name in default]
    rows = [row for path in paths for row in measure(path, arguments.poses, arguments.rays)]
    publish("frames", ["frames", "turn", "jumps", "visibility", "drift"], rows)


if __name__ == "__main__":
    main()
