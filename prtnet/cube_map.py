"""Cube maps of distant light: where texels look, what of the sphere they cover, their segments.

Faces are in OpenGL's order, +x −x +y −y +z −z, and turned as OpenGL has them: texel (row t,
column s) of a face looks along out + s · right + t · down, with s and t in [−1, 1] the middle of
its square. Light between the middles of texels is bilinear within a face, and goes on as it is
beyond the last of them: the *hats* of "All-Frequency" (Liu, Sloan, Shum and Snyder 2004) eq. 10,
of which L(ω) = Σ texel · hat.

A *segment* is a quarter of a face: face · 4 + 2 · half of its rows + half of its columns.
"""

from __future__ import annotations

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.environment import Environment, Source
from prtnet.haar import haar

__all__ = [
    "AXES",
    "SIZE",
    "cube_map",
    "decimated",
    "directions",
    "faces_of",
    "hats",
    "interpolated",
    "places",
    "segment_coefficients",
    "segments_of",
    "solid_angles",
]

SIZE = 32  # texels a side, in the paper
BLOCK = 1 << 18  # directions that a light is asked for at a time

# Of every face: right (along s), down (along t) and out; OpenGL 4.6 core, table 8.19.
AXES: FloatArray = np.array(
    [
        [[0, 0, -1], [0, -1, 0], [1, 0, 0]],
        [[0, 0, 1], [0, -1, 0], [-1, 0, 0]],
        [[1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, -1], [0, -1, 0]],
        [[1, 0, 0], [0, -1, 0], [0, 0, 1]],
        [[-1, 0, 0], [0, -1, 0], [0, 0, -1]],
    ],
    dtype=np.float64,
)


def middles(size: int) -> FloatArray:
    """Of texels along a side, s or t of their middles, (n,)."""
    return (2.0 * np.arange(size) + 1.0) / size - 1.0


def directions(size: int) -> FloatArray:
    """Unit directions of the middles of texels, (6, n, n, 3)."""
    line = middles(size)
    right, down, out = (AXES[:, None, None, axis] for axis in range(3))
    found = out + line[:, None] * right + line[:, None, None] * down
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))


