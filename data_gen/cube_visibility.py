"""What the vertices of a surface see of a fine cube map of directions, a bit each.

"All-Frequency" (Liu, Sloan, Shum and Snyder 2004) section 4: a map of 6 × 128 × 128 directions in
the world's frame, four by four to a texel of light. Directions below the horizon of a vertex need
no ray: it sees nothing there.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from data_gen.rays import LIFT, border_operator, departure
from data_gen.visibility import BATCH, Tracer
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.console import Report, silent
from prtnet.cube_map import directions
from prtnet.exchange import Given, Result, exchange
from prtnet.frames import orthonormal_frames
from prtnet.kept import keeps_last
from prtnet.scene import Receivers
from prtnet.transfer import Surface

__all__ = ["CubeVisibility", "cube_visibility"]

PARTS = 16  # of a block that others trace
FINE = 128  # directions a side of a face, in the paper
# Rays set out a little further on: where several sheets meet, a vertex lies in the plane of one,
# and every ray would hit it at once. So little that no other sheet is passed.
AHEAD = np.float32(LIFT / 16)


@dataclass(frozen=True, eq=False)
class CubeVisibility:
    """Which directions of a cube map P vertices see.

    Attributes:
        bits: (P, 6, n, n / 8) uint8, columns from the highest bit on: 1 where a direction is above
            the horizon and nothing hides it.
        size: directions n a side of a face.
    """

    bits: IntArray
    size: int

    def __len__(self) -> int:
        return len(self.bits)

    def seen(self, points: slice | IntArray, face: int) -> BoolArray:
        """Of some vertices, of one face: (B, n, n)."""
        return self.part(points, face, slice(0, self.size), slice(0, self.size))

    def part(self, points: slice | IntArray, face: int, rows: slice, columns: slice) -> BoolArray:
        """Of some vertices, of some rows and columns of a face."""
        first = columns.start // 8
        own = np.asarray(self.bits[points, face, rows, first : -(-columns.stop // 8)], np.uint8)
        every = np.unpackbits(own, axis=-1).view(np.bool_)
        return every[..., columns.start - 8 * first : columns.stop - 8 * first]


def cube_visibility(
    surface: Surface,
    casters: Sequence[Surface],
    size: int = FINE,
    threads: int = 1,
    report: Report = silent,
) -> CubeVisibility:
    """Cast a ray in every direction above the horizon of every vertex.

    Args:
        surface: the vertices; their horizons are those of their normals.
        casters: what hides light: the surface itself as a rule, and what else is there.
        size: directions a side of a face.
        threads: that trace.
        report: of progress.

    Raises:
        ValueError: a side of so many directions is no whole number of bytes.
    """
    if size < 8 or size % 8:
        raise ValueError(f"faces of {size} directions a side are no whole number of bytes")
    positions, faces = joined(casters)
    # Of a vertex without a normal: whichever the transfer takes as well.
    normals = orthonormal_frames(surface.tangents, surface.normals)[..., 2]
    away = normals
    if any(one is surface for one in casters):
        away = departure(normals, inwards(surface))
    given = {"positions": positions, "faces": faces, "points": surface.positions,
             "normals": normals, "away": away}  # fmt: skip
    step = max(1, 2 * BATCH // (6 * size**2))
    count = len(surface)

    def told(done: int) -> None:
        report("rays", min(done * step, count), count)

    place = exchange()
    if place is not None:
        work, blocks = SkyBlock(size, step * PARTS), -(-count // (step * PARTS))
        results = place.ordered(work, given, blocks, lambda done: told(done * PARTS))
        bits = np.concatenate([arrays["bits"] for _, arrays in results])
    else:
        sky = Sky(given, size)
        bits = np.zeros((count, 6 * size * size // 8), dtype=np.uint8)

        def one(part: slice) -> None:
            bits[part] = sky(part)

        parts = [slice(start, start + step) for start in range(0, count, step)]
        # Each product is small, and BLAS's own threads would wait for those that trace.
        with threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(threads) as pool:
            for done, _ in enumerate(pool.map(one, parts), 1):
                told(done)
    return CubeVisibility(bits.reshape(count, 6, size, size // 8), size)


class Sky:
    """Rays from vertices in the directions of a cube map.

    Args:
        given: positions and faces of what hides light; points, normals, and where rays set out to
            (away), of the vertices.
        size: directions a side of a face.
    """

    def __init__(self, given: Mapping[str, Any] | Given, size: int) -> None:
        positions, faces = given["positions"], given["faces"]
        self.tracer = Tracer(positions, faces)
        reach = self.tracer.normalise(positions[np.unique(faces)])
        self.radius2 = 1.001 * float(np.square(reach).sum(axis=1).max())  # a ball around all of it
        self.normals = given["normals"]
        self.starts = self.tracer.origins(given["points"], given["away"])
        self.every = directions(size).reshape(-1, 3)
        self.every32 = self.every.astype(np.float32)

    def __call__(self, part: slice) -> IntArray:
        """Bits of some vertices, (B, 6 · n · n / 8) uint8."""
        starts = self.starts[part]
        seen = self.normals[part] @ self.every.T > 0.0  # [B, D]
        traced = seen
        outside = np.maximum(np.square(starts).sum(axis=1) - self.radius2, 0.0)
        if outside.any():
            # From outside of the ball only rays into it can hit anything: of the ground, few.
            nearest = np.where(outside > 0.0, -np.sqrt(outside), 9.9)[:, None]
            traced = seen & (starts @ self.every32.T <= nearest)
        point, direction = np.nonzero(traced)
        ways = self.every32[direction]
        hit = self.tracer.occluded(starts[point] + AHEAD * ways, ways)
        seen[point[hit], direction[hit]] = False
        return np.packbits(seen, axis=1)


@dataclass(frozen=True)
class SkyBlock:
    """What some vertices see: work that can be handed over.

    Attributes:
        size: directions a side of a face.
        points: vertices of a block.
    """

    size: int
    points: int

    def __call__(self, number: int, given: Given) -> Result:
        """See ``prtnet.exchange.Work``."""
        sky = known_sky(self, given)
        step = max(1, self.points // PARTS)
        first = number * self.points
        last = min(first + self.points, len(sky.normals))
        parts = [slice(start, min(start + step, last)) for start in range(first, last, step)]
        return {}, {"bits": np.concatenate([sky(part) for part in parts])}


@keeps_last
def known_sky(block: SkyBlock, given: Given) -> Sky:
    """What the blocks of one surface share."""
    return Sky(given, block.size)


def joined(casters: Sequence[Surface]) -> tuple[FloatArray, IntArray]:
    """Positions and triangles of several surfaces as one.

    Raises:
        ValueError: there is no triangle.
    """
    starts = np.cumsum([0, *(len(one) for one in casters)])[:-1]
    faces = [one.faces + start for one, start in zip(casters, starts, strict=True)]
    if not any(len(one) for one in faces):
        raise ValueError("nothing casts a shadow: there is no triangle")
    return np.concatenate([one.positions for one in casters]), np.concatenate(faces)


def inwards(surface: Surface) -> FloatArray:
    """Of vertices on a border of their surface the way inwards, (P, 3); zero of others."""
    every = np.arange(len(surface), dtype=np.int32)
    receivers = Receivers(every, np.ones(len(every), dtype=np.int8), every)
    positions = surface.positions.astype(np.float64)
    return np.asarray(border_operator(surface.faces, receivers) @ positions)
