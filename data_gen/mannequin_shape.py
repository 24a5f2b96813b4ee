"""The mannequin's body: lofts along its limbs, blended into one implicit surface.

Metres, y up, facing +z, feet on y = 0, arms lowered halfway (an A-pose). The left side is x > 0;
the right side is its mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from data_gen.isosurface import polygonise
from prtnet.arrays import FloatArray, IntArray

__all__ = ["ARM_DIRECTION", "body", "build"]

ARM_DIRECTION = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0])  # of the left arm at rest
SHOULDER = np.array([0.176, 1.352, -0.018])
WRIST = SHOULDER + 0.53 * ARM_DIRECTION
HIP, ANKLE = np.array([0.092, 0.93, -0.005]), np.array([0.115, 0.07, -0.02])

REACH = 0.10  # metres: more than the width of any smooth union
CELL = 0.012  # metres: of the fine grid; a thumb is three of them thick


class Loft:
    """A tube of superelliptic sections along a straight axis, closed by rounded ends.

    Args:
        origin: where the axis starts.
        axis: its direction.
        across: the direction of the sections' half-width, made orthogonal to the axis; their
            half-depth is along axis × across.
        stations: rows of (distance along the axis, half-width, half-depth, offset of the centre
            across, and in depth), in metres.
        caps: how far the rounded ends reach beyond the first and the last station.
        power: exponent of the sections: 2 is an ellipse, more is boxier.
    """

    def __init__(
        self,
        origin: Sequence[float] | FloatArray,
        axis: Sequence[float] | FloatArray,
        across: Sequence[float],
        stations: Sequence[tuple[float, float, float, float, float]],
        caps: tuple[float, float],
        power: float = 2.0,
    ) -> None:
        along = np.asarray(axis) / np.linalg.norm(axis)
        side = np.asarray(across) - along * np.dot(across, along)
        side /= np.linalg.norm(side)
        self.origin = np.asarray(origin)
        self.frame = np.stack([side, np.cross(along, side), along], axis=1)
        table = np.array(stations)
        self.ends = table[0, 0], table[-1, 0]
        self.profile = CubicSpline(table[:, 0], table[:, 1:], bc_type="clamped")  # even with caps
        self.caps = caps
        self.power = power
        # No surface is farther from the axis: a superellipse stays within its box.
        self.girth = max(*caps, np.sqrt(2) * table[:, 1:3].max() + np.abs(table[:, 3:]).max())

    def __call__(self, points: FloatArray) -> FloatArray:
        """Signed distance (N,), measured along the line to the section's centre.

        Points farther than ``REACH`` get a lower bound instead, which no union can tell apart.
        """
        local = (points - self.origin) @ self.frame
        s = np.clip(local[:, 2], *self.ends)
        local[:, 2] -= s
        distance = np.sqrt(np.einsum("nk,nk->n", local, local)) - self.girth
        near = np.flatnonzero(distance < REACH)
        half_width, half_depth, offset_across, offset_depth = self.profile(s[near]).T
        q = local[near].T
        q[0] -= offset_across
        q[1] -= offset_depth
        reach = np.where(q[2] < 0, self.caps[0], self.caps[1])
        scaled = np.abs(q / np.stack([half_width, half_depth, reach])) ** self.power
        rho = np.maximum(scaled.sum(axis=0), 1e-12) ** (1 / self.power)
        distance[near] = np.linalg.norm(q, axis=0) * (1 - 1 / rho)
        return distance


def smooth_union(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    """The lesser of two distances, rounded where they differ by less than ``width`` metres."""
    overlap = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.minimum(a, b) - overlap**3 * (width / 6)


TRUNK = Loft(
    (0, 0, 0), (0, 1, 0), (1, 0, 0),
    [  # along is +y, so depth is -z: a positive offset moves the section back
        (0.85, 0.108, 0.078, 0, 0.008),
        (0.89, 0.130, 0.092, 0, 0.009),
        (0.94, 0.148, 0.101, 0, 0.007),
        (1.01, 0.143, 0.095, 0, -0.001),
        (1.08, 0.128, 0.087, 0, -0.007),
        (1.15, 0.133, 0.091, 0, -0.006),
        (1.23, 0.150, 0.102, 0, 0.000),
        (1.30, 0.161, 0.103, 0, 0.008),
        (1.36, 0.160, 0.091, 0, 0.016),
        (1.40, 0.132, 0.074, 0, 0.020),
        (1.44, 0.078, 0.060, 0, 0.020),
        (1.48, 0.055, 0.055, 0, 0.010),
        (1.52, 0.052, 0.055, 0, 0.002),
    ],
    caps=(0.05, 0.05), power=2.2,
)  # fmt: skip
CHEST = Loft(
    (0.072, 1.275, 0.045), (0, 1, 0), (1, 0, -0.35),
    [(-0.01, 0.070, 0.052, 0, 0), (0.01, 0.070, 0.052, 0, 0)],
    caps=(0.045, 0.06),
)  # fmt: skip
SEAT = Loft(
    (0.070, 0.888, -0.052), (0, 1, 0), (1, 0, 0.3),
    [(-0.01, 0.066, 0.068, 0, 0), (0.01, 0.066, 0.068, 0, 0)],
    caps=(0.065, 0.08),
)  # fmt: skip
HEAD = Loft(
    (0, 0, 0), (0, 1, 0), (1, 0, 0),
    [
        (1.510, 0.041, 0.046, 0, -0.052),
        (1.535, 0.053, 0.067, 0, -0.036),
        (1.570, 0.066, 0.087, 0, -0.020),
        (1.610, 0.073, 0.095, 0, -0.012),
        (1.635, 0.074, 0.096, 0, -0.010),
    ],
    caps=(0.034, 0.072),
)  # fmt: skip
NOSE = Loft(
    (0, 1.60, 0.098), (0, -0.97, 0.25), (1, 0, 0),
    [(0, 0.008, 0.010, 0, 0), (0.015, 0.009, 0.010, 0, 0), (0.03, 0.011, 0.012, 0, 0),
     (0.042, 0.012, 0.012, 0, 0)],
    caps=(0.02, 0.010),
)  # fmt: skip
LEG = Loft(
    HIP, ANKLE - HIP, (1, 0, 0),
    [  # along is -y, so depth is +z
        (0.00, 0.066, 0.080, 0, 0.002),
        (0.08, 0.079, 0.089, 0, 0.000),
        (0.18, 0.079, 0.086, 0, 0.003),
        (0.30, 0.067, 0.074, 0, 0.008),
        (0.40, 0.055, 0.060, 0, 0.009),
        (0.46, 0.051, 0.056, 0, 0.007),
        (0.52, 0.050, 0.055, 0, -0.004),
        (0.60, 0.053, 0.058, 0, -0.014),
        (0.70, 0.042, 0.045, 0, -0.010),
        (0.79, 0.032, 0.036, 0, -0.004),
        (0.85, 0.031, 0.038, 0, -0.002),
    ],
    caps=(0.08, 0.03),
)  # fmt: skip
FOOT = Loft(
    (0.113, 0, -0.05), (0.12, 0, 1), (1, 0, 0),
    [  # along is +z, so depth is +y
        (0.000, 0.030, 0.034, 0, 0.032),
        (0.050, 0.033, 0.048, 0, 0.036),
        (0.100, 0.038, 0.040, 0, 0.030),
        (0.150, 0.044, 0.029, 0, 0.021),
        (0.190, 0.042, 0.021, 0, 0.016),
    ],
    caps=(0.028, 0.032), power=2.3,
)  # fmt: skip
ARM = Loft(
    SHOULDER, ARM_DIRECTION, (0, 0, 1),
    [
        (-0.01, 0.046, 0.044, 0, 0),
        (0.04, 0.055, 0.050, 0, 0),
        (0.09, 0.053, 0.049, 0.002, 0),
        (0.15, 0.047, 0.044, 0.003, 0),
        (0.21, 0.043, 0.040, 0.002, 0),
        (0.28, 0.038, 0.037, 0, 0),
        (0.34, 0.042, 0.039, -0.002, 0),
        (0.41, 0.037, 0.034, 0, 0),
        (0.48, 0.030, 0.026, 0, 0),
        (0.54, 0.029, 0.022, 0, 0),
    ],
    caps=(0.05, 0.02),
)  # fmt: skip
HAND = Loft(
    WRIST, ARM_DIRECTION, (0, 0, 1),
    [
        (0.000, 0.029, 0.023, 0, 0),
        (0.045, 0.040, 0.023, 0.000, 0),
        (0.090, 0.045, 0.022, 0.000, 0.002),
        (0.135, 0.042, 0.020, -0.002, 0.006),
        (0.165, 0.036, 0.019, -0.004, 0.009),
    ],
    caps=(0.02, 0.032),
)  # fmt: skip
THUMB = Loft(
    WRIST + 0.025 * ARM_DIRECTION + (0, 0, 0.020), 0.70 * ARM_DIRECTION + (0, 0, 0.72), (1, 1, 0),
    [(0, 0.018, 0.020, 0, 0), (0.03, 0.019, 0.019, 0, 0), (0.055, 0.018, 0.018, 0, 0),
     (0.08, 0.016, 0.016, 0, 0)],
    caps=(0.015, 0.018),
)  # fmt: skip


def leg(points: FloatArray) -> FloatArray:
    """The left leg, its sole cut flat by the floor."""
    limb = smooth_union(LEG(points), FOOT(points), 0.05)
    return -smooth_union(-limb, points[:, 1], 0.012)


def arm(points: FloatArray) -> FloatArray:
    """The left arm and hand."""
    palm = smooth_union(HAND(points), THUMB(points), 0.018)
    return smooth_union(ARM(points), palm, 0.03)


def body(points: FloatArray) -> FloatArray:
    """Signed distance (N,) to the mannequin's skin, nearly true close to it; negative inside."""
    mirrored = points * (-1.0, 1.0, 1.0)
    head = smooth_union(HEAD(points), NOSE(points), 0.02)
    trunk = smooth_union(TRUNK(points), head, 0.03)
    for swell in (CHEST, SEAT):
        trunk = smooth_union(trunk, smooth_union(swell(points), swell(mirrored), 0.03), 0.06)
    legs = smooth_union(leg(points), leg(mirrored), 0.02)
    arms = np.minimum(arm(points), arm(mirrored))
    return smooth_union(smooth_union(trunk, legs, 0.09), arms, 0.08)


def build(longest: float) -> tuple[FloatArray, IntArray, FloatArray]:
    """The skin's vertices (V, 3), triangles (T, 3) and normals (V, 3) at rest.

    Args:
        longest: edges in flat places, in metres, about; tight curves have shorter ones.
    """
    low, high = np.array([0.0, -0.03, -0.16]), np.array([0.72, 1.74, 0.22])
    return polygonise(body, low, high, CELL, longest)
