"""Bits of visibility against single rays, and where they are known."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh
import trimesh.creation as shapes

from data_gen.cube_visibility import cube_visibility
from prtnet.cube_map import directions, solid_angles
from prtnet.tangents import any_tangent
from prtnet.transfer import Surface


def surface_of(mesh: trimesh.Trimesh, scale: float = 1.0, shift: float = 0.0) -> Surface:
    normals = np.array(mesh.vertex_normals, dtype=np.float32)
    return Surface(
        (np.array(mesh.vertices) * scale + shift).astype(np.float32),
        normals,
        any_tangent(normals).astype(np.float32),
        np.array(mesh.faces, dtype=np.int32),
    )


def pair() -> Surface:
    """Two balls, one above the other."""
    upper = shapes.icosphere(1, radius=0.5).apply_translation([0.1, 1.3, 0.0])
    return surface_of(shapes.icosphere(2, radius=0.5) + upper)


def test_bits_are_those_of_trying_every_triangle():
    surface = pair()
    found = cube_visibility(surface, [surface], size=16)
    out = directions(16).reshape(-1, 3)
    a, b, c = surface.positions[surface.faces].astype(float).transpose(1, 0, 2)
    wrong = 0
    for vertex in (0, 57, 130, 170):
        normal = surface.normals[vertex].astype(float)
        start = surface.positions[vertex] + 1e-4 * normal
        seen = np.concatenate([found.seen(slice(vertex, vertex + 1), face)[0] for face in range(6)])
        for direction, bit in zip(out, seen.ravel(), strict=True):
            expected = direction @ normal > 0.0
            if expected:  # Möller and Trumbore
                p = np.cross(direction, c - a)
                det = np.einsum("ti,ti->t", b - a, p)
                det = np.where(det == 0.0, np.inf, det)  # along the triangle: never met
                u = np.einsum("ti,ti->t", start - a, p) / det
                q = np.cross(start - a, b - a)
                v = q @ direction / det
                t = np.einsum("ti,ti->t", c - a, q) / det
                expected = not ((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)).any()
            wrong += bit != expected
    assert wrong <= 4  # of 6144: edges' rounding


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e5])
@pytest.mark.parametrize("shift", [0.0, 100.0])
def test_convex_vertices_see_all_above_their_horizon(scale, shift):
    surface = surface_of(shapes.icosphere(2), scale, shift * scale)
    found = cube_visibility(surface, [surface], size=16)
    above = directions(16) @ surface.normals.astype(np.float64).T
    seen = np.stack([found.seen(slice(None), face) for face in range(6)], axis=1)
    assert seen.shape == (162, 6, 16, 16)
    np.testing.assert_array_equal(seen, np.moveaxis(above, -1, 0) > 0.0)


def test_a_vertex_inside_sees_nothing():
    surface = surface_of(shapes.icosphere(3, radius=0.1))
    box = surface_of(shapes.box([2, 2, 2]))
    assert not cube_visibility(surface, [box, surface], size=8).bits.any()


def test_the_part_of_the_sky_beside_a_wall():
    """k = H/d: the cosine-weighted sky that a wall leaves is (1 + 1/√(1 + k²)) / 2."""
    floor = Surface(
        np.array([[0.0, 0.0, 0.0]], dtype=np.float32),
        np.array([[0.0, 1.0, 0.0]], dtype=np.float32),
        np.array([[1.0, 0.0, 0.0]], dtype=np.float32),
        np.zeros((0, 3), dtype=np.int32),
    )
    wall = shapes.box([0.01, 2.0, 60.0]).apply_translation([1.005, 0.0, 0.0])
    found = cube_visibility(floor, [surface_of(wall)], size=128)
    seen = np.stack([found.seen(slice(None), face)[0] for face in range(6)])
    cosine = np.maximum(directions(128)[..., 1], 0.0)
    sky = (solid_angles(128) * cosine * seen).sum() / math.pi
    assert sky == pytest.approx((1.0 + math.sqrt(0.5)) / 2.0, abs=2e-3)


def test_rays_that_pass_by_all_casters_are_left_out_rightly():
    """A ball seen from outside hides a cone: sin of its half angle = r / d."""
    away = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 40.0]], dtype=np.float32)
    up = np.tile(np.float32([[0.0, 1.0, 0.0]]), (3, 1))
    points = Surface(away, up, any_tangent(up).astype(np.float32), np.zeros((0, 3), np.int32))
    ball = surface_of(shapes.icosphere(5, radius=0.9).apply_translation([0.0, 2.0, 0.0]))
    found = cube_visibility(points, [ball], size=64)
    seen = np.stack([found.seen(slice(None), face) for face in range(6)], axis=1)
    for one, where in zip(seen, away, strict=True):
        middle = np.array([0.0, 2.0, 0.0]) - where
        distance = np.linalg.norm(middle)
        cosine = directions(64) @ middle / distance
        above = directions(64)[..., 1] > 0.0
        expected = above & (cosine < math.sqrt(1.0 - (0.9 / distance) ** 2))
        assert np.count_nonzero(one != expected) <= 0.01 * np.count_nonzero(above & ~expected) + 2


def test_threads_and_other_casters_change_nothing_but_what_they_hide():
    surface = pair()
    alone = cube_visibility(surface, [surface], size=8)
    far = surface_of(shapes.box().apply_translation([0.0, -500.0, 0.0]))
    np.testing.assert_array_equal(
        cube_visibility(surface, [surface], size=8, threads=3).bits, alone.bits
    )
    both = cube_visibility(surface, [far, surface], size=8)
    assert np.mean(both.bits != alone.bits) < 1e-2
    with pytest.raises(ValueError, match="bytes"):
        cube_visibility(surface, [surface], size=12)
    with pytest.raises(ValueError, match="no triangle"):
        cube_visibility(surface, [], size=8)
