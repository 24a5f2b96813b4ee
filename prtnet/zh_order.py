"""Which lobe is which: the order and the orientation of the lobes of a sum.

A sum of lobes is the same in any order, and a lobe the same about −s* with g*_l (−1)^l. Alone, a
sum is given the order of its energies and points to where its linear band is positive. Beside a
neighbour, or the frame before, it takes the order and orientation of that one: only then does what
lies between the two make sense.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from prtnet.arrays import FloatArray, IntArray
from prtnet.sh import bands, evaluate
from prtnet.zh import Lobes, zonal_energy

__all__ = ["aligned", "aligned_along", "in_order"]


def in_order(lobes: Lobes) -> Lobes:
    """The same sums: linear bands not negative, lobes of most energy first.

    Where a lobe has no linear band, its next odd band is not negative.
    """
    coefficients = lobes.coefficients
    odd = coefficients[..., 1::2]
    first = (odd != 0).argmax(axis=-1)[..., None] if odd.shape[-1] else None
    lead = np.zeros_like(coefficients[..., :1])
    if first is not None:
        lead = np.take_along_axis(odd, first, axis=-1)
    turned = oriented(lobes, np.where(lead < 0, -1.0, 1.0))
    energy = coefficients**2 @ zonal_energy(np.arange(coefficients.shape[-1]))
    return taken(turned, np.argsort(-energy, axis=-1, kind="stable"))


def aligned(lobes: Lobes, reference: Lobes) -> Lobes:
    """The same sums, each lobe at the place and to the side of the one that it resembles most.

    Pairs are made one by one, of the largest inner product of two lobes as functions, which is
    the same whichever way they point.

    Args:
        lobes: (..., N).
        reference: their neighbours or the frame before, (..., N).
    """
    likeness = inner_products(reference, lobes)
    count = likeness.shape[-1]
    flat = likeness.reshape(-1, count, count)
    order = np.empty(flat.shape[:2], dtype=np.int64)
    rows = np.arange(len(flat))
    for _ in range(count):
        place, lobe = np.divmod(flat.reshape(len(flat), -1).argmax(axis=-1), count)
        order[rows, place] = lobe
        flat[rows, place] = -np.inf
        flat[rows, :, lobe] = -np.inf
    found = taken(lobes, order.reshape(likeness.shape[:-1]))
    cosine = (found.axes * reference.axes).sum(axis=-1, keepdims=True)
    return oriented(found, np.where(cosine < 0, -1.0, 1.0))


def aligned_along(lobes: Lobes, edges: IntArray, root: int = 0) -> Lobes:
    """Lobes of a mesh or a texture, each aligned to a neighbour that is nearer to the root.

    Args:
        lobes: (V, N).
        edges: pairs of neighbours, (E, 2).
        root: whose order and orientation all of its piece take; other pieces begin with their
            first vertex.
    """
    result = Lobes(lobes.axes.copy(), lobes.coefficients.copy())
    for children, parents in outwards(len(lobes.axes), edges, root):
        found = aligned(result[children], result[parents])
        result.axes[children], result.coefficients[children] = found.axes, found.coefficients
    return result


def outwards(count: int, edges: IntArray, root: int) -> list[tuple[IntArray, IntArray]]:
    """By growing distance from the root of their piece: vertices and their parents."""
    pairs = np.concatenate([edges, edges[:, ::-1]]).reshape(-1, 2)
    graph = scipy.sparse.csr_array(
        (np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count)
    )
    _, piece = scipy.sparse.csgraph.connected_components(graph, directed=False)
    first = np.unique(piece, return_index=True)[1]
    first[piece[root]] = root
    seen = np.zeros(count, dtype=bool)
    seen[first] = True
    front: IntArray = first
    steps: list[tuple[IntArray, IntArray]] = []
    while len(front) > 0:
        rows = graph[front].tocoo()
        new = ~seen[rows.col]
        children, at = np.unique(rows.col[new], return_index=True)
        seen[children] = True
        if len(children) > 0:
            steps.append((children, front[rows.row[new][at]]))
        front = children
    return steps


def inner_products(one: Lobes, other: Lobes) -> FloatArray:
    """∫ of lobe i of one times lobe j of the other, (..., N, N)."""
    functions = [
        evaluate(lobes.axes, lobes.coefficients.shape[-1])
        * lobes.coefficients[..., bands(lobes.coefficients.shape[-1])]
        for lobes in (one, other)
    ]
    return np.asarray(functions[0] @ np.swapaxes(functions[1], -1, -2), dtype=np.float64)


def oriented(lobes: Lobes, sign: FloatArray) -> Lobes:
    """The same lobes about axes times signs (..., N, 1)."""
    order = lobes.coefficients.shape[-1]
    parity = np.where(np.arange(order) % 2 == 1, sign, 1.0)
    dtype = lobes.axes.dtype
    return Lobes(
        (lobes.axes * sign).astype(dtype, copy=False),
        (lobes.coefficients * parity).astype(dtype, copy=False),
    )


def taken(lobes: Lobes, order: IntArray) -> Lobes:
    """The lobes (..., N) in another order, (..., N)."""
    return Lobes(
        np.take_along_axis(lobes.axes, order[..., None], axis=-2),
        np.take_along_axis(lobes.coefficients, order[..., None], axis=-2),
    )
