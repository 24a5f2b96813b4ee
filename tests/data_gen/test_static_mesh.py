from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import trimesh.creation as shapes

from data_gen.static_mesh import clean_mesh, read_mesh
from prtnet.errors import PrtnetError

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def complaint(path: Path) -> str:
    with pytest.raises(PrtnetError) as caught:
        read_mesh(path)
    assert "\n" not in str(caught.value)
    return caught.value.message


@pytest.mark.parametrize("ending", [".ply", ".obj", ".stl", ".off"])
def test_files_of_a_ball(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"ball{ending}"
    shapes.icosphere(2).export(path)
    mesh = read_mesh(path)
    assert len(mesh.faces) == 320
    assert mesh.dropped == (0, 0)
    out = mesh.positions / np.linalg.norm(mesh.positions, axis=1, keepdims=True)
    np.testing.assert_allclose(np.sum(mesh.normals * out, axis=1), 1, atol=0.03)
    np.testing.assert_allclose(np.sum(mesh.normals * mesh.tangents, axis=1), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(mesh.tangents, axis=1), 1, atol=1e-6)


def test_normals_of_the_file_count(tmp_path: Path) -> None:
    given = np.tile([0.6, 0.0, 0.8], (4, 1))
    path = tmp_path / "a.ply"
    trimesh.Trimesh(CORNERS, SQUARE, vertex_normals=given, process=False).export(
        path, vertex_normal=True
    )
    np.testing.assert_allclose(read_mesh(path).normals, given, atol=1e-6)


def test_animated_scenes_are_baked_at_rest(shared_data: Path) -> None:
    mesh = read_mesh(shared_data / "fox.glb")
    assert len(mesh.positions) == 1728
    assert mesh.faces.shape == (576, 3)


def test_what_cannot_be_lit_is_dropped() -> None:
    stray = np.array([[9, 9, 9], [np.nan, 0, 0], [0.5, 0, 0]])
    faces = np.concatenate([SQUARE, [[0, 1, 6], [1, 1, 2], [6, 0, 0]]])
    mesh = clean_mesh("a", np.concatenate([CORNERS, stray]), faces)
    assert mesh.dropped == (3, 3)
    np.testing.assert_array_equal(mesh.faces, SQUARE)
    np.testing.assert_array_equal(mesh.positions, CORNERS)
    np.testing.assert_allclose(mesh.normals, np.tile([0, 0, 1], (4, 1)), atol=1e-6)


def test_triangles_that_float32_flattens_are_dropped() -> None:
    thin = np.array([[1e4, 0, 0], [1e4 + 1e-5, 0, 0], [1e4, 1, 0]])
    mesh = clean_mesh("a", np.concatenate([CORNERS, thin]), np.concatenate([SQUARE, [[4, 5, 6]]]))
    assert mesh.dropped == (1, 3)


def test_bad_normals_are_made_anew() -> None:
    normals = np.array([[0, 0, 0], [np.nan, 0, 1], [0, 0, 2], [0, 0.6, 0.8]])
    mesh = clean_mesh("a", CORNERS, SQUARE, normals)
    expected = [[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0.6, 0.8]]
    np.testing.assert_allclose(mesh.normals, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("positions", "faces", "why"),
    [
        (CORNERS, SQUARE[:0], "no triangle"),
        (CORNERS, np.array([[0, 1, 1]]), "no triangle"),
        (CORNERS, np.array([[0, 1, 4]]), "not there"),
        (CORNERS, np.array([[0, 1, -1]]), "not there"),
        (CORNERS * [np.nan, 1, 1], SQUARE, "finite"),
        (np.where(CORNERS == 1, np.inf, CORNERS), SQUARE, "finite"),
    ],
)
def test_meshes_that_cannot_be_lit(positions: np.ndarray, faces: np.ndarray, why: str) -> None:
    with pytest.raises(PrtnetError, match=why):
        clean_mesh("a", positions, faces)


def test_files_that_are_no_meshes(tmp_path: Path) -> None:
    assert "does not exist" in complaint(tmp_path / "a.ply")
    for ending in (".ply", ".obj", ".stl", ".off"):
        path = tmp_path / f"a{ending}"
        for data in (b"", b"nonsense", b"ply\nformat ascii 1.0\nelement vertex 3\n"):
            path.write_bytes(data)
            assert complaint(path)
    path = tmp_path / "points.ply"
    trimesh.PointCloud(CORNERS).export(path)
    assert complaint(path)
