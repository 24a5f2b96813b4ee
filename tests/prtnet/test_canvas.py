from __future__ import annotations

import numpy as np
import pytest
import trimesh.creation as shapes

from prtnet.canvas import Canvas, boxed, plane, vase
from prtnet.scene import face_normals, unit


def box() -> Canvas:
    mesh = shapes.icosphere(3)
    canvas, _ = boxed(mesh.vertices, mesh.vertex_normals, mesh.faces, (0.5, 0.25))
    return canvas


CANVASES = {"plane": lambda: plane(3.0, 0.5), "vase": lambda: vase(5, 0.5), "boxed": box}


@pytest.mark.parametrize("name", CANVASES)
def test_places_grow_along_the_frames(name: str) -> None:
    """u along the tangent, v along the bitangent; triangles face as normals do."""
    canvas = CANVASES[name]()
    assert canvas.places is not None
    middle = canvas.frames[canvas.faces].mean(axis=1)
    corner, place = canvas.positions[canvas.faces], canvas.places[canvas.faces]
    edges, steps = np.diff(corner, axis=1), np.diff(place, axis=1)
    along = np.einsum("tkj,tjc->tkc", edges, middle[..., :2])
    agree = (along * steps).sum(axis=(1, 2))
    lengths = np.linalg.norm(along, axis=(1, 2)) * np.linalg.norm(steps, axis=(1, 2))
    assert (agree / lengths > 0.5).all()
    facing = unit(face_normals(canvas.positions[None], canvas.faces)[0])
    assert (np.einsum("ti,ti->t", facing, middle[..., 2]) > 0.7).all()


def test_a_patch_is_as_wide_as_it_should_be() -> None:
    flat, around = plane(3.0, 0.5), vase(5, 0.5)
    assert flat.places is not None
    assert around.places is not None
    np.testing.assert_allclose(np.ptp(flat.places, axis=0), [3.0, 6.0])
    assert np.ptp(around.places[:, 0]) == pytest.approx(5.0)
    seam = around.positions.reshape(97, 97, 3)
    np.testing.assert_allclose(seam[:, 0], seam[:, -1], atol=1e-12)


def test_twisting_carries_frames_as_triangles_do() -> None:
    """The Jacobian against the deformation of the triangles around."""
    canvas = vase(5)
    twisted = canvas.twisted(1.2)
    carried = canvas.moved(twisted.positions, twisted.normals)
    inside = np.arange(97 * 97).reshape(97, 97)[2:-2, 2:-2].ravel()
    cosine = (carried.frames * twisted.frames).sum(axis=1)[inside]
    assert (cosine > 1.0 - 2e-3).all()
    assert np.abs((canvas.frames * twisted.frames).sum(axis=1)).min() < 0.9
    facing = unit(face_normals(twisted.positions[None], twisted.faces)[0])
    normals = unit(twisted.normals[twisted.faces].mean(axis=1))
    assert (np.einsum("ti,ti->t", facing, normals) > 0.99).all()


def test_a_turn_of_all_turns_frames() -> None:
    canvas = box()
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    moved = canvas.moved(canvas.positions @ turn.T, canvas.normals @ turn.T)
    np.testing.assert_allclose(moved.frames, turn @ canvas.frames, atol=1e-5)


def test_every_side_of_a_box_is_laid_on() -> None:
    mesh = shapes.box()
    normals = np.asarray(mesh.vertex_normals)
    canvas, source = boxed(mesh.vertices, normals, mesh.faces, (0.5, 0.25))
    assert canvas.places is not None
    assert len(canvas.positions) == 24
    np.testing.assert_allclose(canvas.positions, mesh.vertices[source])
    spans = np.ptp(canvas.places[canvas.faces], axis=1)
    np.testing.assert_allclose(spans, np.broadcast_to([2.0, 4.0], spans.shape))
