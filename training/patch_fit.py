"""Patches and control points for the receivers of a point cache, from its mesh at rest.

Everything follows geodesic distances over the mesh, so that folds which touch at rest stay apart.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.sparse
from scipy.sparse.csgraph import dijkstra

from prtnet.arrays import FloatArray, IntArray
from prtnet.frames import deformation_operator, orthonormal_frames
from prtnet.patches import PatchSurroundings
from prtnet.scene import face_normals
from training.onnx_patches import padded_rows
from training.surface_walk import ComplexArray, SurfaceWalk, edge_graph

__all__ = ["fit_patches", "spread_seeds"]

LEVELS = (32, 128, 512)  # patches, from coarse to fine
REFINED = 0.6  # patch spacings: patches nearer than that are replaced by finer ones
RINGS = 5  # each of half the radius of the next
OUTERMOST = 0.25  # radius of the last ring, in sizes of the sheet
DIRECTIONS = 8  # control points a ring


def fit_patches(
    faces: IntArray,
    receiver_of_vertex: IntArray,
    rest: FloatArray,
    rest_tangents: FloatArray,
    two_sided: bool,
    levels: tuple[int, ...] = LEVELS,
    refined: float = REFINED,
    rings: int = RINGS,
    order: int = 4,
) -> PatchSurroundings:
    """What receivers see of the surface around them.

    Args:
        faces: triangles over render vertices, (T, 3).
        receiver_of_vertex: the front receiver of each render vertex, (vertices,).
        rest: render vertices at rest, (vertices, 3).
        rest_tangents: of the receivers, fronts first, (V, 3).
        two_sided: whether half of the receivers are backs.
        levels: patches at every level of detail, from coarse to fine.
        refined: a patch nearer than so many spacings of its level is replaced by its parts.
        rings: of control points.
        order: of the spherical harmonics.
    """
    rest = rest.astype(np.float64)
    used = np.unique(faces)
    _, first = np.unique(receiver_of_vertex[used], return_index=True)
    vertex = used[first]
    welded = receiver_of_vertex[faces]
    tangents = rest_tangents[: len(vertex)]
    crosses = face_normals(rest, faces)
    share = np.linalg.norm(crosses, axis=1) / 6.0
    area = np.bincount(faces.ravel(), np.repeat(share, 3), minlength=len(rest))
    size = math.sqrt(float(area.sum())) or 1.0
    normals = np.zeros((len(rest), 3))
    np.add.at(normals, faces.ravel(), np.repeat(crosses, 3, axis=0))
    frames = orthonormal_frames(tangents, normals[vertex])
    graph = edge_graph(rest[vertex] / size, welded)
    goals, radius = rings_of(rings)
    control = SurfaceWalk(rest[vertex] / size, graph, frames)(goals)
    patch, near = patches(graph, np.unique(welded), levels, refined)
    carry_vertex, carry_weight = padded_rows(
        deformation_operator(rest / size, faces, receiver_of_vertex, tangents)
    )
    return PatchSurroundings(
        faces=faces.astype(np.int32),
        vertex=vertex.astype(np.int32),
        two_sided=two_sided,
        carry_vertex=carry_vertex,
        carry_weight=carry_weight,
        control=vertex[control].astype(np.int32),
        radius=radius.astype(np.float32),
        patch=patch[:, receiver_of_vertex].astype(np.int32),
        area=area.astype(np.float32),
        near=near,
        size=size,
        order=order,
    )


def rings_of(count: int) -> tuple[ComplexArray, FloatArray]:
    """Points x + iy on rings around the origin, (M,), and the radius of the ring of each, (M,)."""
    radii = OUTERMOST * 0.5 ** np.arange(count)[::-1]
    around = np.exp(2j * math.pi * np.arange(DIRECTIONS) / DIRECTIONS)
    return (radii[:, None] * around).ravel(), np.repeat(radii, DIRECTIONS)


def spread_seeds(graph: scipy.sparse.csr_array, among: IntArray, count: int) -> IntArray:
    """Vertices far from each other: each is the one farthest from those before."""
    seeds = [int(among[0])]
    distance = np.full(graph.shape[0], np.inf)
    while len(seeds) < min(count, len(among)):
        own = dijkstra(graph, indices=np.array(seeds[-1:]))[0]
        distance = np.minimum(distance, own)
        seeds.append(int(among[np.argmax(distance[among])]))
    return np.array(seeds)


def patches(
    graph: scipy.sparse.csr_array, used: IntArray, levels: tuple[int, ...], refined: float
) -> tuple[IntArray, IntArray]:
    """Nested patches of vertices, and those that each vertex looks at.

    Patches of a level are what is nearest to its seeds; a patch belongs to the one of the level
    above that holds its seed. Starting with the coarsest, patches near a vertex are replaced by
    their parts; the finest one that holds the vertex itself is left out.

    Returns:
        patch (levels, N), counted on from level to level, and near (N, K), −1 for none.
    """
    order = spread_seeds(graph, used, levels[-1])
    reach = dijkstra(graph, indices=order)  # [S, N]
    counts = [min(level, len(order)) for level in levels]
    label: IntArray = np.argmin(reach, axis=0)  # of the finest
    labels = [label]
    parents: list[IntArray] = []
    for coarse, fine in zip(counts[-2::-1], counts[:0:-1], strict=True):
        parents.insert(0, np.argmin(reach[:coarse, order[:fine]], axis=0))
        label = parents[0][label]
        labels.insert(0, label)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    held = [label[order] for label in labels]  # the patch of each level that holds a finest one
    seen = np.ones((counts[0], graph.shape[0]), dtype=bool)
    columns = []
    for level, count in enumerate(counts):
        own = labels[level] == np.arange(count)[:, None]
        if level == len(counts) - 1:
            columns.append(seen & ~own)
            break
        close = seen & (own | (nearest(reach, held[level]) < refined / math.sqrt(count)))
        columns.append(seen & ~close)
        seen = close[parents[level]]
    chosen = np.concatenate(columns).T  # [N, S]
    most = int(chosen.sum(axis=1).max())
    near = np.argsort(~chosen, axis=1, kind="stable")[:, :most]
    near = np.where(np.take_along_axis(chosen, near, axis=1), near, -1)
    return np.stack(labels) + offsets[:-1, None], near.astype(np.int32)


def nearest(reach: FloatArray, group: IntArray) -> FloatArray:
    """Distance (G, N) from each vertex to the nearest of the seeds (S, N) of each group (S,)."""
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(group.max() + 1))
    return np.minimum.reduceat(reach[order], starts, axis=0)
