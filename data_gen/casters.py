"""What rays from the points of a surface hit: other points of it, or nothing.

A *caster* knows points (positions, normals, frames, areas) and answers rays with three points a hit
and their barycentric weights. The back of a triangle sends no light: its weights are zero.

A patch that tiles is endless. Rays are cast against a block of a few tiles; one that leaves its
side before it is above everything comes in again where it would be in the tile of the middle,
until it hits or has risen. A patch that ends goes on outwards as its border is: in the block for a
while, and beyond it a ray that falls hits the border's texel next to where it left.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from data_gen.rays import border_operator, departure
from data_gen.surface_points import vertex_areas, vertex_normals
from data_gen.visibility import Tracer
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.exchange import Given
from prtnet.frames import orthonormal_frames
from prtnet.scene import Receivers
from prtnet.transfer import wrapped

__all__ = ["Caster", "Hits", "MeshCaster", "PatchCaster", "caster_of"]

HOPS = 64  # of a ray over tiles; what then still rises is free
OVERLAP = 1e-3  # of the block's half size: rays come in a little before where they left
DEEPEST = 16.0  # sizes of a patch: deeper is as dark
FARTHEST = 1e7  # sizes of a patch from 0, where float64 still tells texels apart
MOST_CELLS = 1 << 23  # of a block


@dataclass(frozen=True, eq=False)
class Hits:
    """Rays that hit something.

    Attributes:
        ray: which, (N,), ascending.
        corners: three points each, (N, 3).
        weights: of those, (N, 3) float32; their sum is 1, or 0 where no light comes from.
    """

    ray: IntArray
    corners: IntArray
    weights: FloatArray


class Caster(ABC):
    """Points of a surface, and rays from them.

    Attributes:
        positions: (K, 3) float64.
        frames: columns tangent, bitangent, normal, (K, 3, 3) float64.
        areas: of the surface that each stands for, (K,) float64.
        tracer: the triangles.
        starts: where rays leave, in the tracer's coordinates, (K, 3) float32.
    """

    positions: FloatArray
    frames: FloatArray
    areas: FloatArray
    tracer: Tracer
    starts: FloatArray

    def __len__(self) -> int:
        return len(self.positions)

    @abstractmethod
    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """All that it is made of, for :func:`caster_of`."""

    def turn_to(self, normals: FloatArray) -> None:
        """Give the points normals (K, 3) that are known better than from triangles."""
        self.frames = orthonormal_frames(self.frames[..., 0], normals)

    @abstractmethod
    def cast(self, points: slice, directions: FloatArray) -> Hits:
        """What rays hit that leave these points in directions (B, R, 3) float32 of the surface.

        Rays are counted b · R + r.
        """

    def traced(self, origins: FloatArray, directions: FloatArray) -> dict[str, FloatArray]:
        """Embree's answer for rays (N, 3) float32 in the tracer's coordinates."""
        found: dict[str, FloatArray] = self.tracer.scene.run(
            origins, directions, query="INTERSECT", output=1
        )
        return found


def hits_of(
    found: dict[str, FloatArray], directions: FloatArray, faces: IntArray, ray: IntArray
) -> Hits:
    """The hits among Embree's answers; ``ray`` (N,) names the rays."""
    hit = np.flatnonzero(found["primID"] >= 0)
    u, v = found["u"][hit], found["v"][hit]
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    back = np.einsum("ni,ni->n", found["Ng"][hit], directions[hit]) >= 0
    weights[back] = 0.0
    return Hits(ray[hit], faces[found["primID"][hit]], weights)


