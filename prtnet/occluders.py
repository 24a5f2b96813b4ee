"""Spheres fitted to a skinned surface, and the spherical harmonics of the caps they cover.

A sphere of radius r at distance d covers the cap of half-angle θ with sin θ = r/d. The cap's
indicator has the coefficients f_lm = 2π I_l(cos θ) y_lm(u), u the direction to the centre and
I_l(c) = ∫_c^1 P_l(t) dt = (P_{l-1}(c) − P_{l+1}(c)) / (2l + 1), I_0 = 1 − c.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from prtnet.array_library import library
from prtnet.cores import one_thread

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray, IntArray

__all__ = ["Spheres", "cap_integral_rows", "cap_integrals", "fit_spheres"]


@dataclass(frozen=True, eq=False)
class Spheres:
    """Spheres that ride on joints.

    Attributes:
        joint: the joint of each sphere, (S,) int32.
        centre: in that joint's frame, (S, 3) float32.
        radius: in that joint's units, (S,) float32.
    """

    joint: IntArray
    centre: FloatArray
    radius: FloatArray

    def __len__(self) -> int:
        return len(self.joint)


def cap_integrals(cosine: FloatArray, order: int) -> FloatArray:
    """I_l(c) = ∫_c^1 P_l for l < order, (..., order); ``cosine`` (...) is the cap's cos θ."""
    return np.stack(cap_integral_rows(cosine, order), axis=-1)


def cap_integral_rows(cosine: FloatArray, order: int) -> list[FloatArray]:
    """The same, one array for each l; P_l by Bonnet's recursion."""
    legendre = [library(cosine).ones_like(cosine), cosine]
    for degree in range(1, order):
        ahead = (2 * degree + 1) * cosine * legendre[degree] - degree * legendre[degree - 1]
        legendre.append(ahead / (degree + 1))
    integrals = [1.0 - cosine]
    for degree in range(1, order):
        difference = legendre[degree - 1] - legendre[degree + 1]
        integrals.append(difference / (2 * degree + 1))
    return integrals


def fit_spheres(
    positions: FloatArray,
    joint_weights: FloatArray,
    joint_matrices: FloatArray,
    count: int = 128,
    most_per_joint: int = 12,
    seed: int = 0,
) -> Spheres:
    """Spheres inside the skin: k-means of each joint's own vertices, in the joint's frame.

    Each joint gets spheres in proportion to its vertices, at least one where it owns at least
    eight (or any at all, on meshes so small that none does); the radius is 0.9 × the mean distance
    of a sphere's vertices from their centroid.

    Args:
        positions: vertices of the mesh at rest, (V, 3).
        joint_weights: skin weights by joint, (V, J).
        joint_matrices: model-space joint matrices at rest, (J, 3, 4).
        count: about how many spheres in all.
        most_per_joint: cap on the spheres of one joint.
        seed: of k-means.
    """
    from sklearn.cluster import KMeans

    owner = np.argmax(joint_weights, axis=1)
    owned = np.bincount(owner, minlength=joint_weights.shape[1])
    fewest = 8 if owned.max() >= 8 else 1
    joints, centres, radii = [], [], []
    for joint in range(joint_weights.shape[1]):
        own = positions[owner == joint].astype(np.float64)
        if len(own) < fewest:
            continue
        linear, offset = joint_matrices[joint, :, :3], joint_matrices[joint, :, 3]
        local = (own - offset) @ np.linalg.pinv(linear.astype(np.float64)).T
        wanted = int(np.clip(round(count * len(own) / len(positions)), 1, most_per_joint))
        wanted = min(wanted, len(np.unique(local, axis=0)))
        with one_thread():
            label = KMeans(wanted, n_init=4, random_state=seed).fit_predict(local)
        for part in range(wanted):
            members = local[label == part]
            centre = members.mean(axis=0)
            joints.append(joint)
            centres.append(centre)
            radii.append(0.9 * np.linalg.norm(members - centre, axis=1).mean())
    return Spheres(
        np.array(joints, dtype=np.int32),
        np.array(centres, dtype=np.float32).reshape(-1, 3),
        np.array(radii, dtype=np.float32),
    )
