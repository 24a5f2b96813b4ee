from __future__ import annotations

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.surface_points import solid_faces, vertex_areas, vertex_normals


def test_areas_add_up_and_normals_point_out_of_a_ball() -> None:
    ball = shapes.icosphere(3, radius=2.0)
    positions, faces = np.array(ball.vertices), np.array(ball.faces)
    assert vertex_areas(positions, faces).sum() == pytest.approx(ball.area)
    np.testing.assert_allclose(vertex_normals(positions, faces), positions / 2, atol=6e-3)


def test_normals_of_a_cube_do_not_depend_on_how_it_is_cut() -> None:
    box = shapes.box()
    corners = np.sign(np.array(box.vertices)) / np.sqrt(3)
    normals = vertex_normals(np.array(box.vertices), np.array(box.faces))
    np.testing.assert_allclose(normals, corners, atol=1e-12)


def test_an_endless_triangle_weighs_by_its_angle() -> None:
    """Two squares at a right angle, one of them a thousand times as long."""
    for length in (1.0, 1e3):
        flat = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
        wall = np.array([[0, 0, -length], [0, 1, -length]])
        faces = np.array([[0, 1, 2], [0, 2, 3], [4, 0, 3], [4, 3, 5]])
        normal = vertex_normals(np.concatenate([flat, wall]), faces)[0]
        assert np.all(np.isfinite(normal))
        assert normal[2] > 0.4
        assert normal[0] < -0.4


def test_vertices_of_no_triangle_have_some_unit_normal() -> None:
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]], dtype=float)
    normals = vertex_normals(positions, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert vertex_areas(positions, np.array([[0, 1, 2]]))[3] == 0


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e6])
def test_triangles_without_area_are_seen_at_any_scale(scale: float) -> None:
    positions = scale * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [0.5, 1e-9, 0]])
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 0, 2], [0, 1, 4], [1, 1, 1]])
    assert solid_faces(positions, faces).tolist() == [True, False, False, False, False]
