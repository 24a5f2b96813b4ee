"""Visibility by ray tracing: occlusion over the hemisphere above a receiver, projected to SH.

V(s) = 0 where a ray above the horizon hits the scene, 1 elsewhere ("Arbitrary BRDFs", eq. 1). The
rays are a spherical Fibonacci hemisphere in the receiver's frame. Their *occlusion* is projected,
and taken from the projection of the constant 1, which is exact: unoccluded receivers are exact,
and the half below the horizon needs no rays.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from data_gen.rays import LIFT, border_operator, departure
from prtnet import sh
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.cores import lasting_threads
from prtnet.frames import FrameField
from prtnet.scene import Receivers, Scene

__all__ = ["Hemisphere", "PoseTracer", "TracedPose", "Tracer", "trace_pose", "trace_visibility"]

BATCH = 1 << 17  # rays traced at once: 3.5 MB of them, which stay in the cache


class Tracer:
    """The triangles of one pose, to be asked what they hide.

    Embree counts in float32: triangles are first centred and scaled to the unit cube, in float64,
    so that scenes of any size and place are traced alike. Degenerate triangles hide nothing.

    Args:
        positions: posed vertices (V_render, 3), finite.
        faces: triangles (T, 3).
    """

    def __init__(self, positions: FloatArray, faces: IntArray) -> None:
        used = positions[np.unique(faces)]
        low, high = used.min(axis=0).astype(np.float64), used.max(axis=0).astype(np.float64)
        self.centre = (low + high) / 2
        self.scale = float(np.max(high - low)) / 2 or 1.0
        # Positions were rounded before they came here: far away, by more than the lift.
        rounding = np.spacing(np.float32(np.abs(used).max()))
        self.slack = 2.0 * float(rounding) / self.scale
        unit = self.normalise(positions)
        # Embree's default mode is a quarter faster than its robust one, and lets about one ray in
        # 150,000 slip through an edge: far below the noise.
        self.scene = EmbreeScene()
        TriangleMesh(self.scene, unit.astype(np.float32), faces.astype(np.int32))

    def normalise(self, points: FloatArray) -> FloatArray:
        """Points (N, 3) in the tracer's own coordinates, float64."""
        return (np.asarray(points, dtype=np.float64) - self.centre) / self.scale

    def origins(self, points: FloatArray, directions: FloatArray) -> FloatArray:
        """Ray origins (N, 3) for surface points, off the surface along ``directions``, float32.

        They are in the tracer's own coordinates.
        """
        lifted = self.normalise(points) + (LIFT + self.slack) * directions
        return lifted.astype(np.float32)

    def occluded(self, origins: FloatArray, directions: FloatArray) -> BoolArray:
        """Which rays hit a triangle, (N,). The origins come from ``origins``; both float32."""
        hits = self.scene.run(origins, directions, query="OCCLUDED")
        return np.asarray(hits) != -1


@dataclass(frozen=True, eq=False)
class Hemisphere:
    """Directions above the horizon of a local frame, and what a hit along each takes from V."""

    order: int
    rays: int

    @cached_property
    def directions(self) -> FloatArray:
        """Unit directions (K, 3), float32."""
        return sh.fibonacci_hemisphere(self.rays).astype(np.float32)

    @cached_property
    def basis(self) -> FloatArray:
        """−w·y(d), (K, n²) float32: every direction stands for the same solid angle 2π/K."""
        y = sh.evaluate(self.directions.astype(np.float64), self.order)
        return (-2 * math.pi / self.rays * y).astype(np.float32)


