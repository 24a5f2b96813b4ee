"""Segments of a surface that move alike: mean shift on skin weights or on rotation sequences.

"Arbitrary BRDFs" section 5.2 segments articulated characters by mean shift [1] on their skin
weights, and all else into as-rigid-as-possible parts, whose triangles rotate alike over time [2].

[1] Comaniciu, Meer. "Mean shift: a robust approach toward feature space analysis". PAMI 2002.
[2] James, Twigg. "Skinning mesh animations". SIGGRAPH 2005.
"""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.frames import orthonormal_frames
from training.clusters import squared_distances

__all__ = ["mean_shift", "rotation_sequences"]

ROUNDS = 100
STILL = 1e-3  # of the bandwidth: a mode that moves less has arrived


def mean_shift(points: FloatArray, bandwidth: float, most: int = 1000, seed: int = 0) -> IntArray:
    """The segment of each of ``points`` (V, D), counted from 0, (V,).

    Modes are sought among ``most`` of the points, from each of them, with a flat kernel; of modes
    nearer to each other than the bandwidth the densest stays. Every point belongs to its nearest.

    Args:
        points: (V, D).
        bandwidth: radius of the kernel.
        most: points that the density is estimated from: the cost is quadratic in it.
        seed: of the choice of those points.
    """
    chosen = np.random.default_rng(seed).permutation(len(points))[:most]
    sample: FloatArray = points[chosen].astype(np.float64)
    modes = sample.copy()
    for _ in range(ROUNDS):
        near = (squared_distances(modes, sample) <= bandwidth**2).astype(np.float64)
        moved = near @ sample / np.maximum(near.sum(axis=1, keepdims=True), 1.0)
        step = np.linalg.norm(moved - modes, axis=1).max()
        modes = moved
        if step < STILL * bandwidth:
            break
    density = near.sum(axis=1)
    apart = squared_distances(modes, modes) > bandwidth**2
    free = np.ones(len(modes), dtype=bool)
    centres = []
    while free.any():
        densest = int(np.argmax(np.where(free, density, -1.0)))
        centres.append(modes[densest])
        free &= apart[densest]
        free[densest] = False
    nearest = np.argmin(squared_distances(points.astype(np.float64), np.stack(centres)), axis=1)
    return np.unique(nearest, return_inverse=True)[1]


def rotation_sequences(
    rest_normals: FloatArray, rest_tangents: FloatArray, normals: FloatArray, tangents: FloatArray
) -> FloatArray:
    """How the surface around each receiver is turned from rest in some poses, (V, S · 9).

    Distances are the root mean square over the poses of sin(θ/2), θ the angle between two turns.

    Args:
        rest_normals: (V, 3), unit.
        rest_tangents: (V, 3), unit.
        normals: of S poses, (S, V, 3), unit.
        tangents: of the same poses, (S, V, 3), unit.
    """
    rest = orthonormal_frames(rest_tangents, rest_normals)
    turned = orthonormal_frames(tangents, normals) @ np.swapaxes(rest, -1, -2)  # [S, V, 3, 3]
    flat = np.swapaxes(turned, 0, 1).reshape(len(rest), -1)
    return flat / np.sqrt(8.0 * len(turned))
