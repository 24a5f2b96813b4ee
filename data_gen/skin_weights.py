"""Skin weights by heat diffusion from the bones over the surface [1].

Every vertex is heated by its nearest bone with a strength of one over its squared distance to it,
and the heat spreads along the skin, so a hand beside a thigh does not pull on it.

[1] Baran and Popović, "Automatic rigging and animation of 3D characters", SIGGRAPH 2007, §4.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from prtnet.arrays import FloatArray, IntArray
from prtnet.laplacian import cotangent_laplacian

__all__ = ["bone_heat", "strongest"]

TIE = 1.001  # distances that differ by less are equal
NEGLIGIBLE = 0.01  # weights below it are dropped


def segment_distances(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distances (N, S) from points (N, 3) to segments (S, 2, 3)."""
    start, along = segments[:, 0], segments[:, 1] - segments[:, 0]
    offset = points[:, None] - start
    squared = np.maximum(np.sum(along**2, axis=-1), 1e-12)
    u = np.clip(np.sum(offset * along, axis=-1) / squared, 0.0, 1.0)
    return np.linalg.norm(offset - u[..., None] * along, axis=-1)


def bone_heat(
    vertices: FloatArray, faces: IntArray, segments: FloatArray, joint: IntArray, spread: float
) -> FloatArray:
    """Smooth weights (V, J) that sum to one ([1] eq. 1).

    Args:
        vertices: of a closed mesh, (V, 3).
        faces: its triangles, (T, 3).
        segments: the bones inside it, (S, 2, 3); a joint may have several.
        joint: the joint of every segment, (S,).
        spread: how far the heat travels, in distances to the bone; [1] has 1.
    """
    distances = segment_distances(vertices, segments)
    least = distances.min(axis=1, keepdims=True)
    strength = 1.0 / (spread * least[:, 0]) ** 2
    nearest = distances <= TIE * least  # bones at equal distance share, as in [1]
    source = nearest @ np.eye(int(joint.max()) + 1)[joint]
    source /= source.sum(axis=1, keepdims=True)
    laplacian, areas = cotangent_laplacian(vertices, faces)
    heat = scipy.sparse.diags_array(areas * strength)
    return splu((laplacian + heat).tocsc()).solve(heat @ source)


def strongest(weights: FloatArray, influences: int = 4) -> scipy.sparse.csr_array:
    """Weights with at most ``influences`` a row, summing to one again, sparse (V, J) float32.

    The largest weight that must go is taken off all: they stay continuous over the skin.
    """
    excess = np.maximum(np.sort(weights, axis=1)[:, -influences - 1, None], NEGLIGIBLE)
    kept = np.maximum(weights - excess, 0.0)
    kept /= kept.sum(axis=1, keepdims=True)
    return scipy.sparse.csr_array(kept.astype(np.float32))
