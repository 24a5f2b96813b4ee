"""Tangent frames that move with the surface.

Skinned scenes carry a tangent with the vertex's blended matrix, as engines do; point caches carry
it with the deformation gradient of the faces around the vertex. Both then make it perpendicular to
the posed normal. Where the tangents come from at rest: ``prtnet.tangents``.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from prtnet.arrays import FloatArray, IntArray
from prtnet.scene import Geometry, Receivers, Scene, SkinnedScene, unit
from prtnet.tangents import rest_tangents, tangents_beside

__all__ = ["FrameField", "deformation_operator", "orthonormal_frames", "rest_tangents"]


def orthonormal_frames(tangents: FloatArray, normals: FloatArray) -> FloatArray:
    """Right-handed frames (..., 3, 3) with columns tangent, bitangent, normal; float64.

    The normal is kept, the tangent is made perpendicular to it (Gram–Schmidt).

    Args:
        tangents: (..., 3), any length; where they vanish or are along the normal, any will do.
        normals: (..., 3); a zero normal becomes y.
    """
    n = unit(np.asarray(normals, dtype=np.float64))
    t = tangents_beside(np.asarray(tangents, dtype=np.float64), n)
    return np.stack([t, np.cross(n, t), n], axis=-1)


class FrameField:
    """Tangent frames of a scene's receivers in any pose.

    Args:
        scene: the animated mesh.
        receivers: of that scene.
        tangents: at rest, (V, 3), in model space: ``rest_tangents`` or what a file kept of them.

    Attributes:
        bind_tangents: the tangents in bind space, as a vertex attribute of an engine would be,
            (V, 3); None for point caches.
    """

    def __init__(self, scene: Scene, receivers: Receivers, tangents: FloatArray) -> None:
        self.scene, self.receivers = scene, receivers
        self.bind_tangents: FloatArray | None = None
        if isinstance(scene, SkinnedScene):
            rest = scene.vertex_matrices(scene.rest_pose())[0, receivers.vertex, :, :3]
            self.bind_tangents = unit(
                (np.linalg.pinv(rest) @ np.asarray(tangents, dtype=np.float64)[..., None])[..., 0],
                (1.0, 0.0, 0.0),
            )
        else:
            fronts = np.asarray(tangents)[receivers.side > 0]
            rest = scene.rest().positions[0]
            carry = deformation_operator(rest, scene.faces, receivers.of_vertex, fronts)
            copies = [carry] * (len(receivers) // len(fronts))
            self._carry = scipy.sparse.csr_array(scipy.sparse.vstack(copies))

    def frames(self, poses: FloatArray, surface: Geometry | None = None) -> FloatArray:
        """Right-handed frames (P, V, 3, 3) float32 of flattened poses (P, D).

        Args:
            poses: flattened poses.
            surface: the receivers in these poses (``Receivers.gather``), where they are known.
        """
        if surface is None:
            surface = self.receivers.gather(self.scene.geometry(poses))
        frames = orthonormal_frames(self._carried(poses), surface.normals)
        return frames.astype(np.float32)

    def _carried(self, poses: FloatArray) -> FloatArray:
        """The tangents (P, V, 3) where the surface took them, neither unit nor perpendicular."""
        if isinstance(self.scene, SkinnedScene) and self.bind_tangents is not None:
            matrices = self.scene.vertex_matrices(poses)[:, self.receivers.vertex, :, :3]
            return np.einsum("pvij,vj->pvi", matrices, self.bind_tangents)
        count = len(poses)
        positions = poses.reshape(count, -1, 3).transpose(1, 0, 2).reshape(-1, 3 * count)
        carried = self._carry @ positions.astype(np.float64)
        return carried.reshape(-1, count, 3).transpose(1, 0, 2)


def deformation_operator(
    rest: FloatArray, faces: IntArray, of_vertex: IntArray, tangents: FloatArray
) -> scipy.sparse.csr_array:
    """Matrix (R, vertices) from vertex positions to each front receiver's carried tangent.

    The deformation gradient F of a face with rest edges e₁, e₂ carries a tangent t to
    e₁' (g₁·t) + e₂' (g₂·t), with gᵢ in the face and gᵢ·eⱼ = δᵢⱼ: linear in the posed positions.
    Faces around a receiver are weighted by their rest area.

    Args:
        rest: render vertices at rest, (vertices, 3).
        faces: triangles over them, (T, 3).
        of_vertex: the front receiver of each, (vertices,).
        tangents: of the front receivers at rest, (R, 3).
    """
    rest = np.asarray(rest, dtype=np.float64)
    corners = of_vertex[faces]  # [T, 3]
    a, b, c = (rest[faces[:, k]] for k in range(3))
    edges = np.stack([b - a, c - a], axis=1)  # [T, 2, 3]
    metric = edges @ edges.transpose(0, 2, 1)
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    solid = determinant > 1e-12 * metric[:, 0, 0] * metric[:, 1, 1]
    inverse = np.zeros_like(metric)
    inverse[solid] = np.linalg.inv(metric[solid])
    duals = inverse @ edges * np.sqrt(np.maximum(determinant, 0.0))[:, None, None]  # by area

    t = np.asarray(tangents, dtype=np.float64)[corners]  # [T, corner, 3]
    along = t @ duals.transpose(0, 2, 1)  # [T, corner, 2]
    values = np.concatenate([-along.sum(axis=2, keepdims=True), along], axis=2)  # on a, b, c
    rows = np.repeat(corners[:, :, None], 3, axis=2)
    columns = np.repeat(faces[:, None, :], 3, axis=1)
    return scipy.sparse.csr_array(
        (values.ravel(), (rows.ravel(), columns.ravel())), shape=(len(tangents), len(rest))
    )
