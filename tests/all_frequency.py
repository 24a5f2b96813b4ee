"""Made-up all-frequency fields, for the tests of files, of shading and of drawing."""

from __future__ import annotations

from typing import Any

import numpy as np
import trimesh

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment
from prtnet.arrays import FloatArray
from prtnet.frames import orthonormal_frames
from prtnet.sparse_columns import decode, encode
from prtnet.tangents import any_tangent
from prtnet.transfer import Surface

__all__ = ["ball", "dense_segment", "no_segment", "random_field", "random_segment"]


def ball(finer: int = 1) -> Surface:
    """A unit ball of 42 vertices, four times as many triangles each time ``finer``."""
    mesh = trimesh.creation.icosphere(subdivisions=finer)
    normals = np.asarray(mesh.vertices) / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    frames = orthonormal_frames(any_tangent(normals), normals).astype(np.float32)
    return Surface(
        np.asarray(mesh.vertices, dtype=np.float32),
        np.ascontiguousarray(frames[..., 2]),
        np.ascontiguousarray(frames[..., 0]),
        np.asarray(mesh.faces, dtype=np.int32),
    )


def no_segment(columns: int, terms: int) -> Segment:
    """A segment whose light reaches nobody."""
    none = np.zeros((0, columns), dtype=np.int16)
    return Segment(
        np.zeros(0, np.int32), np.zeros(1, np.int32), np.zeros((0, terms), np.int16),
        np.zeros((0, terms), np.float32), encode(none), 1.0,
    )  # fmt: skip


def random_segment(
    rng: np.random.Generator, points: int, columns: int, terms: int, clusters: int
) -> Segment:
    """Some of the vertices in clusters of different sizes, the last of them of one term only."""
    count = int(rng.integers(clusters, points + 1))
    vertices = rng.permutation(points)[:count].astype(np.int32)
    cuts = np.sort(rng.permutation(np.arange(1, count))[: clusters - 1])
    starts = np.concatenate([[0], cuts, [count]]).astype(np.int32)
    weights = rng.integers(-32767, 32768, (count, terms)).astype(np.int16)
    scale = (rng.uniform(0.5, 2.0, (clusters, terms)) / 32767).astype(np.float32)
    dense = rng.integers(-32767, 32768, (clusters * terms, columns)).astype(np.int16)
    dense[rng.random(dense.shape) < 0.7] = 0
    dense[(clusters - 1) * terms + 1 :] = 0
    scale[-1, 1:] = 0.0
    weights[starts[-2] :, 1:] = 0
    return Segment(vertices, starts, weights, scale, encode(dense), 0.1 / 32767)


def random_field(
    seed: int = 0,
    surface: Surface | None = None,
    rows: int = 3,
    size: int = 8,
    terms: int = 4,
    clusters: int = 3,
    cells: int = 8,
    reached: float = 0.9,
    metadata: dict[str, Any] | None = None,
) -> AllFrequencyField:
    """A small valid field; of its segments one in ten or so reaches nobody.

    Args:
        seed: of all numbers.
        surface: a ball of 42 vertices when not given.
        rows: m.
        size: texels a side of a face.
        terms: representatives of a cluster.
        clusters: of a segment.
        cells: of view factors, a side.
        reached: share of segments that reach vertices.
        metadata: of the field.
    """
    rng = np.random.default_rng(seed)
    surface = ball() if surface is None else surface
    columns = rows * (size // 2) ** 2
    segments = []
    for _ in range(SEGMENTS):
        if rng.random() < reached:
            segments.append(random_segment(rng, len(surface), columns, terms, clusters))
        else:
            segments.append(no_segment(columns, terms))
    view = rng.uniform(0.0, 1.0, (rows, cells * cells, 3)).astype(np.float32)
    told = {"source": "made"} if metadata is None else metadata
    return AllFrequencyField(surface, tuple(segments), view, size, told)


def dense_segment(segment: Segment, points: int) -> FloatArray:
    """Every vertex's columns of a segment in Haar wavelets, (K, columns) float64, slowly."""
    matrix = decode(segment.representatives).astype(np.float64) * segment.step
    terms = segment.weights.shape[1]
    found = np.zeros((points, matrix.shape[1]))
    for cluster in range(segment.clusters):
        for place in range(segment.starts[cluster], segment.starts[cluster + 1]):
            for term in range(terms):
                weight = segment.weights[place, term] * float(segment.scale[cluster, term])
                row = matrix[cluster * terms + term]
                found[segment.vertices[place]] += weight * row
    return found
