"""Transfer of all frequencies of the vertices of a surface, a segment of light after another.

"All-Frequency" (Liu, Sloan, Shum and Snyder 2004) eq. 10: a row of a vertex and a texel of light
is ∫ hat(s) V(s) F(s) ds, of the texel's bilinear hat, what the vertex sees of 4 × 4 directions a
texel, and a light factor F of the BRDF in the vertex's frame. Hats, bits and solid angles are
taken at every one of these directions; F, whose table is coarser than a texel, once for two by two
of them, a *cell*. The sixteen ways to see a cell are tabulated, and the rest is two sparse
products.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from data_gen.cube_visibility import CubeVisibility
from prtnet.all_frequency import SEGMENTS
from prtnet.all_frequency_factors import RowFactors
from prtnet.arrays import FloatArray, IntArray
from prtnet.console import Report, silent
from prtnet.cube_map import directions, hats, solid_angles
from prtnet.frames import orthonormal_frames
from prtnet.octahedral import grid_of, looked_up
from prtnet.transfer import Surface

__all__ = ["SAMPLES", "SegmentMaker", "ground", "transfer_segments"]

SAMPLES = 4  # directions of a texel, a side
AROUND = 4  # cells a side that a hat reaches: two of its own texel, one on either side
BLOCK = 32  # vertices at a time: their numbers stay in the cache
TABLE = 128  # cells a side of the octahedral table of light factors
VERTICES = 192  # of the ground, a side, in the paper
WIDE = 4.0  # the ground, in longest sides of the object


def transfer_segments(
    surface: Surface,
    visibility: CubeVisibility,
    light: RowFactors,
    threads: int = 1,
    report: Report = silent,
) -> Iterator[FloatArray]:
    """The raw transfer of the 24 segments in order, each (P, m, (n/2)²) float32.

    Columns are the texels of a segment (``prtnet.cube_map.segments_of``), row after row; n is a
    quarter of the directions that were traced. Made when asked for: only one is held.

    Args:
        surface: P vertices.
        visibility: what they see.
        light: F, in their frames.
        threads: that compute.
        report: of progress.

    Raises:
        ValueError: visibility is of other vertices, or its faces have no quarters.
    """
    maker = SegmentMaker(surface, visibility, light)
    with ThreadPoolExecutor(threads) as pool:
        for segment in range(SEGMENTS):
            found = maker(segment, pool)
            report("segments", segment + 1, SEGMENTS)
            yield found
            del found  # before the next is made


class SegmentMaker:
    """Makes the raw transfer of any segment; arguments as of :func:`transfer_segments`."""

    def __init__(self, surface: Surface, visibility: CubeVisibility, light: RowFactors) -> None:
        size, rest = divmod(visibility.size, SAMPLES)
        if len(visibility) != len(surface):
            raise ValueError(f"visibility of {len(visibility)} vertices, not {len(surface)}")
        if rest or size % 2:
            raise ValueError(f"faces of {visibility.size} directions a side have no quarters")
        frames = orthonormal_frames(surface.tangents, surface.normals)
        self.frames, self.visibility = frames.astype(np.float32), visibility
        self.table = None if light.light is None else factor_table(light)
        self.rows = light.rows
        self.quarters = [
            Quarter.of(size, 2 * row + column) for row in range(2) for column in range(2)
        ]

    def __call__(self, segment: int, pool: Executor) -> FloatArray:
        """Segment 0 to 23, (P, m, (n/2)²) float32, blocks of vertices in the pool."""
        quarter, face = self.quarters[segment % 4], segment // 4
        found = np.zeros((len(self.frames), self.rows, quarter.texels), dtype=np.float32)

        def one(part: slice) -> None:
            ways = quarter.ways(self.visibility, part, face)
            reached = np.flatnonzero(ways.any(axis=1))
            if len(reached):
                own = self.frames[part][reached]
                values = light_values(own, quarter.towards[face], self.table)
                found[part][reached] = quarter.summed(ways[reached], values)

        for _ in pool.map(
            one, (slice(start, start + BLOCK) for start in range(0, len(found), BLOCK))
        ):
            pass
        return found


def factor_table(light: RowFactors) -> FloatArray:
    """F at the corners of an octahedral table, (K, m) float32; below the horizon its mirror image.

    So what is looked up just above the horizon is not mixed with the darkness below.
    """
    places = grid_of(TABLE).places.copy()
    places[:, 2] = np.maximum(np.abs(places[:, 2]), 1e-9)
    return light.at(places)[grid_of(TABLE).vertex]


def light_values(frames: FloatArray, towards: FloatArray, table: FloatArray | None) -> FloatArray:
    """F of B vertices at directions (3, C) of the world, (B · C, m) float32.

    Args:
        frames: (B, 3, 3) float32, columns tangent, bitangent, normal.
        towards: unit directions.
        table: from :func:`factor_table`; None where F is the cosine.
    """
    if table is None:
        return np.maximum(frames[..., 2] @ towards, 0.0).reshape(-1, 1)
    local = np.stack([(frames[..., axis] @ towards).ravel() for axis in range(3)])
    corners, weights = looked_up(local, TABLE)
    return rows_of(weights.T, corners.T, len(table)) @ table


def rows_of(values: FloatArray, columns: IntArray, count: int) -> scipy.sparse.csr_array:
    """The sparse matrix (R, count) of R rows with as many values (R, k) each, at columns (R, k)."""
    each = np.arange(len(values) + 1, dtype=np.int32) * np.int32(values.shape[1])
    flat = np.ascontiguousarray(values).ravel(), np.ascontiguousarray(columns).ravel()
    return scipy.sparse.csr_array((*flat, each), shape=(len(values), count))


@dataclass(frozen=True, eq=False)
class Quarter:
    """What segments at the same quarter of their faces have in common.

    The cells of a quarter are those that its hats reach: 2h + 1 a side, one beyond the middle of
    the face.

    Attributes:
        rows: of directions of the face that the cells hold.
        columns: likewise.
        towards: unit directions of the cells' middles, of all faces, (6, 3, C) float32.
        cells: that each hat reaches, (h² · 16,) int32; any where one would lie beyond the face.
        weights: Σ hat · solid angle of the directions seen, by hat and cell and the way the cell is
            seen, (h² · 16 · 16,) float32.
    """

    rows: slice
    columns: slice
    towards: FloatArray
    cells: IntArray
    weights: FloatArray

    @property
    def texels(self) -> int:
        """Texels h² of a segment."""
        return len(self.cells) // AROUND**2

    @classmethod
    def of(cls, size: int, quarter: int) -> Quarter:
        """Of faces of n texels a side: 2 · half of the rows + half of the columns."""
        (rows, down, y), (columns, across, x) = (reach(size, half) for half in divmod(quarter, 2))
        every = directions(2 * size)[:, rows, columns].reshape(6, -1, 3)
        bit = (np.arange(16)[:, None] >> np.arange(4)) & 1  # of a way: which of a cell are seen
        fine = solid_angles(SAMPLES * size).reshape(2 * size, 2, 2 * size, 2)
        own = fine[rows, :, columns][y][:, :, :, x]  # [h, 4, 2, h, 4, 2]
        sums = np.einsum(
            "jas,lbt,jaslbt,wst->jlabw", down, across, own, bit.reshape(16, 2, 2), optimize=True
        )
        width = columns.stop - columns.start
        cells = y[:, None, :, None] * width + x[None, :, None, :]
        return cls(
            slice(2 * rows.start, 2 * rows.stop),
            slice(2 * columns.start, 2 * columns.stop),
            np.ascontiguousarray(every.swapaxes(1, 2), dtype=np.float32),
            cells.ravel().astype(np.int32),
            sums.ravel().astype(np.float32),
        )

    def ways(self, visibility: CubeVisibility, part: slice, face: int) -> IntArray:
        """How B vertices see the cells, (B, C) uint8: a bit for each of its four directions."""
        seen = visibility.part(part, face, self.rows, self.columns).view(np.uint8)
        found = seen[:, 0::2, 0::2] + 2 * seen[:, 0::2, 1::2]
        found += 4 * seen[:, 1::2, 0::2] + 8 * seen[:, 1::2, 1::2]
        return found.reshape(len(found), -1)

    def summed(self, ways: IntArray, values: FloatArray) -> FloatArray:
        """Transfer (B, m, h²) of how cells are seen (B, C) and of F there (B · C, m)."""
        points, cells = ways.shape
        which = ways.take(self.cells, axis=1) + 16 * np.arange(len(self.cells), dtype=np.int32)
        columns = self.cells + cells * np.arange(points, dtype=np.int32)[:, None]
        each = self.weights.take(which).reshape(-1, AROUND**2)
        sums = rows_of(each, columns.reshape(-1, AROUND**2), len(values)) @ values
        return np.asarray(sums.reshape(points, self.texels, -1).swapaxes(1, 2))


def reach(size: int, half: int) -> tuple[slice, FloatArray, IntArray]:
    """Along one side of a face: the cells of a half, and its hats on them.

    Returns:
        The cells of the face, the hats at the two directions of the cells that each reaches,
        (h, 4, 2), and which of the half's cells those are, (h, 4).
    """
    texel = size // 2 * half + np.arange(size // 2)
    first, last = max(0, size * half - 1), min(2 * size, size * (half + 1) + 1)
    cell = 2 * texel[:, None] - 1 + np.arange(AROUND)
    inside = (cell >= 0) & (cell < 2 * size)
    kept = np.clip(cell, 0, 2 * size - 1)
    line = hats(size, SAMPLES).reshape(2 * size, 2, size)
    hat = np.where(inside[..., None], line[kept, :, texel[:, None]], 0.0)
    return slice(first, last), hat, kept - first


def ground(surface: Surface, vertices: int = VERTICES, wide: float = WIDE) -> Surface:
    """A level square under an object, facing up (+y): what it stands on, to be shadowed by it.

    Args:
        surface: the object; its lowest vertex that is in a triangle touches the ground.
        vertices: a side.
        wide: the square's side, in longest sides of the object's box.

    Raises:
        ValueError: there are fewer than two vertices a side, or the object has no triangle.
    """
    if vertices < 2 or not len(surface.faces):
        raise ValueError("a ground needs two vertices a side, and an object to stand on it")
    used = surface.positions[np.unique(surface.faces)].astype(np.float64)
    low, high = used.min(axis=0), used.max(axis=0)
    line = (np.arange(vertices) / (vertices - 1) - 0.5) * wide * float((high - low).max())
    z, x = np.meshgrid(line, line, indexing="ij")
    middle = (low + high) / 2.0
    places = np.stack([x + middle[0], np.full_like(x, low[1]), z + middle[2]], axis=-1)
    index = np.arange(vertices**2, dtype=np.int32).reshape(vertices, vertices)
    a, b, c, d = (
        one.ravel() for one in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1])
    )
    faces = np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)])
    along, up = (np.tile(one, (vertices**2, 1)) for one in np.eye(3, dtype=np.float32)[:2])
    return Surface(places.reshape(-1, 3).astype(np.float32), up, along, faces)
