from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.all_frequency_factors import row_factors
from prtnet.brdf import GGX, CookTorrance, Lambert, Schlick
from prtnet.factors import factorise, tabulate
from prtnet.hemisphere import cells, directions


def left(brdf, rows, most=3.0):
    """The share of the clamped table's squares that is left, and what clamping takes: summed up."""
    found = row_factors(brdf, rows)
    table = tabulate(brdf, 32, 2).astype(np.float64)
    kept = np.minimum(table, most)
    out, area = cells(32, 4, "concentric")
    weight = (area * out[..., 2]).sum(axis=1)
    product = np.einsum("bs,bvc->vsc", found.light, found.view)
    missed, whole, all_ = (
        np.einsum("v,vsc->", weight, one**2) for one in (product - kept, kept, table)
    )
    return found, missed / whole, 1.0 - whole / all_


@pytest.mark.parametrize(
    ("brdf", "rows"), [(GGX(diffuse=(0.3, 0.1, 0.2), roughness=0.5), 4), (Schlick(), 10)]
)
def test_the_error_is_what_the_products_leave(brdf, rows):
    found, missed, taken = left(brdf, rows)
    assert found.rows == rows
    assert found.light.shape == (rows, 1024)
    assert found.view.shape == (rows, 1024, 3)
    assert found.light.dtype == found.view.dtype == np.float32
    assert found.error == pytest.approx(missed, rel=1e-4)
    assert found.clamped == pytest.approx(taken, abs=1e-6)
    assert found.facts()["rows"] == rows


def test_more_rows_leave_less():
    brdf = CookTorrance(roughness=0.4, fresnel=0.5)
    errors = [row_factors(brdf, rows).error for rows in (1, 10, 1024)]
    assert (np.diff(errors) < 0).all()
    assert errors[1] < 0.13
    assert errors[2] < 1e-12


def test_views_that_a_picture_shows_come_out_better_than_by_the_plain_decomposition():
    brdf = CookTorrance(roughness=0.4, fresnel=0.5)
    table = np.minimum(tabulate(brdf, 32, 2), 3.0)
    out, area = cells(32, 4, "concentric")
    weight = (area * out[..., 2]).sum(axis=1)
    plain = factorise(table, 10).table()
    missed, whole = (np.einsum("v,vsc->", weight, one**2) for one in (plain - table, table))
    assert row_factors(brdf, 10).error < 0.85 * missed / whole


def test_a_diffuse_brdf_is_one_exact_row():
    found = row_factors(Lambert((0.2, 0.4, 0.8)), 10)
    assert found.light is None
    assert found.error == found.clamped == 0.0
    np.testing.assert_allclose(found.view, np.array([[[0.2, 0.4, 0.8]]]) / math.pi, rtol=1e-6)
    d = sh.fibonacci_sphere(400)
    np.testing.assert_allclose(found.at(d)[:, 0], np.maximum(d[:, 2], 0.0), atol=1e-6)


def test_light_factors_between_the_middles_of_cells():
    found = row_factors(GGX(roughness=0.5), 3)
    line = (2.0 * np.arange(32) + 1.0) / 32 - 1.0
    middles, _ = directions(np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2), "concentric")
    np.testing.assert_allclose(found.at(middles), found.light.T, atol=1e-5)
    between, _ = directions(np.array([[0.0, 0.0]]), "concentric")
    four = found.light.T.reshape(32, 32, 3)[15:17, 15:17].mean(axis=(0, 1))
    np.testing.assert_allclose(found.at(between)[0], four, rtol=1e-5)
    d = sh.fibonacci_sphere(40000)
    mean = (4 * math.pi / len(d)) * found.at(d).sum(axis=0)
    np.testing.assert_allclose(mean, found.light.sum(axis=1) * 2 * math.pi / 1024, atol=1e-4)
    assert not found.at(d[d[:, 2] <= 0]).any()


@pytest.mark.parametrize("rows", [0, 1025])
def test_number_of_rows(rows):
    with pytest.raises(ValueError, match="factors"):
        row_factors(GGX(), rows)
