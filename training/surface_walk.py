"""Where walks straight over a mesh end, from each vertex to points of its tangent plane.

A walker stands on a vertex and knows where that is in the tangent plane it started in: each edge it
walked was turned into that plane by the turns between neighbouring frames, as in the discrete
exponential map [1]. It goes on to the neighbour nearest to its goal as long as one is nearer.

[1] Schmidt, Grimm, Wyvill. "Interactive decal compositing with discrete exponential maps".
SIGGRAPH 2006.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse
from numpy.typing import NDArray

from prtnet.arrays import FloatArray, IntArray
from prtnet.axis_frames import rolled

__all__ = ["ComplexArray", "SurfaceWalk", "edge_graph"]

ComplexArray = NDArray[np.complexfloating[Any, Any]]

LONGEST = 10_000  # steps; every step comes nearer, so walks end by themselves


def edge_graph(points: FloatArray, faces: IntArray) -> scipy.sparse.csr_array:
    """Lengths of edges (N, N) of triangles (T, 3) over points (N, 3), in both directions."""
    ends = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    ends = ends[ends[:, 0] != ends[:, 1]]
    length = np.linalg.norm(points[ends[:, 0]] - points[ends[:, 1]], axis=1)
    length = np.maximum(length, 1e-9 * float(length.max(initial=1.0)))  # zero would be no edge
    both = np.concatenate([ends, ends[:, ::-1]])
    return scipy.sparse.csr_array(
        (np.tile(length, 2), (both[:, 0], both[:, 1])), shape=(len(points), len(points))
    )


class SurfaceWalk:
    """Walks from all vertices at once.

    Args:
        points: (N, 3).
        graph: lengths of edges, (N, N).
        frames: columns tangent, bitangent, normal, (N, 3, 3).
    """

    def __init__(
        self, points: FloatArray, graph: scipy.sparse.csr_array, frames: FloatArray
    ) -> None:
        start = np.repeat(np.arange(len(points)), np.diff(graph.indptr))
        end = graph.indices
        flat = planar(points[end] - points[start], frames[start])
        # The end's tangent, rolled into the start's plane by the smallest turn of the normals.
        across = rolled(frames[end][..., 0], frames[end][..., 2], frames[start][..., 2])
        slot = np.arange(len(end)) - graph.indptr[start]
        shape = len(points), int(slot.max(initial=0)) + 1
        # Neighbours of every vertex, filled up with itself; steps to them and turns of the frame.
        self.neighbour = np.tile(np.arange(len(points))[:, None], (1, shape[1]))
        self.step, self.turn = np.zeros(shape, dtype=complex), np.ones(shape, dtype=complex)
        self.neighbour[start, slot] = end
        self.step[start, slot] = unit(flat) * graph.data
        self.turn[start, slot] = unit(planar(across, frames[start]))

    def __call__(self, goals: ComplexArray) -> IntArray:
        """Where walks from every vertex to goals x + iy in its tangent plane end, (N, M).

        Args:
            goals: (M,), the same for all. At an edge of the mesh a walk ends before its goal.
        """
        count = len(self.neighbour)
        at = np.repeat(np.arange(count), len(goals))
        goal = np.tile(goals, count)
        place, turn = np.zeros(len(at), dtype=complex), np.ones(len(at), dtype=complex)
        moving = np.arange(len(at))
        for _ in range(LONGEST):
            here = at[moving]
            ahead = place[moving, None] + turn[moving, None] * self.step[here]  # [W, neighbours]
            distance = np.abs(ahead - goal[moving, None])
            best = np.argmin(distance, axis=1)
            rows = np.arange(len(moving))
            nearer = distance[rows, best] < np.abs(place[moving] - goal[moving]) * (1 - 1e-9)
            rows, best, moving = rows[nearer], best[nearer], moving[nearer]
            if len(moving) == 0:
                break
            turn[moving] *= self.turn[here[rows], best]
            place[moving] = ahead[rows, best]
            at[moving] = self.neighbour[here[rows], best]
        return at.reshape(count, len(goals))


def planar(vectors: FloatArray, frames: FloatArray) -> ComplexArray:
    """X + iy of vectors (N, 3) in the tangent planes of frames (N, 3, 3)."""
    local = np.einsum("ni,nij->nj", vectors, frames[..., :2])
    return local[:, 0] + 1j * local[:, 1]


def unit(values: ComplexArray) -> ComplexArray:
    """Complex numbers (N,) of length one; zero becomes one."""
    length = np.abs(values)
    return np.where(length > 0, values / np.where(length > 0, length, 1.0), 1.0)
