from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet.octahedral import grid_of, looked_up, points

CELLS = 8


def on_the_sphere(values: np.ndarray) -> np.ndarray:
    return values / np.linalg.norm(values, axis=-1, keepdims=True)


@given(u=st.floats(-1.0, 1.0), v=st.floats(-1.0, 1.0))
def test_places_lie_on_the_octahedron_and_are_found_again(u, v):
    where = points(np.array(u), np.array(v))
    assert np.abs(where).sum() == pytest.approx(1.0)
    corners, weights = looked_up(3.0 * where[:, None].astype(np.float32), CELLS)
    row, column = np.divmod(corners[:, 0], CELLS + 1)
    assert weights.sum() == pytest.approx(1.0, abs=1e-6)
    # The place itself, or another that is the same point of an edge.
    back = points(
        weights[:, 0] @ (column * 2.0 / CELLS - 1), weights[:, 0] @ (row * 2.0 / CELLS - 1)
    )
    np.testing.assert_allclose(back, where, atol=1e-5)


@pytest.mark.parametrize("cells", [2, 6, 32])
def test_the_grid_is_a_closed_mesh(cells):
    grid = grid_of(cells)
    count = len(grid.places)
    assert count == cells**2 + 2
    edges = np.sort(np.concatenate([grid.faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    _, uses = np.unique(edges, axis=0, return_counts=True)
    assert (uses == 2).all()
    assert count - len(uses) + len(grid.faces) == 2  # Euler
    corners = grid.places[grid.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outwards = np.einsum("ti,ti->t", normal, corners.mean(axis=1))
    assert (np.sign(outwards) == np.sign(outwards[0])).all()
    assert outwards[0] != 0.0


def test_corners_of_the_table_are_the_vertices():
    grid = grid_of(CELLS)
    row, column = np.divmod(np.arange((CELLS + 1) ** 2), CELLS + 1)
    where = points(column * 2.0 / CELLS - 1.0, row * 2.0 / CELLS - 1.0)
    np.testing.assert_allclose(on_the_sphere(where), grid.places[grid.vertex], atol=1e-12)


def test_a_table_of_a_smooth_function_is_that_function():
    cells = 64
    grid = grid_of(cells)
    table = np.array([0.3, -0.8, 0.5]) @ grid.places[grid.vertex].T
    where = on_the_sphere(np.random.default_rng(0).normal(size=(5000, 3)))
    corners, weights = looked_up(where.T.astype(np.float32), cells)
    found = (weights * table[corners]).sum(axis=0)
    np.testing.assert_allclose(found, where @ [0.3, -0.8, 0.5], atol=6e-3)


def test_areas_of_the_map():
    line = (np.arange(400) + 0.5) / 200 - 1.0
    where = points(*np.meshgrid(line, line))
    area = np.linalg.norm(where, axis=-1) ** -3 / 200**2
    assert area.sum() == pytest.approx(4.0 * math.pi, rel=1e-4)


@pytest.mark.parametrize("cells", [0, 1, 5])
def test_only_even_numbers_of_cells(cells):
    with pytest.raises(ValueError, match="even"):
        grid_of(cells)
