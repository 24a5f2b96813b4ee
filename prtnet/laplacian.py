"""The Laplacian of functions on the vertices of a mesh, linear in its triangles."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from prtnet.arrays import FloatArray, IntArray

__all__ = ["cotangent_laplacian"]


def cotangent_laplacian(
    vertices: FloatArray, faces: IntArray
) -> tuple[scipy.sparse.csr_array, FloatArray]:
    """The positive semi-definite cotangent Laplacian (V, V) and the vertices' areas (V,).

    Args:
        vertices: (V, 3).
        faces: triangles (T, 3), each with an area.
    """
    count = len(vertices)
    corners = vertices[faces]  # [T, 3, 3]
    ahead, behind = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    u, v = ahead - corners, behind - corners
    area = np.linalg.norm(np.cross(u, v), axis=-1)  # [T, 3] twice the triangle's, at every corner
    half_cotangent = 0.5 * np.sum(u * v, axis=-1) / area
    row, column = np.roll(faces, -1, axis=1).ravel(), np.roll(faces, -2, axis=1).ravel()
    half = scipy.sparse.coo_array((half_cotangent.ravel(), (row, column)), shape=(count, count))
    links = (half + half.T).tocsr()
    diagonal = scipy.sparse.diags_array(links.sum(axis=1))
    areas = np.bincount(faces.ravel(), area.ravel() / 6, minlength=count).astype(np.float64)
    return (diagonal - links).tocsr(), areas
