from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.brdf import GGX, Lambert, Schlick
from prtnet.factors import tabulate
from prtnet.glossy import brdf_rows, cell_integrals
from prtnet.hemisphere import cells

ORDER = 3


def table_of_views(brdf: object) -> np.ndarray:
    """B of equation 14, (V, 3, n²)."""
    table = tabulate(brdf, 32, 2)  # type: ignore[arg-type]
    return np.moveaxis(table, 2, 1).astype(float) @ cell_integrals(32, ORDER)


def test_cell_integrals_add_up_to_the_hemisphere() -> None:
    upper = np.append([math.sqrt(4 * math.pi)], np.zeros(ORDER**2 - 1)) - sh.lower_hemisphere(ORDER)
    np.testing.assert_allclose(cell_integrals(32, ORDER).sum(axis=0), upper, atol=2e-4)


def test_all_rows_are_the_whole_table() -> None:
    brdf = GGX(diffuse=(0.5, 0.1, 0.2), specular=0.5, roughness=0.4)
    rows = brdf_rows(brdf, ORDER**2, ORDER)
    product = np.einsum("bvc,bj->vcj", rows.view, rows.harmonics(ORDER))
    np.testing.assert_allclose(product, table_of_views(brdf), atol=1e-6)


def test_error_is_that_of_the_values_left_out() -> None:
    brdf = Schlick(specular=0.8, roughness=0.2, isotropy=0.3, fresnel=0.7)
    truth = table_of_views(brdf)
    out, area = cells(32, 4, "concentric")
    weight = (area * out[..., 2]).sum(axis=1)
    for count in (1, 3, 5):
        rows = brdf_rows(brdf, count, ORDER)
        product = np.einsum("bvc,bj->vcj", rows.view, rows.harmonics(ORDER))
        missed = np.einsum("v,vcj->", weight, (product - truth) ** 2)
        left = np.sum(rows.values[count:] ** 2)
        assert missed == pytest.approx(left, rel=1e-6)


def test_views_weigh_no_row_more_than_another() -> None:
    """u is orthonormal over views by the cosine: errors of rows are errors of what is seen."""
    rows = brdf_rows(GGX(diffuse=(0.5, 0.1, 0.2), roughness=0.4), 4, ORDER)
    out, area = cells(32, 4, "concentric")
    weight = (area * out[..., 2]).sum(axis=1)
    gram = np.einsum("v,bvc,dvc->bd", weight, rows.view, rows.view)
    np.testing.assert_allclose(gram, np.eye(4), atol=1e-9)
    left = np.linalg.norm(brdf_rows(GGX(), ORDER**2, ORDER).harmonics(ORDER), axis=1)
    np.testing.assert_allclose(left, brdf_rows(GGX(), 1, ORDER).values, rtol=1e-6, atol=1e-9)


def test_matte_has_one_row_that_is_the_cosine() -> None:
    rows = brdf_rows(Lambert(0.6), 1, ORDER)
    exact = np.einsum("bvc,bj->vcj", rows.view, rows.harmonics(ORDER))
    assert rows.values[1] < 1e-6 * rows.values[0]
    cosine = np.zeros(ORDER**2)
    cosine[0], cosine[2] = math.sqrt(math.pi) / 2, math.sqrt(math.pi / 3)
    cosine[6] = math.sqrt(5 * math.pi) / 8
    # Means within cells lose half a per cent of band 2.
    np.testing.assert_allclose(exact[:, 0], np.tile(0.6 / math.pi * cosine, (1024, 1)), atol=5e-4)
    assert np.isfinite(brdf_rows(Lambert(0.6), 3, ORDER).view).all()


def test_light_functions_are_found_at_directions() -> None:
    rows = brdf_rows(GGX(roughness=0.5), 4, ORDER)
    d = sh.fibonacci_hemisphere(20000)
    mean = 2 * math.pi / len(d) * rows.at(d) @ sh.evaluate(d, ORDER)
    np.testing.assert_allclose(mean, rows.harmonics(ORDER), atol=2e-3 * np.abs(mean).max())


@pytest.mark.parametrize("count", [0, 10])
def test_number_of_rows(count: int) -> None:
    with pytest.raises(ValueError, match="rows"):
        brdf_rows(Lambert(), count, ORDER)
