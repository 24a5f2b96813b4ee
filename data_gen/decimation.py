"""Coarser triangle meshes by edge collapses, many at once.

An edge costs its length plus a multiple of how far the normal turns along it, so flat places get
long edges and tight curves short ones. In each round the cheapest edge of every neighbourhood is
collapsed to its middle, set back on the surface: such edges do not touch each other's triangles,
and a round is a handful of array operations. Collapses that would fold a triangle over or pinch the
surface (the link condition [1]) are not made.

[1] Dey, Edelsbrunner, Guha and Nekhayev, "Topology preserving edge contraction", 1999.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse

from prtnet.arrays import BoolArray, FloatArray, IntArray

__all__ = ["coarsen"]

TURN_LENGTH = 0.03  # metres that a normal turning by one radian counts for
FOLD = 0.3  # least cosine between a triangle's normals before and after
ROUNDS = 100

Projection = Callable[[FloatArray], tuple[FloatArray, FloatArray]]


def unit_normals(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Unit normals (T, 3) of triangles; zero for those without area."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-18)


def mesh_edges(faces: IntArray, border: BoolArray) -> tuple[IntArray, BoolArray]:
    """Edges (E, 2) and whether each may collapse without a pinch.

    Its ends must share no neighbours but the tips of its own triangles; and no edge but those of
    the border may come to join two vertices of the border: the mirror image would have it too.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    keys = np.minimum(start, end) * len(border) + np.maximum(start, end)
    keys, triangles = np.unique(keys, return_counts=True)
    edges = np.stack(np.divmod(keys, len(border)), axis=1)
    pairs = np.concatenate([edges, edges[:, ::-1]])
    links = scipy.sparse.csr_array(
        (np.ones(len(pairs), dtype=np.int32), tuple(pairs.T)), shape=(len(border), len(border))
    )
    i, j = edges.T
    common = np.asarray((links @ links)[i, j]).ravel()
    held = scipy.sparse.diags_array(border.astype(np.float64))
    common_border = np.asarray((links @ held @ links)[i, j]).ravel()
    near_border = links @ border.astype(np.int32)
    # One end on the border: the other end's neighbours there are that one and shared ones only.
    inner = np.where(border[i], j, i)
    joins = (border[i] != border[j]) & (near_border[inner] != common_border + 1)
    chord = border[i] & border[j] & (triangles == 2)
    return edges, (common == triangles) & ~chord & ~joins


def independent(edges: IntArray, cost: FloatArray, count: int) -> BoolArray:
    """The edges (E,) of finite cost, the least of all that touch a neighbour of their ends."""
    rank = np.empty(len(edges), dtype=np.int64)
    rank[np.argsort(cost, kind="stable")] = np.arange(len(edges))
    least = np.full(count, len(edges))
    around = least.copy()
    for end in edges.T:
        np.minimum.at(least, end, rank)
    for end, other in (edges.T, edges.T[::-1]):
        np.minimum.at(around, end, least[other])
    return np.isfinite(cost) & (rank == around[edges].min(axis=1))


def merged(faces: IntArray, kept: IntArray, gone: IntArray, count: int) -> IntArray:
    """The triangles with every vertex of ``gone`` replaced by its partner in ``kept``."""
    target = np.arange(count)
    target[gone] = kept
    return target[faces]


def alive(faces: IntArray) -> BoolArray:
    """Whether each triangle still has three vertices, (T,)."""
    return (faces != np.roll(faces, 1, axis=1)).all(axis=1)


def coarsen(
    vertices: FloatArray, faces: IntArray, project: Projection, longest: float, fewest: int = 0
) -> tuple[FloatArray, IntArray]:
    """A mesh whose edges nearly all cost ``longest``, in metres, or more.

    Args:
        vertices: near the surface, (V, 3); a border, if any, lies at x = 0 and stays there.
        faces: triangles (T, 3) of a manifold.
        project: gives points (N, 3) near the surface their place on it and the unit normals there.
        longest: see above.
        fewest: vertices to stop at.
    """
    count = len(vertices)
    border = vertices[:, 0] == 0
    vertices, normals = project(vertices)
    refused = np.zeros(0, dtype=np.int64)
    for _ in range(ROUNDS):
        edges, allowed = mesh_edges(faces, border)
        i, j = edges.T
        cost = np.linalg.norm(vertices[i] - vertices[j], axis=1)
        cost += TURN_LENGTH * np.linalg.norm(normals[i] - normals[j], axis=1)
        cost[~allowed | (cost >= longest) | np.isin(i * count + j, refused)] = np.inf
        chosen = np.flatnonzero(independent(edges, cost, count))
        spare = max(0, len(np.unique(faces)) - fewest)
        i, j = edges[chosen[np.argsort(cost[chosen], kind="stable")[:spare]]].T
        if len(i) == 0:
            break
        middle = 0.5 * (vertices[i] + vertices[j])
        middle = np.where((border[i] > border[j])[:, None], vertices[i], middle)
        middle = np.where((border[j] > border[i])[:, None], vertices[j], middle)
        place, normal = project(middle)
        trial = vertices.copy()
        trial[i] = trial[j] = place
        shrunk = merged(faces, i, j, count)
        # Each triangle touches one chosen edge at most; one that folds refuses its edge.
        cosine = np.sum(unit_normals(vertices, faces) * unit_normals(trial, faces), axis=1)
        folded = np.zeros(count, dtype=bool)
        folded[shrunk[alive(shrunk) & (cosine < FOLD)]] = True
        good = ~folded[i]
        refused = np.append(refused, (i * count + j)[~good])
        i, j = i[good], j[good]
        vertices[i], normals[i] = place[good], normal[good]
        border[i] |= border[j]
        faces = merged(faces, i, j, count)
        faces = faces[alive(faces)]
    used, faces = np.unique(faces, return_inverse=True)
    vertices = vertices[used]
    vertices[border[used], 0] = 0.0
    return vertices, faces.reshape(-1, 3)
