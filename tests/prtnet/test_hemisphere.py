from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet.hemisphere import cells, directions, places

BOTH = ("concentric", "parabolic")


@given(x=st.floats(-1.0, 1.0), y=st.floats(-1.0, 1.0), mapping=st.sampled_from(BOTH))
def test_there_and_back(x, y, mapping):
    out, area = directions(np.array([x, y]), mapping)
    assert np.linalg.norm(out) == pytest.approx(1.0)
    if mapping == "concentric":
        assert out[2] >= 0.0
    if out[2] >= 0.0:
        assert places(out, mapping) == pytest.approx(np.array([x, y]), abs=1e-6)
    assert (area > 0.0) == (out[2] > 0.0 or mapping == "concentric")


@pytest.mark.parametrize("mapping", BOTH)
@pytest.mark.parametrize(("size", "samples"), [(32, 4), (7, 3)])
def test_cells_cover_the_hemisphere(mapping, size, samples):
    out, area = cells(size, samples, mapping)
    assert out.shape == (size**2, samples**2, 3)
    near = {"concentric": 1e-9, "parabolic": 0.02}[mapping]
    assert area.sum() == pytest.approx(2.0 * math.pi, rel=near)
    assert (area * out[..., 2]).sum() == pytest.approx(math.pi, rel=0.02)
    assert np.abs((area[..., None] * out).sum(axis=(0, 1))[:2]).max() < 1e-9


@pytest.mark.parametrize("mapping", BOTH)
def test_a_cell_is_where_it_says(mapping):
    out, area = cells(8, 5, mapping)
    seen = area > 0
    place = places(out, mapping)
    column, row = np.moveaxis(np.clip(((place + 1.0) * 4.0).astype(int), 0, 7), -1, 0)
    expected = np.broadcast_to(np.arange(64)[:, None], seen.shape)
    assert np.array_equal((row * 8 + column)[seen], expected[seen])


def test_the_concentric_map_preserves_area():
    step = 1e-5
    rng = np.random.default_rng(0)
    at = rng.uniform(-0.99, 0.99, (200, 2))
    at = at[np.abs(np.abs(at[:, 0]) - np.abs(at[:, 1])) > 1e-3]  # not on a crease
    for mapping in BOTH:
        here, area = directions(at, mapping)
        along = [(directions(at + step * np.eye(2)[k], mapping)[0] - here) / step for k in range(2)]
        measured = np.linalg.norm(np.cross(*along), axis=-1)
        seen = here[:, 2] > 0.0
        assert measured[seen] == pytest.approx(area[seen], rel=1e-3)
