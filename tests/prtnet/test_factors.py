from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.brdf import GGX, CookTorrance, Lambert, Phong, Schlick, albedo
from prtnet.factors import factorise, tabulate
from prtnet.hemisphere import cells

SMALL = {"size": 12, "samples": 3}


@pytest.mark.parametrize("mapping", ["concentric", "parabolic"])
def test_a_table_holds_means_of_f_times_the_cosine(mapping):
    brdf = GGX(diffuse=(0.1, 0.3, 0.6), specular=0.4)
    table = tabulate(brdf, 6, 3, mapping)
    out, area = cells(6, 3, mapping)
    for view, light in ((14, 15), (0, 20), (21, 21)):
        weight = area[view][:, None] * area[light]
        if weight.sum() == 0.0:
            assert not table[view, light].any()
            continue
        value = brdf(out[light][None], out[view][:, None]) * out[light][None, :, 2:]
        mean = (weight[..., None] * value).sum(axis=(0, 1)) / weight.sum()
        assert table[view, light] == pytest.approx(mean, rel=1e-5)


def test_the_table_reflects_what_the_brdf_does():
    brdf = Phong(exponent=30.0)
    table = tabulate(brdf, **SMALL)
    out, area = cells(SMALL["size"], SMALL["samples"], "concentric")
    reflected = (area.sum(axis=1)[None, :, None] * table).sum(axis=1)
    views = [70, 40, 5]
    exact = np.stack([albedo(brdf, out[view], 64).mean(axis=0) for view in views])
    assert reflected[views] == pytest.approx(exact, rel=0.01)


def test_lambert_is_one_factor():
    factors = factorise(tabulate(Lambert((0.2, 0.5, 0.8)), **SMALL), 3)
    assert factors.values[1] < 1e-6 * factors.values[0]
    ratio = factors.view[0] / factors.view[0, :, :1]
    assert ratio == pytest.approx(np.broadcast_to([1.0, 2.5, 4.0], ratio.shape), rel=1e-4)


@pytest.mark.parametrize("brdf", [CookTorrance(), Schlick(), GGX(diffuse=(0.3, 0.1, 0.0))], ids=str)
def test_factors_are_the_best_of_their_number(brdf):
    """Eckart and Young: what is left is the rest of the singular values."""
    table = tabulate(brdf, **SMALL)
    errors = []
    for count in (1, 4, 10):
        factors = factorise(table, count)
        errors.append(float(np.square(factors.table() - table).sum()))
        left = float(np.square(factors.values[count:]).sum())
        assert errors[-1] == pytest.approx(left, rel=1e-3)
    assert errors == sorted(errors, reverse=True)
    matrix = table.swapaxes(1, 2).reshape(-1, table.shape[1])
    exact = np.linalg.svd(matrix.astype(np.float64), compute_uv=False)
    assert factorise(table, 2).values[:10] == pytest.approx(exact[:10], rel=1e-6)


def test_a_clamped_table_is_clamped_and_a_black_one_black():
    table = tabulate(GGX(roughness=0.1), **SMALL)
    assert table.max() > 3.0
    factors = factorise(table, 144, most=3.0)
    assert factors.table().max() < 3.01
    nothing = factorise(tabulate(Lambert(0.0), **SMALL), 4)
    assert not nothing.table().any()
    assert np.isfinite(nothing.light).all()


def test_projections_are_integrals_and_least_squares():
    factors = factorise(tabulate(GGX(), **SMALL), 4)
    light, view = factors.projected(5, 5)
    out, area = cells(12, 4, "concentric")
    rows = sh.evaluate(out.reshape(-1, 3), 5)
    exact = np.repeat(factors.light, 16, axis=1) * area.ravel() @ rows
    assert light == pytest.approx(exact, abs=1e-5 * np.abs(exact).max())
    shown = np.einsum("ji,bic->bjc", rows, view)
    wanted = np.repeat(factors.view, 16, axis=1)
    error = np.linalg.norm(shown - wanted) / np.linalg.norm(wanted)
    assert error < 0.15
    rng = np.random.default_rng(0)
    for _ in range(3):  # nothing near is nearer
        other = view + 1e-3 * np.abs(view).max() * rng.normal(size=view.shape)
        shown = np.einsum("ji,bic->bjc", rows, other)
        assert np.linalg.norm(shown - wanted) / np.linalg.norm(wanted) > error


def test_light_below_the_horizon_is_not_reflected():
    light, _ = factorise(tabulate(Lambert(1.0), **SMALL), 1).projected(9, 2)
    normal, under = (sh.evaluate(np.array([0.0, 0.0, z]), 9) @ light[0] for z in (1.0, -1.0))
    assert abs(under) < 0.05 * abs(normal)
    assert light[0, 2] / light[0, 0] == pytest.approx(math.sqrt(3.0) * 2.0 / 3.0, rel=0.02)
