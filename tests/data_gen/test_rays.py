from __future__ import annotations

import numpy as np
import trimesh.creation as shapes

from data_gen.rays import BORDER_PULL, border_operator, departure
from prtnet.scene import Receivers
from tests.data_gen.meshes import flat, quad, smooth


def receivers_of(count: int, two_sided: bool = False) -> Receivers:
    every = np.arange(count, dtype=np.int32)
    side = np.ones(count, dtype=np.int8)
    if two_sided:
        return Receivers(np.tile(every, 2), np.concatenate([side, -side]), every)
    return Receivers(every, side, every)


def test_receivers_inside_a_surface_leave_along_their_normals() -> None:
    positions, faces, normals = smooth(shapes.icosphere(2))
    operator = border_operator(faces, receivers_of(len(positions)))
    assert operator.nnz == 0
    np.testing.assert_array_equal(departure(normals, operator @ positions), normals)


def test_receivers_on_a_border_are_pulled_inwards() -> None:
    positions, faces, normals = flat(shapes.box())
    operator = border_operator(faces, receivers_of(len(positions)))
    away = departure(normals, operator @ positions)
    pull = away - normals
    np.testing.assert_allclose(np.sum(pull * normals, axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(pull, axis=1), BORDER_PULL)
    centroids = np.repeat(positions[faces].mean(axis=1), 3, axis=0)
    assert (np.sum(pull * (centroids - positions), axis=1) > 0).all()


def test_only_the_rim_of_a_patch_is_a_border() -> None:
    """A fan of four triangles: its middle is surrounded, its corners are not."""
    corners = quad([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)])[0]
    positions = np.concatenate([corners, [[0.5, 0.5, 0.0]]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    inward = border_operator(faces, receivers_of(5)) @ positions
    np.testing.assert_array_equal(inward[4], 0.0)
    np.testing.assert_allclose(inward[0], [1 / 3, 1 / 3, 0])  # the mean of its two centroids


def test_backs_are_pulled_as_their_fronts() -> None:
    positions, faces, _ = flat(shapes.box())
    inward = border_operator(faces, receivers_of(len(positions), two_sided=True)) @ positions
    front, back = np.split(inward, 2)
    np.testing.assert_array_equal(front, back)
    assert (np.linalg.norm(front, axis=1) > 0).all()


def test_a_pull_along_the_normal_is_none() -> None:
    normal = np.array([[0.0, 0.0, 1.0]])
    np.testing.assert_array_equal(departure(normal, np.array([[0.0, 1e-9, 0.3]])), normal)
