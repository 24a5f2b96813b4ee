"""Tangents at rest: principal directions of as-rigid-as-possible clusters, smoothed at the seams.

"Arbitrary BRDFs" section 5.2. For skinned scenes a cluster is what hangs mostly on one joint; for
point caches, vertices whose surroundings rotate alike over the frames [1]. Of a cluster's three
principal directions the one is taken that is least parallel to its normals and agrees best with
the neighbouring clusters. A direction field on a closed surface has singular points somewhere.

[1] James, Twigg. "Skinning mesh animations". SIGGRAPH 2005.
"""

from __future__ import annotations

import warnings

import numpy as np
import scipy.sparse
from scipy.cluster.vq import kmeans2

from prtnet.arrays import FloatArray, IntArray
from prtnet.axis_frames import any_tangent
from prtnet.scene import (
    PointCacheScene,
    Receivers,
    Scene,
    SkinnedScene,
    face_normals,
    unique_rows,
    unit,
)

__all__ = ["rest_tangents", "surface_graph", "tangents_beside"]

SWEEPS = 100  # of smoothing: a hundredth of a second each, and seams vanish
CLUSTERS = 32  # of a point cache
FRAMES = 16  # of a point cache that its clusters are found from
SMALLEST = 1e-4  # a tangent shorter than this beside the normal's direction is none


