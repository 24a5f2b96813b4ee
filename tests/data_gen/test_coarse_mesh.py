from __future__ import annotations

import numpy as np
import pytest
import trimesh

from data_gen.coarse_mesh import coarser
from data_gen.static_mesh import StaticMesh, clean_mesh


def torus(scale: float = 1.0) -> StaticMesh:
    mesh = trimesh.creation.torus(1.0, 0.4, major_sections=60, minor_sections=30)
    return clean_mesh("torus", scale * np.asarray(mesh.vertices), np.asarray(mesh.faces))


@pytest.mark.parametrize("count", [1000, 400])
@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_so_many_vertices_on_the_same_surface(count: int, scale: float) -> None:
    found = coarser(torus(scale), count)
    assert len(found.positions) == count
    place = found.positions / scale
    ring = np.hypot(place[:, 0], place[:, 1]) - 1.0
    away = np.abs(np.hypot(ring, place[:, 2]) - 0.4)
    assert np.sqrt(np.mean(away**2)) < 0.003  # 0.004 where vertices are not set back on it
    # Closed, of the same genus, and normals outwards.
    mesh = trimesh.Trimesh(found.positions, found.faces, process=False)
    assert mesh.is_watertight
    assert mesh.euler_number == 0
    outwards = np.stack([ring * place[:, 0], ring * place[:, 1], place[:, 2]], axis=1)
    assert (np.sum(outwards * found.normals, axis=1) > 0).all()


def test_split_vertices_come_together() -> None:
    fine = trimesh.creation.icosphere(subdivisions=3)
    apart = np.asarray(fine.triangles).reshape(-1, 3)
    mesh = clean_mesh("ball", apart, np.arange(len(apart)).reshape(-1, 3))
    found = coarser(mesh, 200)
    assert len(found.positions) == 200
    assert trimesh.Trimesh(found.positions, found.faces, process=False).is_watertight


def test_a_mesh_that_is_coarse_enough_stays() -> None:
    mesh = torus()
    assert coarser(mesh, 1800) is mesh
    assert coarser(mesh, 5000) is mesh


def test_edges_of_three_triangles_and_stray_vertices() -> None:
    plane = trimesh.creation.box((1.0, 1.0, 0.2)).subdivide().subdivide().subdivide()
    wing = np.asarray(plane.vertices)[np.asarray(plane.faces)[0]]
    places = np.concatenate([plane.vertices, [wing.mean(axis=0) + 0.3], [[9.0, 9.0, 9.0]]])
    extra = [[*np.asarray(plane.faces)[0][:2], len(plane.vertices)]]
    mesh = clean_mesh("wing", places, np.concatenate([plane.faces, extra]))
    found = coarser(mesh, 100)
    assert len(found.positions) == 100
    assert np.isfinite(found.positions).all()
