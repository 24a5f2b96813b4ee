"""Meshes to bake: still ones by trimesh, animated scenes as they are at rest.

Triangles without an area and vertices in no other triangle are dropped: what is left can be lit.
"""

from __future__ import annotations

import hashlib
import io
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from data_gen.gltf_document import MOST_BYTES
from data_gen.readers import READERS, read_scene
from data_gen.surface_points import solid_faces, vertex_normals
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError
from prtnet.files import read_bytes
from prtnet.frames import orthonormal_frames, rest_tangents
from prtnet.scene import PointCacheScene, unit

__all__ = ["MESHES", "StaticMesh", "clean_mesh", "read_mesh"]

STILL = (".ply", ".obj", ".stl", ".off")
MESHES = (*STILL, *READERS)


@dataclass(frozen=True, eq=False)
class StaticMesh:
    """A mesh of triangles that all have an area, over vertices that are all used.

    Attributes:
        positions: (V, 3) float32.
        normals: unit, (V, 3) float32.
        tangents: unit and perpendicular to the normals, (V, 3) float32.
        faces: (T, 3) int32, counter-clockwise from outside.
        vertices: which of the file's vertices these are, (V,).
        dropped: how many triangles and vertices were left out.
    """

    positions: FloatArray
    normals: FloatArray
    tangents: FloatArray
    faces: IntArray
    vertices: IntArray
    dropped: tuple[int, int] = (0, 0)


def read_mesh(path: str | Path) -> StaticMesh:
    """Read a mesh; of an animated scene as it is at rest.

    Raises:
        PrtnetError: the file is missing, damaged, of another kind, or nothing in it can be lit.
    """
    path = Path(path)
    if path.suffix.lower() in STILL:
        return clean_mesh(path, *loaded(path))
    scene = read_scene(path)
    rest = scene.rest()
    return clean_mesh(path, rest.positions[0], scene.faces, rest.normals[0])


def loaded(path: Path) -> tuple[FloatArray, IntArray, FloatArray]:
    """Positions (V, 3), faces (T, 3), and normals: the file's, or made from the triangles."""
    import trimesh

    if not path.is_file():
        raise PrtnetError(path, "does not exist or is no file; check the name")
    logging.getLogger("trimesh").setLevel(logging.CRITICAL)  # it logs tracebacks
    try:
        # Of bytes that have no name no materials and pictures are looked for.
        content = read_bytes(path, MOST_BYTES)
        if content is None:
            raise ValueError(f"it has no end, or over {MOST_BYTES} bytes")
        data = io.BytesIO(content)
        mesh = trimesh.load_mesh(data, path.suffix[1:].lower(), process=False)
        positions = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
        faces = np.asarray(mesh.faces, dtype=np.int64).reshape(-1, 3)
        normals = ply_normals(mesh.metadata)
        if normals is None or len(normals) != len(positions):
            normals = np.asarray(mesh.vertex_normals, dtype=np.float64).reshape(-1, 3)
    except Exception as error:  # a damaged file can break its parsers in any way
        reason = " ".join(str(error).split())[:120]
        raise PrtnetError(path, f"cannot be read as a mesh ({reason}); save it anew") from error
    return positions, faces, normals


def ply_normals(metadata: Mapping[str, Any]) -> FloatArray | None:
    """Normals (V, 3) of a PLY file, which trimesh reads and then leaves aside."""
    raw = metadata.get("_ply_raw", {}).get("vertex", {}).get("data")
    if raw is None:
        return None
    names = raw.dtype.names or () if isinstance(raw, np.ndarray) else raw  # binary, or text
    if not {"nx", "ny", "nz"} <= set(names):
        return None
    columns = [np.asarray(raw[name], dtype=np.float64).reshape(-1) for name in ("nx", "ny", "nz")]
    return np.stack(columns, axis=1)


def clean_mesh(
    name: str | Path, positions: FloatArray, faces: IntArray, normals: FloatArray | None = None
) -> StaticMesh:
    """What of a mesh can be lit.

    Args:
        name: for messages.
        positions: (V, 3).
        faces: triangles (T, 3).
        normals: (V, 3); those missing, zero or not finite are made from the triangles.

    Raises:
        PrtnetError: no triangle has an area, one names a vertex that is not there, or a vertex
            that is used lies at no finite place.
    """
    if len(faces) and not (faces.min() >= 0 and faces.max() < len(positions)):
        raise PrtnetError(name, "has triangles of vertices that are not there; save it anew")
    if not np.isfinite(np.asarray(positions)[faces]).all():
        raise PrtnetError(name, "has vertices at no finite place; repair it")
    places, kept, vertices = (
        np.asarray(positions, dtype=np.float32),
        faces,
        np.arange(len(positions)),
    )
    while True:  # what float32 cannot tell apart has no area either
        solid = kept[solid_faces(places, kept)]
        if len(solid) == 0:
            raise PrtnetError(name, "has no triangle with an area; nothing can be lit")
        used, solid = np.unique(solid, return_inverse=True)
        done = len(used) == len(places) and solid.size == kept.size
        places, vertices, kept = places[used], vertices[used], solid.reshape(-1, 3)
        if done:
            break
    kept = kept.astype(np.int32)
    found = vertex_normals(places, kept)
    if normals is not None:
        own = np.asarray(normals, dtype=np.float64)[vertices]
        size = np.linalg.norm(own, axis=1)
        good = np.isfinite(size) & (size > 1e-6)
        found[good] = unit(own[good])
    frames = orthonormal_frames(tangents_of(places, kept), found)
    return StaticMesh(
        places,
        frames[..., 2].astype(np.float32),
        frames[..., 0].astype(np.float32),
        kept,
        vertices,
        (len(faces) - len(kept), len(positions) - len(places)),
    )


def tangents_of(positions: FloatArray, faces: IntArray) -> FloatArray:
    """Tangents (V, 3) as those of a scene that never moves."""
    scene = PointCacheScene(
        name="mesh",
        path=None,
        sha256=hashlib.sha256(positions.tobytes()).hexdigest(),
        faces=faces,
        clips=(),
        frames=positions[None],
        fps=1.0,
    )
    receivers = scene.receivers()
    return rest_tangents(scene, receivers)[receivers.of_vertex]
