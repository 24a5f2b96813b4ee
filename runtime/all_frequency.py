"""Shading of all-frequency transfer, in NumPy: light, representatives, vertices, then the view.

    T^i = M^i L                     of every representative of every cluster    [1, eq. 13]
    T_p = Σ_segments Σ_i w_p^i T^i      of every vertex
    g_p(v) = G(v) · T_p             towards the eye                             [1, eq. 7]

A step is done anew only where what is before it has changed: when the eye moves, the last. The
reference of ``runtime.all_frequency_products`` and ``runtime.all_frequency_shader``.

Papers:
    [1] Liu, Sloan, Shum and Snyder, "All-Frequency Precomputed Radiance Transfer for Glossy
        Objects", 2004.
"""

from __future__ import annotations

import numpy as np

from prtnet.all_frequency import AllFrequencyField
from prtnet.arrays import FloatArray, IntArray
from prtnet.cube_map import segment_coefficients
from prtnet.frames import orthonormal_frames
from prtnet.scene import unit
from prtnet.sparse_columns import sparse_matrix
from runtime.lobe_shading import seen_in, view_factors

__all__ = ["gathered", "representative_starts", "seen_from", "shaded", "transformed"]

BLOCK = 1 << 12  # vertices of a segment at a time


def representative_starts(field: AllFrequencyField) -> IntArray:
    """Where each segment's representatives begin among those of all, and their number, (25,)."""
    counts = [one.scale.size for one in field.segments]
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])


def transformed(field: AllFrequencyField, light: FloatArray) -> FloatArray:
    """T^i, times what 1 in a vertex's weight stands for: (representatives, m, 3).

    Args:
        field: whose representatives, those of the segments one after another.
        light: Haar coefficients of ``prtnet.cube_map.segment_coefficients``, (24, (n/2)², 3).
    """
    parts = []
    for one, shining in zip(field.segments, light.astype(np.float64), strict=True):
        sums = sparse_matrix(one.representatives, field.rows) @ shining
        scale = one.scale.reshape(-1, 1, 1) * np.float64(one.step)
        parts.append(sums.reshape(-1, field.rows, 3) * scale)
    return np.concatenate(parts)


def gathered(field: AllFrequencyField, sums: FloatArray) -> FloatArray:
    """T_p of every vertex, (P, m, 3), of what :func:`transformed` gives."""
    total = np.zeros((len(field), field.rows, 3))
    starts = representative_starts(field)
    for one, start, stop in zip(field.segments, starts[:-1], starts[1:], strict=True):
        own = sums[start:stop].reshape(*one.scale.shape, 3 * field.rows)
        labels = one.labels()
        for first in range(0, len(labels), BLOCK):
            part = slice(first, first + BLOCK)
            found = np.einsum("kn,kne->ke", one.weights[part], own[labels[part]])
            total[one.vertices[part]] += found.reshape(-1, field.rows, 3)
    return total


def seen_from(field: AllFrequencyField, rows: FloatArray, eye: FloatArray) -> FloatArray:
    """Radiance of vertices towards an eye, (P, 3) linear RGB.

    Args:
        field: of P vertices.
        rows: T_p, (P, m, 3).
        eye: where it is, (3,) world space.
    """
    surface = field.surface
    frames = orthonormal_frames(surface.tangents, surface.normals)
    local = np.einsum("pij,pi->pj", frames, unit(np.asarray(eye) - surface.positions))
    return seen_in(rows, view_factors(field.view, local))


def shaded(field: AllFrequencyField, texels: FloatArray, eye: FloatArray) -> FloatArray:
    """Radiance of vertices towards an eye under a cube map of light (6, n, n, 3): (P, 3).

    Raises:
        ValueError: the light has another number of texels than the field.
    """
    if texels.shape != (6, field.size, field.size, 3):
        raise ValueError(f"light of shape {texels.shape} does not fit faces of {field.size} texels")
    rows = gathered(field, transformed(field, segment_coefficients(texels)))
    return seen_from(field, rows, eye)