def rest_tangents(scene: Scene, receivers: Receivers) -> FloatArray:
    """Unit tangents (V, 3) float32 of the receivers at rest, in model space.

    Back receivers have the tangents of their fronts.
    """
    fronts = int(np.count_nonzero(receivers.side > 0))
    rest = receivers.gather(scene.rest())
    positions = rest.positions[0, :fronts].astype(np.float64)
    normals = unit(rest.normals[0, :fronts].astype(np.float64))
    graph = surface_graph(scene.faces, receivers, positions, normals)
    labels = rigid_clusters(scene, receivers.vertex[:fronts])
    tangents = seamed(graph, labels, principal_directions(positions, labels), normals)
    tangents = smoothed(graph, tangents, normals)
    return np.tile(tangents, (len(receivers) // fronts, 1)).astype(np.float32)


def smoothed(
    graph: scipy.sparse.csr_array, tangents: FloatArray, normals: FloatArray
) -> FloatArray:
    """Tangents (V, 3), each drawn towards the mean of its neighbours time and again."""
    for _ in range(SWEEPS):
        tangents = tangents_beside(graph @ tangents + 0.5 * tangents, normals)
    return tangents


def surface_graph(
    faces: IntArray, receivers: Receivers, positions: FloatArray, normals: FloatArray
) -> scipy.sparse.csr_array:
    """Who is whose neighbour among front receivers, (V, V); rows sum to one, or to zero.

    Neighbours share an edge or, across a hard edge, a place; they count by how much their normals
    agree.
    """
    count = len(positions)
    corners = receivers.of_vertex[faces]
    edges = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
    _, place = unique_rows(positions)
    order = np.argsort(place, kind="stable")
    same = place[order[1:]] == place[order[:-1]]
    twins = np.stack([order[:-1][same], order[1:][same]], axis=1)
    i, j = np.concatenate([edges, edges[:, ::-1], twins, twins[:, ::-1]]).T
    agree = np.maximum(np.sum(normals[i] * normals[j], axis=1), 0.0)
    weights = scipy.sparse.csr_array((agree, (i, j)), shape=(count, count))
    total = np.asarray(weights.sum(axis=1)).ravel()
    scale = scipy.sparse.diags_array(np.where(total > 0, 1.0 / np.where(total > 0, total, 1), 0.0))
    return scipy.sparse.csr_array(scale @ weights)


def rigid_clusters(scene: Scene, vertices: IntArray) -> IntArray:
    """The as-rigid-as-possible cluster of each of ``vertices``, (V,), counted from 0."""
    if isinstance(scene, SkinnedScene):
        labels: IntArray = np.argmax(scene.joint_weights[vertices], axis=1)
    elif isinstance(scene, PointCacheScene):
        rotations = np.round(rotation_sequences(scene)[vertices], 3)
        count = min(CLUSTERS, len(np.unique(rotations, axis=0)))
        with warnings.catch_warnings():  # an empty cluster is no cluster
            warnings.simplefilter("ignore", UserWarning)
            _, labels = kmeans2(rotations, count, minit="++", missing="warn", rng=0)
    else:
        labels = np.zeros(len(vertices), dtype=np.int32)
    return np.unique(labels, return_inverse=True)[1]


def rotation_sequences(scene: PointCacheScene) -> FloatArray:
    """The orientation of the surface around each vertex in some frames, (V_render, frames · 6)."""
    chosen = np.unique(np.linspace(0, len(scene.frames) - 1, FRAMES).astype(int))
    frames = scene.frames[chosen].astype(np.float64)
    edge = unit(frames[:, scene.faces[:, 1]] - frames[:, scene.faces[:, 0]])
    normal = unit(face_normals(frames, scene.faces))
    pose = np.concatenate([edge, normal], axis=-1)  # [S, T, 6]
    # Rotation from the first frame: both vectors there are alike for no two faces, so the frames
    # are told relative to it.
    first = np.stack([edge[0], normal[0], np.cross(normal[0], edge[0])], axis=-1)  # [T, 3, 3]
    third = np.cross(pose[..., 3:], pose[..., :3])
    basis = np.stack([pose[..., :3], pose[..., 3:], third], axis=-1)  # [S, T, 3, 3]
    rotation = basis @ first.transpose(0, 2, 1)
    flat = rotation.transpose(1, 0, 2, 3).reshape(len(scene.faces), -1)
    corner = scipy.sparse.csr_array(
        (np.ones(scene.faces.size), (scene.faces.ravel(), np.repeat(np.arange(len(flat)), 3))),
        shape=(scene.vertex_count, len(flat)),
    )
    uses = np.maximum(np.bincount(scene.faces.ravel(), minlength=scene.vertex_count), 1)
    return (corner @ flat) / uses[:, None]


def principal_directions(positions: FloatArray, labels: IntArray) -> FloatArray:
    """Principal directions (C, 3, 3) of each cluster's vertices, as rows."""
    member = scipy.sparse.csr_array((np.ones(len(labels)), (labels, np.arange(len(labels)))))
    uses = np.bincount(labels)[:, None]
    centred = positions - ((member @ positions) / uses)[labels]
    products = (centred[:, :, None] * centred[:, None, :]).reshape(-1, 9)
    _, axes = np.linalg.eigh(np.asarray(member @ products).reshape(-1, 3, 3))
    return axes.transpose(0, 2, 1)


def seamed(
    graph: scipy.sparse.csr_array, labels: IntArray, axes: FloatArray, normals: FloatArray
) -> FloatArray:
    """Tangents (V, 3): one signed axis for each cluster, projected, agreeing across seams.

    Clusters are settled one by one, next always the one most connected with those settled.
    """
    clusters = len(axes)
    choices = perpendicular(axes[labels].transpose(1, 0, 2), normals)  # [3, V, 3]
    sizes = np.bincount(labels, minlength=clusters)
    lying = np.sum(choices**2, axis=2)  # sin² between axis and normal
    lying = np.stack([np.bincount(labels, row, clusters) for row in lying]) / sizes  # [3, C]
    edges = graph.tocoo()
    i, j = edges.coords
    seam = labels[i] != labels[j]
    i, j, weight = i[seam], j[seam], edges.data[seam]
    tangents = np.zeros_like(normals)
    links = np.zeros(clusters)  # to settled clusters
    waiting = np.ones(clusters, dtype=bool)
    for _ in range(clusters):
        order = np.lexsort((sizes, links, waiting))
        cluster = int(order[-1])
        waiting[cluster] = False
        mine = labels[i] == cluster
        facing = np.sum(choices[:, i[mine]] * tangents[j[mine]], axis=2) * weight[mine]
        agreement = facing.sum(axis=1) / max(weight[mine].sum(), 1e-12)
        best = int(np.argmax(np.abs(agreement) + lying[:, cluster]))
        sign = -1.0 if agreement[best] < 0 else 1.0
        members = labels == cluster
        tangents[members] = sign * choices[best, members]
        links += np.bincount(labels[j[mine]], weight[mine], clusters)
    return tangents_beside(tangents, normals)


def perpendicular(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """The part of ``vectors`` in the plane of unit ``normals``."""
    return vectors - np.einsum("...i,...i->...", vectors, normals)[..., None] * normals


def tangents_beside(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """Unit tangents nearest to ``vectors`` (..., 3); any where a vector is along the normal."""
    flat = perpendicular(unit(vectors), normals)
    short = np.einsum("...i,...i->...", flat, flat) < SMALLEST**2
    if short.any():
        flat[short] = any_tangent(normals[short])
    return unit(perpendicular(unit(flat), normals), (1.0, 0.0, 0.0))