def places(directions: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Face, s and t, each (…), of directions (…, 3) of any length but 0."""
    d = np.asarray(directions)
    size = np.abs(d)
    axis = size.argmax(axis=-1)
    out = np.take_along_axis(d, axis[..., None], axis=-1)[..., 0]
    face = 2 * axis + (out < 0)
    s, t = (
        np.einsum("...i,...i->...", d, AXES[face, which].astype(d.dtype)) / np.abs(out)
        for which in range(2)
    )
    return face, s, t


def solid_angles(size: int) -> FloatArray:
    """Of the texels of a face, whichever, (n, n): the six of them are 4π.

    From the corner (s, t) of a face's middle spans arctan(s t / √(s² + t² + 1)).
    """
    edge = 2.0 * np.arange(size + 1) / size - 1.0
    s, t = edge, edge[:, None]
    corner = np.arctan2(s * t, np.sqrt(s * s + t * t + 1.0))
    return np.asarray(np.diff(np.diff(corner, axis=0), axis=1))


def cube_map(light: Source | Environment, size: int = SIZE, samples: int = 4) -> FloatArray:
    """The light as texels, (6, n, n, 3) float32 linear RGB.

    A light so small that it falls between samples is better asked of
    ``prtnet.turning_light.TurningLight``, which misses none.

    Args:
        light: a source, or a turned one.
        size: texels n a side.
        samples: of a texel, a side (section 6: 4).
    """
    where = directions(size * samples).reshape(-1, 3)
    fine = np.empty((len(where), 3), dtype=np.float32)
    for start in range(0, len(where), BLOCK):
        part = slice(start, start + BLOCK)
        fine[part] = light.radiance(where[part])
    return decimated(fine.reshape(6, size * samples, size * samples, 3), samples)


def decimated(texels: FloatArray, times: int) -> FloatArray:
    """A cube map (6, n, n, …) of n / times texels a side: means over the solid angle, float32.

    Raises:
        ValueError: so many texels do not divide a side.
    """
    fine = texels.shape[1]
    if times < 1 or fine % times:
        raise ValueError(f"{fine} texels a side are no multiple of {times}")
    size = fine // times
    share = solid_angles(fine).reshape(size, times, size, times)
    share = share / share.sum(axis=(1, 3), keepdims=True)
    blocks = texels.reshape(6, size, times, size, times, *texels.shape[3:])
    return np.einsum("yaxb,fyaxb...->fyx...", share, blocks).astype(np.float32)


def hats(size: int, samples: int) -> FloatArray:
    """Of the n hats along a side, their values at the middles of n · samples pieces, (n · s, n).

    A hat of a face is the product of one along s and one along t; those of a line are 1 together.
    """
    place = np.clip((middles(size * samples) + 1.0) * (size / 2.0) - 0.5, 0.0, size - 1.0)
    return np.asarray(np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(size))))


def interpolated(texels: FloatArray, directions: FloatArray) -> FloatArray:
    """Σ texel · hat at directions (N, 3): of a cube map (6, n, n, …), (N, …).

    Raises:
        ValueError: a direction is zero or not finite.
    """
    size = texels.shape[1]
    given = np.asarray(directions)
    if not (np.isfinite(given).all() and np.abs(given).max(axis=-1, initial=0.0).all()):
        raise ValueError("a cube map has no light from no direction")
    face, *sides = places(given)
    found = np.zeros((len(face), *texels.shape[3:]))
    low, share = [], []
    for side in sides:
        place = np.clip((side + 1.0) * (size / 2.0) - 0.5, 0.0, size - 1.0)
        low.append(np.minimum(place.astype(np.int64), max(size - 2, 0)))
        share.append(place - low[-1])
    more = (-1, *(1,) * (texels.ndim - 3))
    for row in range(min(size, 2)):
        for column in range(min(size, 2)):
            weight = np.ones(len(face))
            for one, up in zip(share, (column, row), strict=True):
                weight = weight * (one if up else 1.0 - one)
            found += weight.reshape(more) * texels[face, low[1] + row, low[0] + column]
    return found


def segments_of(texels: FloatArray) -> FloatArray:
    """The 24 segments (24, n/2, n/2, …) of a cube map (6, n, n, …).

    Raises:
        ValueError: n is odd.
    """
    half, odd = divmod(texels.shape[1], 2)
    if odd:
        raise ValueError(f"faces of {texels.shape[1]} texels a side have no quarters")
    quarters = texels.reshape(6, 2, half, 2, half, *texels.shape[3:]).swapaxes(2, 3)
    return np.ascontiguousarray(quarters.reshape(24, half, half, *texels.shape[3:]))


def faces_of(segments: FloatArray) -> FloatArray:
    """The cube map (6, n, n, …) of its segments (24, n/2, n/2, …)."""
    half, more = segments.shape[1], segments.shape[3:]
    quarters = segments.reshape(6, 2, 2, half, half, *more).swapaxes(2, 3)
    return np.ascontiguousarray(quarters.reshape(6, 2 * half, 2 * half, *more))


def segment_coefficients(texels: FloatArray) -> FloatArray:
    """Haar coefficients of light (6, n, n, C), segment by segment: (24, (n/2)², C).

    Columns of transfer are in the same order. Haar wavelets are orthonormal, so the product of
    transfer in wavelets with these is that of transfer with the texels.

    Raises:
        ValueError: n / 2 is no power of two.
    """
    found = haar(np.moveaxis(segments_of(texels), -1, 1))  # [24, C, h, h]
    return np.ascontiguousarray(found.reshape(*found.shape[:2], -1).swapaxes(1, 2))
