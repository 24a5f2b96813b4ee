"""Closed symmetric meshes of implicit surfaces: surface nets [1] of one half, coarsened, mirrored.

A field is negative inside, and even in x. Every cell of a fine grid over x ≥ 0 that the surface
crosses gets one vertex, every crossed grid edge one quadrilateral; cells astride x = 0 have their
vertex in that plane, where the mirrored half joins. The fine mesh is coarsened where it is flat,
then relaxed: vertices slide along the surface until the triangles are even.

[1] Gibson, "Constrained elastic surface nets", MICCAI 1998.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse

from data_gen.decimation import coarsen
from prtnet.arrays import FloatArray, IntArray

__all__ = ["Field", "polygonise", "surface_net"]

Field = Callable[[FloatArray], FloatArray]  # points (N, 3) in metres -> signed values (N,)

DIFFERENCE = 1e-5  # metres: the step of a difference of the field
RELAXATION_STEP = 0.5  # of the way to the neighbours' mean: 1 would swap neighbours for ever
RELAXATION_ROUNDS = 8
BLOCK = 50_000  # points of a field evaluated at once
STRIDE = 3  # the field is first looked at in every third node
STEEPEST = 1.7  # of a field's slope: a node is at most 0.87 strides from one looked at
MIRROR = np.array([-1.0, 1.0, 1.0])


def slope(field: Field, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values (N,) and gradients (N, 3) of a field.

    The stencil of four points is its own mirror image in x, so that an even field keeps a
    symmetric mesh symmetric.
    """
    offsets = DIFFERENCE * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]])
    ahead, behind, up, front = field((points + offsets[:, None]).reshape(-1, 3)).reshape(4, -1)
    value = 0.5 * (ahead + behind)
    gradient = np.stack([0.5 * (ahead - behind), up - value, front - value], axis=1)
    return value, gradient / DIFFERENCE


