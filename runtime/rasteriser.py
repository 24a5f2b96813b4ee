"""The reference renderer: a z-buffer in NumPy that samples where OpenGL samples.

Vertices are snapped to 1/256 pixel as hardware does (OpenGL 3.3 [1], section 3.6, leaves the grid
open; eight bits is what Direct3D asks for and what drivers use), so coverage is decided by exact
integers, held in float64: two triangles that share an edge never share or lose a pixel.

Each triangle row's first and last covered pixel follow from its three edges in closed form, so the
only candidates ever made are fragments that are drawn or hidden. Colour is interpolated once a
pixel, for the nearest fragment. Work goes in blocks, so memory does not grow with the mesh.

[1] The OpenGL Graphics System: A Specification, version 3.3.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray

__all__ = ["rasterise"]

SUBPIXEL = 256.0
GUARD = 2.0**14  # pixels beyond which triangles are clipped, so that edge products stay exact
BLOCK = 1 << 18  # rows, fragments or pixels at work at a time
FACE_BLOCK = 1 << 15


@dataclass(frozen=True, eq=False)
class Triangles:
    """Screen triangles, oriented so that the inside of every edge is positive.

    Attributes:
        x, y: snapped corners in 1/256 pixel, y down, integers in float64, (T, 3).
        z: window depth of the corners, (T, 3).
        inverse_w: reciprocal of the corners' clip w, (T, 3).
        colour: C channels of the side that is seen, (T, 3, C).
        area: twice the area, positive, (T,).
    """

    x: FloatArray
    y: FloatArray
    z: FloatArray
    inverse_w: FloatArray
    colour: FloatArray
    area: FloatArray


@dataclass(frozen=True, eq=False)
class Target:
    """What is drawn into: flat buffers of ``width · height`` pixels, top row first.

    Of a larger picture it is the rows from ``top`` on.
    """

    width: int
    height: int
    top: int
    depth: FloatArray  # [H·W]
    rgba: FloatArray  # [H·W, C + 1]


def rasterise(
    positions: FloatArray,
    faces: IntArray,
    radiance: FloatArray,
    matrix: FloatArray,
    size: tuple[int, int],
    back_radiance: FloatArray | None = None,
    rows: tuple[int, int] | None = None,
) -> FloatArray:
    """Draw a mesh with a colour at each vertex, both sides, nearest surface in front.

    Args:
        positions: vertices, (V, 3) in world space.
        faces: triangles, (T, 3), counter-clockwise from the front.
        radiance: linear colour of each vertex, (V, 3), or anything else to interpolate, (V, C).
        matrix: world to clip space, (4, 4), as ``Camera.matrix``.
        size: width and height in pixels, each at most ``GUARD``.
        back_radiance: colour (V, C) of the back of each vertex; None for the same as the front.
        rows: the first row to draw and the one after the last, of all H; None for all. What is
            drawn is bit for bit what the whole picture has there.

    Returns:
        (rows, W, C + 1) float32, top row first: colour, 0 where nothing is, and coverage, 0 or 1.
    """
    width, height = size
    top, end = (0, height) if rows is None else rows
    count = width * (end - top)
    channels = radiance.shape[1]
    rgba = np.zeros((count, channels + 1), dtype=np.float32)
    target = Target(width, end - top, top, np.full(count, np.inf), rgba)
    points = np.concatenate([positions, np.ones((len(positions), 1))], axis=1, dtype=np.float64)
    sides = [radiance, radiance if back_radiance is None else back_radiance]
    with np.errstate(invalid="ignore", over="ignore"):  # vertices at infinity are left out below
        projected = points @ matrix.T
    vertices = np.concatenate([projected, *sides], axis=1, dtype=np.float64)  # [V, 4 + 2 C]
    for start in range(0, len(faces), FACE_BLOCK):
        corners = vertices[faces[start : start + FACE_BLOCK]]
        triangles = project(clip(corners, width, height), width, height)
        shade(triangles, nearest(triangles, target), target)
    return rgba.reshape(end - top, width, channels + 1)


def clip(corners: FloatArray, width: int, height: int) -> FloatArray:
    """Cut triangles (T, 3, 4 + K) of clip coordinates and colours to what can be projected.

    The planes are near, far and the four sides of a frustum of ``GUARD`` pixels: what lies between
    the picture and the guard costs nothing, as its pixels are never enumerated.
    """
    corners = corners[np.isfinite(corners[..., :4]).all(axis=(1, 2))]
    planes = np.array([[0, 0, 1, 1], [0, 0, -1, 1]], dtype=np.float64)
    side_x, side_y = 2 * GUARD / width, 2 * GUARD / height
    guard = [[1, 0, 0, side_x], [-1, 0, 0, side_x], [0, 1, 0, side_y], [0, -1, 0, side_y]]
    for plane in [*planes, *np.array(guard, dtype=np.float64)]:
        distance = corners[..., :4] @ plane
        inside = distance >= 0
        number = inside.sum(axis=1)
        if (number == 3).all():
            continue
        # Rolled so that the odd corner out comes first: orientation is kept.
        crossing = (number == 1) | (number == 2)
        tip = number[crossing] == 1
        lone = np.argmax(inside[crossing] == tip[:, None], axis=1)
        order = (lone[:, None] + np.arange(3)) % 3
        rolled = np.take_along_axis(corners[crossing], order[..., None], axis=1)
        d = np.take_along_axis(distance[crossing], order, axis=1)
        (a, b, c), (da, db, dc) = rolled.transpose(1, 0, 2), d.T[..., None]
        ab, ac = cut(a, da, b, db), cut(a, da, c, dc)
        pieces = [np.stack([a, ab, ac], 1)[tip]]
        pieces += [np.stack(piece, 1)[~tip] for piece in [(ab, b, c), (ab, c, ac)]]
        corners = np.concatenate([corners[number == 3], *pieces])
    return corners


def cut(p: FloatArray, dp: FloatArray, q: FloatArray, dq: FloatArray) -> FloatArray:
    """Where the segment p–q meets the plane its ends are at distances ``dp`` and ``dq`` from.

    Always reckoned from the end inside, so that neighbours agree to the last bit.
    """
    inside = dp >= 0
    near, far = np.where(inside, p, q), np.where(inside, q, p)
    d_near, d_far = np.where(inside, dp, dq), np.where(inside, dq, dp)
    return near + d_near / (d_near - d_far) * (far - near)


def project(corners: FloatArray, width: int, height: int) -> Triangles:
    """Window coordinates, snapped; triangles without area are dropped, seen sides chosen."""
    w = corners[..., 3]
    corners, w = corners[(w > 0).all(axis=1)], w[(w > 0).all(axis=1)]
    x = np.rint((corners[..., 0] / w + 1) * (0.5 * width * SUBPIXEL))
    y = np.rint((1 - corners[..., 1] / w) * (0.5 * height * SUBPIXEL))
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    front = (area < 0)[:, None, None]  # y points down: counter-clockwise is negative
    channels = (corners.shape[-1] - 4) // 2
    colour = np.where(front, corners[..., 4 : 4 + channels], corners[..., 4 + channels :])
    z, inverse_w = 0.5 + 0.5 * corners[..., 2] / w, 1.0 / w
    order = np.where(area[:, None] < 0, [0, 2, 1], [0, 1, 2])
    keep = area != 0
    x, y, z, inverse_w = (np.take_along_axis(a, order, axis=1)[keep] for a in (x, y, z, inverse_w))
    colour = np.take_along_axis(colour, order[..., None], axis=1)[keep]
    return Triangles(x, y, z, inverse_w, colour, np.abs(area[keep]))


def edges(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Edge functions A·x + B·y + C, (N, 3) each, of the edges opposite to each corner."""
    px, py = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    qx, qy = np.roll(x, -2, axis=1), np.roll(y, -2, axis=1)
    a, b = py - qy, qx - px
    return a, b, -(a * px + b * py)


