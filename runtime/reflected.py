"""Any material: visibility in local frames, lobes of light, an operator, to radiance of vertices.

Radiance = Σ_b (w^b · y(view)) (light · M^b visibility), "Arbitrary BRDFs" eq. 11, in the vertex's
local frame, where zonal lobes of light turn for free: y(frameᵀ axis). In NumPy; the reference of
what the vertex shader does (:mod:`runtime.material_shader`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.reflection import ReflectionOperator, local_view
from prtnet.sh import bands, evaluate
from prtnet.zh import Lobes

__all__ = ["Side", "Subject", "local_light", "outgoing_radiance"]

BLOCK = 1 << 12  # vertices at a time


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a surface.

    Attributes:
        visibility: in local frames, (V, n²).
        frames: orthonormal, columns (tangent, bitangent, normal), (V, 3, 3).
    """

    visibility: FloatArray
    frames: FloatArray


@dataclass(frozen=True, eq=False)
class Subject:
    """A mesh to be shaded, in world space.

    Attributes:
        positions: vertices, (V, 3) metres.
        faces: triangles, (T, 3), counter-clockwise from the front.
        front: of every vertex.
        back: likewise; None for the same as the front.
    """

    positions: FloatArray
    faces: IntArray
    front: Side
    back: Side | None = None

    @property
    def sides(self) -> tuple[Side, ...]:
        """The front, and the back if it is another."""
        return (self.front,) if self.back is None else (self.front, self.back)


def local_light(lobes: Lobes, frames: FloatArray) -> FloatArray:
    """Lobes of three colours, turned into frames (V, 3, 3), as harmonics (V, n², 3)."""
    axes = np.einsum("vji,cnj->vcni", frames.astype(np.float64), lobes.axes)
    order = lobes.coefficients.shape[-1]
    spread = lobes.coefficients[..., bands(order)]  # [3, N, n²]
    return np.einsum("vcni,cni->vic", evaluate(axes, order), spread)


def outgoing_radiance(
    positions: FloatArray,
    side: Side,
    eye: FloatArray,
    lobes: Lobes,
    operator: ReflectionOperator,
) -> FloatArray:
    """What an eye sees of every vertex.

    Args:
        positions: of the vertices, (V, 3) world space.
        side: that is seen.
        eye: where from, (3,).
        lobes: light of three colours, world frame: axes (3, N, 3), coefficients (3, N, n).
        operator: the material, of the same order n as visibility.

    Returns:
        (V, 3) float32 linear RGB. Order-limited signals ring: it may be a little below zero.
    """
    result = np.empty((len(positions), 3), dtype=np.float32)
    for start in range(0, len(positions), BLOCK):
        part = slice(start, start + BLOCK)
        frames = side.frames[part]
        light = local_light(lobes, frames)
        view = local_view(positions[part], eye, frames)
        visibility = side.visibility[part].astype(np.float64)
        result[part] = operator.radiance(light, visibility, view)
    return result
