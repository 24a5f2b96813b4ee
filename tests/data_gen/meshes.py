"""Still meshes and their visibility, for tests of the ray tracer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from data_gen.rays import border_operator, departure
from data_gen.visibility import Hemisphere, Tracer, trace_visibility
from prtnet.animation import Clip
from prtnet.frames import orthonormal_frames
from prtnet.scene import PointCacheScene, Receivers

__all__ = ["UNOCCLUDED", "cache", "flat", "quad", "smooth", "together", "visibility"]

UNOCCLUDED = math.sqrt(4 * math.pi)  # the first coefficient of the constant 1

Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]  # positions, faces, normals


def smooth(mesh: trimesh.Trimesh) -> Mesh:
    """Vertices shared by faces, with averaged normals."""
    return np.array(mesh.vertices), np.array(mesh.faces), np.array(mesh.vertex_normals)


def flat(mesh: trimesh.Trimesh) -> Mesh:
    """Every face with vertices and normals of its own."""
    positions = np.array(mesh.triangles).reshape(-1, 3)
    faces = np.arange(len(positions)).reshape(-1, 3)
    return positions, faces, np.repeat(mesh.face_normals, 3, axis=0)


def quad(corners: Sequence[Sequence[float]]) -> Mesh:
    """Two triangles, counter-clockwise as the corners."""
    positions = np.array(corners, dtype=float)
    normal = np.cross(positions[1] - positions[0], positions[2] - positions[0])
    normals = np.tile(normal / np.linalg.norm(normal), (4, 1))
    return positions, np.array([[0, 1, 2], [0, 2, 3]]), normals


def together(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0] + [len(mesh[0]) for mesh in meshes[:-1]])
    return (
        np.concatenate([mesh[0] for mesh in meshes]),
        np.concatenate([mesh[1] + start for mesh, start in zip(meshes, starts, strict=True)]),
        np.concatenate([mesh[2] for mesh in meshes]),
    )


def visibility(
    mesh: Mesh,
    rays: int = 512,
    order: int = 4,
    first: int | None = None,
    tangent: Sequence[float] = (1.0, 0.3, 0.2),
) -> np.ndarray:
    """Visibility (V, n²) of all or the first vertices, in frames with ``tangent``."""
    positions, faces = mesh[0].astype(np.float32), mesh[1].astype(np.int32)
    every = np.arange(len(positions), dtype=np.int32)
    receivers = Receivers(every, np.ones(len(every), dtype=np.int8), every)
    tracer = Tracer(positions, faces)
    normals = mesh[2].astype(np.float32)
    away = departure(normals, border_operator(faces, receivers) @ positions)
    frames = orthonormal_frames(np.tile(tangent, (len(every), 1)), normals)
    origins = tracer.origins(positions, away)[:first]
    frames = frames[:first].astype(np.float32)
    return trace_visibility(tracer, origins, frames, Hemisphere(order, rays))


def cache(frames: np.ndarray, faces: np.ndarray, fps: float = 30.0) -> PointCacheScene:
    """A point cache of frames (F, V, 3) with one clip."""
    end = (len(frames) - 1) / fps
    return PointCacheScene(
        name="cache",
        path=Path("cache.npz"),
        sha256="0" * 64,
        faces=np.asarray(faces, dtype=np.int32),
        clips=(Clip("motion", 0.0, end),),
        frames=np.asarray(frames, dtype=np.float32),
        fps=fps,
    )