class MeshCaster(Caster):
    """The vertices of a mesh.

    Args:
        positions: (V, 3).
        faces: triangles (T, 3) int32 that have an area.
        normals: unit, (V, 3).
        tangents: (V, 3).
    """

    def __init__(
        self, positions: FloatArray, faces: IntArray, normals: FloatArray, tangents: FloatArray
    ) -> None:
        self.positions = np.asarray(positions, dtype=np.float64)
        self.faces = faces
        self.given = {"positions": positions, "normals": normals, "tangents": tangents}
        self.frames = orthonormal_frames(tangents, normals)
        self.areas = vertex_areas(positions, faces)
        self.tracer = Tracer(self.positions, faces)
        every = np.arange(len(positions), dtype=np.int32)
        receivers = Receivers(every, np.ones(len(every), dtype=np.int8), every)
        normals = self.frames[..., 2]
        away = departure(normals, border_operator(faces, receivers) @ self.positions)
        self.starts = self.tracer.origins(self.positions, away)

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Caster`."""
        return {**self.given, "faces": self.faces, "frames": self.frames}

    def cast(self, points: slice, directions: FloatArray) -> Hits:
        """See :class:`Caster`."""
        flat = directions.reshape(-1, 3)
        origins = np.repeat(self.starts[points], directions.shape[1], axis=0)
        return hits_of(self.traced(origins, flat), flat, self.faces, np.arange(len(flat)))


class PatchCaster(Caster):
    """The texels of a height field, row after row, at ((c + ½)·dx, (r + ½)·dy, height).

    Args:
        heights: (H, W) metres; −∞, or far down, is a pit without a floor to be seen.
        size: metres along x and y.
        tiles: whether it repeats along x, along y; if not, its border goes on outwards.

    Raises:
        ValueError: a height is NaN or +∞, there is no texel, or too many for rays.
    """

    def __init__(
        self,
        heights: FloatArray,
        size: tuple[float, float],
        tiles: tuple[bool, bool] = (True, True),
    ) -> None:
        self.heights = floored(heights, max(size))
        self.size, self.tiles = np.asarray(size, dtype=np.float64), tiles
        rows, columns = self.heights.shape
        self.step = self.size / (columns, rows)
        relief = float(np.ptp(self.heights))
        margins = [self.margin(axis, relief) for axis in range(2)]
        if (columns + 2 * margins[0]) * (rows + 2 * margins[1]) > MOST_CELLS:
            raise ValueError("so many texels, or sides this unlike, are too much to trace")
        x, y = (np.arange(-m, count + m) for m, count in zip(margins, (columns, rows), strict=True))
        self.texel = wrapped(y, rows, tiles[1])[:, None] * columns + wrapped(x, columns, tiles[0])
        self.texel = self.texel.astype(np.int32)
        grid = np.stack(
            [
                *np.broadcast_arrays((x + 0.5) * self.step[0], ((y + 0.5) * self.step[1])[:, None]),
                self.heights.ravel()[self.texel],
            ],
            axis=-1,
        )
        middle = (slice(margins[1], margins[1] + rows), slice(margins[0], margins[0] + columns))
        self.faces = grid_faces(*self.texel.shape)
        block = grid.reshape(-1, 3)
        self.corners = self.texel.ravel()[self.faces]
        self.tracer = Tracer(block, self.faces)
        self.positions = grid[middle].reshape(-1, 3)
        normals = vertex_normals(block, self.faces).reshape(grid.shape)[middle].reshape(-1, 3)
        self.areas = vertex_areas(block, self.faces).reshape(grid.shape[:2])[middle].ravel()
        self.frames = orthonormal_frames(np.tile([1.0, 0.0, 0.0], (len(normals), 1)), normals)
        self.starts = self.tracer.origins(self.positions, normals)
        corners = np.stack([block.min(axis=0), block.max(axis=0)])
        self.low, self.high = self.tracer.normalise(corners)[:, :2]
        self.top = self.tracer.normalise(corners)[1, 2]

    def arrays(self) -> dict[str, FloatArray | IntArray]:
        """See :class:`Caster`."""
        tiles = np.array(self.tiles, dtype=np.uint8)
        return {"heights": self.heights, "size": self.size, "tiles": tiles, "frames": self.frames}

    def margin(self, axis: int, relief: float) -> int:
        """Cells that the block has on either side of the patch along an axis."""
        longest = float(self.size.max())
        if self.tiles[axis]:
            return max(2, int(np.ceil(0.5 * longest / self.step[axis])))
        return max(2, int(np.ceil((longest + min(4.0 * relief, longest)) / self.step[axis])))

    def cast(self, points: slice, directions: FloatArray) -> Hits:
        """See :class:`Caster`."""
        flat = directions.reshape(-1, 3)
        origins = np.repeat(self.starts[points], directions.shape[1], axis=0)
        # Rays that have not risen above all: a flat patch needs no tracing.
        low: IntArray = np.flatnonzero((origins[:, 2] <= self.top) | (flat[:, 2] < 0))
        parts: list[Hits] = []
        for _ in range(HOPS):
            if len(low) == 0:
                break
            at, way = origins[low], flat[low]
            found = self.traced(at, way)
            parts.append(hits_of(found, way, self.corners, low))
            missed = found["primID"] < 0
            low, at, fallen = self.moved(low[missed], at[missed], way[missed])
            origins[low] = at
            parts.append(fallen)
        parts.append(dark(low[flat[low, 2] <= 0]))
        order = np.argsort(np.concatenate([part.ray for part in parts]), kind="stable")
        return Hits(
            *(
                np.concatenate([getattr(part, name) for part in parts])[order]
                for name in ("ray", "corners", "weights")
            )
        )

    def moved(
        self, ray: IntArray, at: FloatArray, way: FloatArray
    ) -> tuple[IntArray, FloatArray, Hits]:
        """Rays that left the block: those that come in again and where, and those that fell.

        What rises for good is in neither.
        """
        place, direction = at.astype(np.float64), way.astype(np.float64)
        ahead = np.where(direction[:, :2] > 0, self.high, self.low) - place[:, :2]
        flat = np.abs(direction[:, :2]) < 1e-12
        steps = np.where(flat, np.inf, ahead / np.where(flat, 1.0, direction[:, :2]))
        axis = steps.argmin(axis=1)
        length = np.take_along_axis(steps, axis[:, None], axis=1)[:, 0]
        vertical = ~np.isfinite(length)
        length = np.where(vertical, 0.0, np.maximum(length - OVERLAP, 0.0))
        out = place + length[:, None] * direction
        risen = (direction[:, 2] > 0) & (vertical | (out[:, 2] > self.top))
        again = np.asarray(self.tiles)[axis] & ~vertical
        fell = ~risen & ~again & (direction[:, 2] <= 0)
        fallen = Hits(ray[fell], self.beside(out[fell]), lone(int(fell.sum())))
        period = self.size / self.tracer.scale
        first = (0.0 - self.tracer.centre[:2]) / self.tracer.scale  # of the middle tile
        for one in range(2):
            if self.tiles[one]:
                out[:, one] = first[one] + np.mod(out[:, one] - first[one], period[one])
        goes = ~risen & again
        return ray[goes], out[goes].astype(np.float32), fallen

    def beside(self, places: FloatArray) -> IntArray:
        """The texels of the border, thrice each (N, 3), that go on to places of the tracer."""
        metres = places[:, :2] * self.tracer.scale + self.tracer.centre[:2]
        column, row = np.floor(metres / self.step).astype(np.int64).T
        rows, columns = self.heights.shape
        texel = wrapped(row, rows, self.tiles[1]) * columns + wrapped(
            column, columns, self.tiles[0]
        )
        return np.repeat(texel[:, None], 3, axis=1)


def caster_of(kind: str, given: Given) -> Caster:
    """A caster of this class again, of its arrays."""
    caster: Caster
    if kind == MeshCaster.__name__:
        names = ("positions", "faces", "normals", "tangents")
        caster = MeshCaster(*(given[name] for name in names))
    else:
        across, along = given["tiles"].astype(bool).tolist()
        caster = PatchCaster(given["heights"], given["size"], (across, along))
    caster.frames = given["frames"]
    return caster


def lone(count: int) -> FloatArray:
    """Weights (N, 3) of the first corner alone."""
    return np.tile(np.array([1, 0, 0], dtype=np.float32), (count, 1))


def dark(ray: IntArray) -> Hits:
    """Hits that send no light."""
    corners = np.zeros((len(ray), 3), dtype=np.int32)
    return Hits(ray, corners, np.zeros((len(ray), 3), dtype=np.float32))


def floored(heights: FloatArray, size: float) -> FloatArray:
    """Heights (H, W) float64 with a floor so deep that nothing of it is seen.

    Raises:
        ValueError: there are none, or one is NaN or +∞, or all are −∞, or they are far from 0.
    """
    found = np.array(heights, dtype=np.float64)
    if found.ndim != 2 or found.size == 0:
        raise ValueError("a relief has rows and columns of heights")
    if not (found < np.inf).all():
        raise ValueError("a height is not a number, or infinite upwards")
    if not np.isfinite(found).any():
        raise ValueError("a relief needs one height that is finite")
    top = float(found.max())
    floor: BoolArray = found < top - DEEPEST * size
    found[floor] = top - DEEPEST * size
    if max(-float(found.min()), top) > FARTHEST * size:
        raise ValueError("heights lie too far from 0 for the width of the patch")
    return found


def grid_faces(rows: int, columns: int) -> IntArray:
    """Two triangles (…, 3) int32 for every square of a grid, facing +z."""
    corner = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b = corner[:-1, :-1].ravel(), corner[:-1, 1:].ravel()
    c, d = corner[1:, 1:].ravel(), corner[1:, :-1].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