def onto_surface(field: Field, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (N, 3) after a Newton step, and the unit normals (N, 3) there."""
    value, gradient = slope(field, points)
    squared = np.maximum(np.sum(gradient**2, axis=1, keepdims=True), 1e-6)
    return points - gradient * value[:, None] / squared, gradient / np.sqrt(squared)


def fill_checkerboards(values: FloatArray) -> FloatArray:
    """Node values with the nearer outside corner taken in wherever a grid face has diagonal signs.

    Two sheets would share an edge in such a face; afterwards one sheet passes it.
    """
    values = values.copy()
    found = True
    while found:
        found = False
        for axis in range(3):
            # Views, so that writing to a corner writes to the grid.
            grid = np.moveaxis(values, axis, 0)
            a, b, c, d = grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, 1:, 1:], grid[:, :-1, 1:]
            for one, other, p, q in ((a, c, b, d), (b, d, a, c)):
                bad = (one < 0) & (other < 0) & (p >= 0) & (q >= 0)
                found |= bool(bad.any())
                first = bad & (p < q)
                second = bad & ~first
                p[first] = -p[first] - 1e-9
                q[second] = -q[second] - 1e-9
    return values


def node_values(field: Field, axes: list[FloatArray]) -> FloatArray:
    """The field at the nodes of a grid (X, Y, Z); far from the surface, at a node nearby."""
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    sparse = nodes[::STRIDE, ::STRIDE, ::STRIDE]
    coarse = field(sparse.reshape(-1, 3)).reshape(sparse.shape[:3])
    nearest = (
        np.minimum((np.arange(len(axis)) + STRIDE // 2) // STRIDE, len(axis[::STRIDE]) - 1)
        for axis in axes
    )
    values = coarse[np.ix_(*nearest)]
    cell = axes[0][1] - axes[0][0]
    near = np.abs(values) < STEEPEST * STRIDE * cell
    points = nodes[near]
    blocks = [field(points[k : k + BLOCK]) for k in range(0, len(points), BLOCK)]
    values[near] = np.concatenate(blocks)
    return values


def surface_net(
    field: Field, low: FloatArray, high: FloatArray, cell: float
) -> tuple[FloatArray, IntArray]:
    """The dual mesh of the half x ≥ 0 of an even field.

    Args:
        field: negative inside.
        low: least corner of a box that holds the half, in metres; ``low[0]`` is 0.
        high: its greatest corner.
        cell: size of the grid's cells, in metres.

    Returns:
        Vertices (V, 3) and quadrilaterals (Q, 4), counter-clockwise from outside, open at x = 0.
    """
    first = np.asarray(low) - (0.5 * cell, 0, 0)
    axes = [np.arange(a, b + cell, cell) for a, b in zip(first, high, strict=True)]
    shape = tuple(len(axis) for axis in axes)
    values = fill_checkerboards(node_values(field, axes))
    inside = values < 0
    points, cells = [], []  # of every crossed edge: where, and the four cells around it
    for axis, step in enumerate(np.eye(3, dtype=int)):
        near = tuple(slice(0, n - d) for n, d in zip(shape, step, strict=True))
        far = tuple(slice(d, n) for n, d in zip(shape, step, strict=True))
        start = np.argwhere(inside[near] != inside[far])
        start = start[start[:, 0] > 0]  # those of the first layer belong to the other half
        f0, f1 = values[tuple(start.T)], values[tuple((start + step).T)]
        points.append(first + cell * (start + (f0 / (f0 - f1))[:, None] * step))
        right, up = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        around = start[:, None] - np.stack([right + up, up, 0 * up, right])
        cells.append(np.where((f0 < 0)[:, None, None], around, around[:, ::-1]))
    keys = np.ravel_multi_index(tuple(np.moveaxis(np.concatenate(cells), -1, 0)), shape)
    kept, quads = np.unique(keys, return_inverse=True)
    quads = quads.reshape(keys.shape)
    corner = np.repeat(np.concatenate(points), 4, axis=0)
    sums = [np.bincount(quads.ravel(), corner[:, k]) for k in range(3)]
    vertices = np.stack(sums, axis=1) / np.bincount(quads.ravel())[:, None]
    vertices[kept < shape[1] * shape[2], 0] = 0.0  # the cells astride the plane
    return vertices, quads


def split(vertices: FloatArray, quads: IntArray) -> IntArray:
    """Triangles (2Q, 3): every quadrilateral cut along its shorter diagonal."""
    a, b, c, d = np.moveaxis(vertices[quads], 1, 0)
    first = np.linalg.norm(a - c, axis=1) <= np.linalg.norm(b - d, axis=1)
    turned = np.where(first[:, None], quads, np.roll(quads, -1, axis=1))
    return np.concatenate([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


def mirrored(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """The half and its mirror image, sharing the vertices at x = 0."""
    own = vertices[:, 0] != 0
    image = np.where(own, len(vertices) + np.cumsum(own) - 1, np.arange(len(vertices)))
    both = np.concatenate([vertices, vertices[own] * MIRROR])
    return both, np.concatenate([faces, image[faces[:, ::-1]]])


def relax(field: Field, vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Vertices (V, 3) moved along the surface towards their neighbours' mean, then onto it."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    links = scipy.sparse.csr_array(
        (np.ones(len(start)), (start, end)), shape=(len(vertices), len(vertices))
    )
    degree = np.bincount(start)[:, None]
    for _ in range(RELAXATION_ROUNDS):
        vertices, normals = onto_surface(field, vertices)
        move = RELAXATION_STEP * (links @ vertices / degree - vertices)
        vertices = vertices + move - normals * np.sum(move * normals, axis=1, keepdims=True)
    return vertices


def polygonise(
    field: Field, low: FloatArray, high: FloatArray, cell: float, longest: float
) -> tuple[FloatArray, IntArray, FloatArray]:
    """A closed triangle mesh of an even field's zero surface, symmetric about x = 0.

    Args:
        field: negative inside, its slope about one.
        low: least corner of a box that holds the half x ≥ 0, in metres; ``low[0]`` is 0.
        high: its greatest corner.
        cell: size of the fine grid's cells, in metres: less than half of any gap or thin part.
        longest: edges of the result in flat places, in metres, about.

    Returns:
        Vertices (V, 3), triangles (T, 3) int32 counter-clockwise from outside, and the field's unit
        gradient at the vertices, their outward normals, (V, 3).
    """
    vertices, quads = surface_net(field, low, high, cell)
    vertices, _ = onto_surface(field, vertices)
    vertices, faces = coarsen(
        vertices, split(vertices, quads), lambda points: onto_surface(field, points), longest
    )
    vertices, faces = mirrored(vertices, faces)
    vertices = relax(field, vertices, faces)
    vertices, _ = onto_surface(field, vertices)
    vertices, normals = onto_surface(field, vertices)
    return vertices, faces.astype(np.int32), normals