def blocks(counts: IntArray) -> Iterator[slice]:
    """Slices of consecutive items whose counts sum to about ``BLOCK``."""
    group = np.cumsum(counts) // BLOCK
    bounds = np.flatnonzero(np.diff(group, prepend=-1, append=-1))
    for start, stop in itertools.pairwise(bounds):
        yield slice(int(start), int(stop))


def ranges(first: IntArray, counts: IntArray) -> tuple[IntArray, IntArray]:
    """All of ``first[i] … first[i] + counts[i] − 1`` one after the other, and each one's i."""
    owner = np.repeat(np.arange(len(counts)), counts)
    start = first - (np.cumsum(counts) - counts)
    return np.arange(len(owner)) + start[owner], owner


def nearest(triangles: Triangles, target: Target) -> IntArray:
    """Depth-test all fragments; the triangle (H·W,) now seen at each pixel, −1 for no change."""
    seen = np.full(target.width * target.height, -1, dtype=np.int32)
    a, b, c = edges(triangles.x, triangles.y)
    half = SUBPIXEL / 2
    share = triangles.z / triangles.area[:, None]
    depth_x, depth_y, depth_0 = (np.sum(k * share, axis=1) for k in (a, b, c))
    depth_0 = depth_0 + half * (depth_x + depth_y)  # at the centre of the first pixel
    # A sample on an edge belongs to the triangle on its right, on a level edge to the one above:
    # OpenGL only asks for one owner, Mesa's framebuffer objects choose this one.
    owns = (a > 0) | ((a == 0) & (b < 0))
    inside = c + half * (a + b) - np.where(owns, 0.0, 1.0)
    top, end = target.top, target.top + target.height
    first = np.ceil((triangles.y.min(axis=1) - half) / SUBPIXEL).clip(top, end)
    last = np.floor((triangles.y.max(axis=1) - half) / SUBPIXEL).clip(top - 1, end - 1)
    rows = np.maximum(last - first + 1, 0).astype(np.int64)
    for block in blocks(rows):
        row, owner = ranges(first[block].astype(np.int64), rows[block])
        owner = owner + block.start
        step = SUBPIXEL * row
        left, width = spans(a[owner], inside[owner] + step[:, None] * b[owner], target.width)
        depth = depth_0[owner] + depth_y[owner] * step
        for part in blocks(width):
            column, line = ranges(left[part], width[part])
            line = line + part.start
            z = depth[line] + depth_x[owner[line]] * (SUBPIXEL * column)
            depth_test((row[line] - top) * target.width + column, z, owner[line], target, seen)
    return seen


