"""A still mesh with fewer vertices: edges collapse until so many are left."""

from __future__ import annotations

import math

import numpy as np
import scipy.spatial

from data_gen.decimation import coarsen
from data_gen.static_mesh import StaticMesh, clean_mesh
from data_gen.surface_points import vertex_normals
from prtnet.arrays import FloatArray, IntArray

__all__ = ["coarser"]

FIRST, LAST = 0.5, 16.0  # lengths of edges that go, in mean distances of vertices that stay
LONGER = 1.25


def coarser(mesh: StaticMesh, vertices: int) -> StaticMesh:
    """The mesh with ``vertices`` vertices; as it is where it has no more.

    Short edges go first. A few vertices more may stay where no edge can go without a fold.

    Vertices at the same place become one: normals are those of the triangles, without hard edges.

    Raises:
        PrtnetError: so few vertices make no surface.
    """
    if len(mesh.positions) <= vertices:
        return mesh
    low = mesh.positions.min(axis=0).astype(np.float64)
    size = float((mesh.positions.max(axis=0) - low).max())
    places, together = np.unique(mesh.positions, axis=0, return_inverse=True)
    faces: IntArray = together.ravel()[mesh.faces]
    # Of unit size, so that turns of the normal count as much whatever the unit, and off the plane
    # x = 0, which is a border to ``coarsen``.
    places = 1.0 + (places - low) / size
    tree = scipy.spatial.KDTree(places)
    start, upright = places, vertex_normals(places, faces)

    def project(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """On the tangent plane of the nearest vertex of the fine mesh."""
        _, near = tree.query(points)
        normals = upright[near]
        off = ((points - start[near]) * normals).sum(axis=1, keepdims=True)
        return points - off * normals, normals

    longest = FIRST / math.sqrt(vertices)
    while len(places) > vertices and longest < LAST / math.sqrt(vertices):
        places, faces = coarsen(places, faces, project, longest, vertices)
        longest *= LONGER
    back = (places - 1.0) * size + low
    return clean_mesh("decimated mesh", back, faces)