def trace_visibility(
    tracer: Tracer, origins: FloatArray, frames: FloatArray, hemisphere: Hemisphere
) -> FloatArray:
    """Visibility (V, n²) float32 of receivers in their local frames.

    Args:
        tracer: the occluders.
        origins: ``tracer.origins`` of the receivers, (V, 3) float32.
        frames: columns tangent, bitangent, normal, (V, 3, 3) float32.
        hemisphere: the rays.
    """
    count, rays = len(origins), hemisphere.rays
    size = min(max(1, BATCH // rays), count)
    rotations = np.ascontiguousarray(frames.transpose(0, 2, 1))
    # Fresh pages cost more than all that is written to them: every batch uses the same ones.
    directions = np.empty((size, rays, 3), dtype=np.float32)
    starts = np.empty_like(directions)
    occluded = np.empty((size, rays), dtype=np.float32)
    visibility = np.empty((count, hemisphere.order**2), dtype=np.float32)
    for first in range(0, count, size):
        batch = slice(first, min(first + size, count))
        n = batch.stop - first
        np.matmul(hemisphere.directions, rotations[batch], out=directions[:n])
        repeat_rows(origins[batch], starts[:n])
        hit = tracer.occluded(starts[:n].reshape(-1, 3), directions[:n].reshape(-1, 3))
        occluded[:n] = hit.reshape(n, rays)
        np.matmul(occluded[:n], hemisphere.basis, out=visibility[batch])
    visibility[:, 0] += np.float32(math.sqrt(4 * math.pi))
    return visibility


def repeat_rows(rows: FloatArray, out: FloatArray) -> None:
    """Write each of ``rows`` (N, 3) to all of ``out[n]`` (K, 3), by doubling: wide copies."""
    out[:, 0] = rows
    filled = 1
    while filled < out.shape[1]:
        more = min(filled, out.shape[1] - filled)
        out[:, filled : filled + more] = out[:, :more]
        filled += more


@dataclass(frozen=True, eq=False)
class TracedPose:
    """One pose's receivers in model space and their visibility in local frames, float32."""

    positions: FloatArray  # [V, 3]
    normals: FloatArray  # [V, 3]
    tangents: FloatArray  # [V, 3]
    visibility: FloatArray  # [V, n²]


class PoseTracer:
    """Pose in, visibility of every receiver out; safe to call from several threads.

    Args:
        scene: the animated mesh.
        receivers: of that scene.
        frame_field: their tangent frames.
        order: n of the spherical harmonics.
        rays: rays a receiver, above the horizon.
    """

    def __init__(
        self, scene: Scene, receivers: Receivers, frame_field: FrameField, order: int, rays: int
    ) -> None:
        self.scene, self.receivers, self.frame_field = scene, receivers, frame_field
        self.hemisphere = Hemisphere(order, rays)
        self._inward = border_operator(scene.faces, receivers)

    def __call__(self, pose: FloatArray) -> TracedPose:
        """Trace one flattened pose (D,)."""
        mesh = self.scene.geometry(pose[None])
        surface = self.receivers.gather(mesh)
        frames = self.frame_field.frames(pose[None], surface)[0]
        points, normals = surface.positions[0], surface.normals[0]
        tracer = Tracer(mesh.positions[0], self.scene.faces)
        away = departure(normals, self._inward @ mesh.positions[0])
        visibility = trace_visibility(tracer, tracer.origins(points, away), frames, self.hemisphere)
        return TracedPose(points, normals, np.ascontiguousarray(frames[..., 0]), visibility)

    def map(self, poses: FloatArray, pool: ThreadPoolExecutor) -> Iterator[TracedPose]:
        """Trace poses (P, D) in the pool's threads, in order."""
        return pool.map(self, poses)


def trace_pose(
    scene: Scene,
    receivers: Receivers,
    frame_field: FrameField,
    poses: FloatArray,
    order: int = 4,
    rays: int = 512,
    threads: int = 1,
) -> FloatArray:
    """True visibility (P, V, n²) float32 of flattened poses (P, D), in local frames."""
    tracer = PoseTracer(scene, receivers, frame_field, order, rays)
    traced = tracer.map(poses, lasting_threads(threads))
    return np.stack([pose.visibility for pose in traced])