def spans(a: FloatArray, c: FloatArray, width: int) -> tuple[IntArray, IntArray]:
    """First column and number of columns j where 256·a·j + c ≥ 0 for all three edges, (N,) each.

    The quotient of two integers below 2⁵³ never rounds past an integer here: their distance from
    one is at least 1/(256·a), and the operands have 47 bits.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = np.floor(c / (SUBPIXEL * np.abs(a)))
    left = np.where(a > 0, -bound, 0.0).max(axis=1).clip(0, width)
    right = np.where(a < 0, bound, width - 1.0).min(axis=1).clip(-1, width - 1)
    right = np.where(((a == 0) & (c < 0)).any(axis=1), -1.0, right)
    return left.astype(np.int64), np.maximum(right - left + 1, 0).astype(np.int64)


def depth_test(
    pixel: IntArray, z: FloatArray, owner: IntArray, target: Target, seen: IntArray
) -> None:
    """Keep the fragments nearer than what is there; of equals the first drawn, as GL_LESS does."""
    nearer = z < target.depth[pixel]
    pixel, z, owner = pixel[nearer], z[nearer], owner[nearer]
    np.minimum.at(target.depth, pixel, z)
    wins = np.flatnonzero(z == target.depth[pixel])[::-1]  # of repeated indices the last is kept
    seen[pixel[wins]] = owner[wins]


def shade(triangles: Triangles, seen: IntArray, target: Target) -> None:
    """Interpolate the colour of every newly seen pixel, correct in perspective."""
    changed = np.flatnonzero(seen >= 0)
    for start in range(0, len(changed), BLOCK):
        pixel = changed[start : start + BLOCK]
        owner = seen[pixel]
        a, b, c = edges(triangles.x[owner], triangles.y[owner])
        row = pixel // target.width + target.top
        x, y = (SUBPIXEL * (k + 0.5) for k in (pixel % target.width, row))
        weight = (a * x[:, None] + b * y[:, None] + c) * triangles.inverse_w[owner]
        weight /= weight.sum(axis=1, keepdims=True)
        target.rgba[pixel, :-1] = np.einsum("nk,nkc->nc", weight, triangles.colour[owner])
        target.rgba[pixel, -1] = 1.0
