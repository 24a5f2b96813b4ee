"""1D BRDFs: lobes of light and visibility turned into the reflection frame, live exponents [1].

Every term is an integral against a lobe that is symmetric about one axis a in the local frame,

    R(α, a) = (α + 1)/2π ∫_{s·a>0} L(s) V(s) (s·a)^α ds

the specular one about the mirrored view with any exponent, the diffuse one about the normal with
exponent 1, and light through a thin membrane about the normal of its other side, likewise [2,
eq. 22]. Only the hemisphere around the axis counts. In a frame whose +z is the axis it is the
operator of :mod:`prtnet.phong`; light and visibility, as zonal lobes, get there by turning axes.

The lobe holds the cosine of the rendering equation, so it reflects what comes from a hemisphere
that reaches below the horizon where the view is oblique; V is 1 there (docs/conventions.md).
``above_horizon`` makes it 0 by one lobe more.

In NumPy; the reference of :mod:`runtime.one_dimensional_shader`.

Papers:
    [1] Nowrouzezahrai, Kalogerakis, Simari and Fiume, "Shadowed Relighting of Dynamic Geometry with
        1D BRDFs", 2008, section 4.
    [2] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.axis_frames import frame_about
from prtnet.brdf import mirrored
from prtnet.one_dimensional import OneDimensional
from prtnet.phong import phong_transfer, phong_zonal
from prtnet.reflection import local_view
from prtnet.sh import lower_hemisphere
from prtnet.zh import Lobes

__all__ = [
    "LobeSide",
    "LobeSubject",
    "above_horizon",
    "lobe_radiance",
    "one_dimensional_radiance",
    "side_radiance",
    "unshadowed_radiance",
]

BLOCK = 1 << 12  # vertices at a time


@dataclass(frozen=True, eq=False)
class LobeSide:
    """One side of a surface whose visibility is a sum of lobes.

    Attributes:
        visibility: c lobes of each vertex in its local frame: axes (V, c, 3), coefficients
            (V, c, n).
        frames: orthonormal, columns (tangent, bitangent, normal), (V, 3, 3).
    """

    visibility: Lobes
    frames: FloatArray


@dataclass(frozen=True, eq=False)
class LobeSubject:
    """A mesh to be shaded, in world space.

    Attributes:
        positions: vertices, (V, 3) metres.
        faces: triangles, (T, 3), counter-clockwise from the front.
        front: of every vertex.
        back: likewise; None for the same as the front, and then it shadows nothing.
    """

    positions: FloatArray
    faces: IntArray
    front: LobeSide
    back: LobeSide | None = None

    @property
    def sides(self) -> tuple[LobeSide, ...]:
        """The front, and the back if it is another."""
        return (self.front,) if self.back is None else (self.front, self.back)


def above_horizon(visibility: Lobes) -> Lobes:
    """Visibility that is 0 below the horizon of the local frame instead of 1: a lobe about +z more.

    Exact, as far as n bands go.

    Args:
        visibility: axes (..., c, 3), coefficients (..., c, n).

    Returns:
        c + 1 lobes, in the dtypes of ``visibility``.
    """
    axes, coefficients = visibility.axes, visibility.coefficients
    band = np.arange(coefficients.shape[-1])
    up = np.broadcast_to([0.0, 0.0, 1.0], (*axes.shape[:-2], 1, 3)).astype(axes.dtype)
    zonal = lower_hemisphere(len(band))[band * (band + 1)]
    lobe = -zonal / np.sqrt((2 * band + 1) / (4.0 * math.pi))  # over y_l0 at +z
    shape = (*coefficients.shape[:-2], 1, len(band))
    more = np.broadcast_to(lobe, shape).astype(coefficients.dtype)
    return Lobes(np.concatenate([axes, up], -2), np.concatenate([coefficients, more], -2))


def lobe_radiance(
    visibility: Lobes, light: Lobes, axis: FloatArray, exponent: FloatArray | float
) -> FloatArray:
    """R(α, a), exactly for light and visibility of n bands.

    Args:
        visibility: axes (V, c, 3), coefficients (V, c, n).
        light: of three colours in the same frame as visibility: axes (V, 3, N, 3), coefficients
            (3, N, n).
        axis: of the Phong lobe in that frame, unit, (V, 3).
        exponent: α, one or (V,).

    Returns:
        (V, 3).

    Raises:
        PrtnetError: an exponent is negative or not finite.
    """
    frame = frame_about(axis)  # v @ frame is frameᵀ v
    seen = Lobes(visibility.axes @ frame, visibility.coefficients).harmonics()
    shed = Lobes(light.axes @ frame[:, None], light.coefficients).harmonics()
    return np.einsum("vci,vi->vc", shed, phong_transfer(np.asarray(exponent), seen))


def unshadowed_radiance(light: Lobes, axis: FloatArray, exponent: float) -> FloatArray:
    """R(α, a) with V = 1 everywhere: Σ g_l k_l (2l + 1)/4π P_l(a · light's axis).

    Args:
        light: axes (V, 3, N, 3), coefficients (3, N, n).
        axis: unit, (V, 3).
        exponent: α.

    Returns:
        (V, 3).
    """
    cosine = np.einsum("vcnj,vj->vcn", light.axes, axis)
    band = np.arange(light.coefficients.shape[-1])
    weights = phong_zonal(exponent, len(band)) * (2 * band + 1) / (4.0 * math.pi)
    legendre = np.polynomial.legendre.legvander(np.clip(cosine, -1.0, 1.0), len(band) - 1)
    return np.einsum("vcnl,cnl->vc", legendre, light.coefficients * weights)


def one_dimensional_radiance(
    positions: FloatArray,
    side: LobeSide,
    eye: FloatArray,
    light: Lobes,
    material: OneDimensional,
    behind: LobeSide | None = None,
) -> FloatArray:
    """What an eye sees of every vertex.

    Args:
        positions: of the vertices, (V, 3) world space.
        side: that is seen.
        eye: where from, (3,).
        light: of three colours, world frame: axes (3, N, 3), coefficients (3, N, n), of the order
            of visibility. Harmonics (n², 3) become such without loss by
            ``prtnet.zh.exact_lobes`` of their transpose.
        material: what it is made of.
        behind: the other side, whose visibility shadows what is transmitted; as in [1] nothing
            does when None.

    Returns:
        (V, 3) float32 linear RGB. Order-limited signals ring: it may be a little below zero.

    Raises:
        ValueError: light and visibility have different orders.
    """
    orders = {lobes.coefficients.shape[-1] for lobes in (light, side.visibility)}
    if len(orders) > 1:
        raise ValueError(f"light and visibility are of different orders: {sorted(orders)}")
    result = np.empty((len(positions), 3), dtype=np.float32)
    for start in range(0, len(positions), BLOCK):
        part = slice(start, start + BLOCK)
        seen, own = part_of(side, part, light)
        view = local_view(positions[part], eye, side.frames[part])
        up = np.broadcast_to([0.0, 0.0, 1.0], view.shape)
        total = material.specular * lobe_radiance(seen, own, mirrored(view), material.exponent)
        total = total + material.diffuse * lobe_radiance(seen, own, up, 1.0)
        if behind is None:
            through = unshadowed_radiance(own, -up, 1.0)
        else:
            through = lobe_radiance(*part_of(behind, part, light), up, 1.0)
        result[part] = total + material.transmitted * through
    return result


def side_radiance(
    subject: LobeSubject, eye: FloatArray, light: Lobes, material: OneDimensional
) -> list[FloatArray]:
    """What an eye sees of every side, (V, 3) each; either shadows what the other lets through."""
    others = (None,) if subject.back is None else (subject.back, subject.front)
    return [
        one_dimensional_radiance(subject.positions, side, eye, light, material, other)
        for side, other in zip(subject.sides, others, strict=True)
    ]


def part_of(side: LobeSide, part: slice, light: Lobes) -> tuple[Lobes, Lobes]:
    """Visibility of some vertices, and light (3, N) turned into their local frames (V, 3, N)."""
    frames = side.frames[part].astype(np.float64)
    visibility = side.visibility
    axes = np.einsum("vji,cnj->vcni", frames, light.axes)
    seen = Lobes(visibility.axes[part], visibility.coefficients[part].astype(np.float64))
    return seen, Lobes(axes, light.coefficients)
