from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.brdf import GGX, CookTorrance, Lambert, Phong
from prtnet.errors import PrtnetError
from prtnet.factors import factorise, tabulate
from prtnet.operators import cosine_matrix
from prtnet.reflection import ReflectionOperator, reflection_operator
from tests.prtnet.test_brdf import up

SMALL = {"size": 12, "samples": 3}


def operator(brdf, count=8, **orders):
    return reflection_operator(factorise(tabulate(brdf, **SMALL), count), **orders)


@pytest.mark.parametrize("order", [2, 4])
def test_equals_quadrature_of_the_same_signals(order):
    """∫ light · visibility · Σ light factor · view factor, all as the harmonics they are."""
    factors = factorise(tabulate(GGX(diffuse=(0.1, 0.2, 0.3)), **SMALL), 5)
    made = reflection_operator(factors, order, 4)
    rng = np.random.default_rng(0)
    light = rng.normal(size=(6, order**2, 3))
    visibility = rng.normal(size=(6, order**2))
    view = up(6)
    out, weights = sh.quadrature(4 * order)
    rows = sh.evaluate(out, 2 * order - 1)
    lit = np.einsum("di,pic->pdc", rows[:, : order**2], light)
    seen = np.einsum("di,pi->pd", rows[:, : order**2], visibility)
    kernel = factors.projected(2 * order - 1, 4)[0] @ rows.T  # [k, D]
    reflected = np.einsum("bd,pbc->pdc", kernel, made.factors_of(view))
    exact = np.einsum("d,pdc,pd,pdc->pc", weights, lit, seen, reflected)
    assert made.radiance(light, visibility, view) == pytest.approx(exact, rel=1e-4, abs=1e-5)


def test_lambert_is_the_cosine_matrix():
    made = operator(Lambert(1.0), 1, view_order=2)
    seen = made.factors_of(up(20))[:, 0, 0]
    whole = made.matrices[0] * seen.mean() * math.pi
    assert np.ptp(seen) < 1e-3 * seen.mean()
    exact = cosine_matrix(4)
    assert np.abs(whole - exact).max() < 0.02 * np.abs(exact).max()


def test_matrices_are_symmetric_and_a_shadow_is_black():
    made = operator(CookTorrance())
    assert made.order == 4
    assert made.matrices == pytest.approx(made.matrices.swapaxes(1, 2), abs=1e-6)
    light = np.random.default_rng(0).normal(size=(5, 16, 3))
    assert not made.radiance(light, np.zeros((5, 16)), up(5)).any()


def test_end_to_end_against_rays_for_smooth_light():
    """Open surface, light of two bands: what the operator reflects is what quadrature does."""
    brdf = Phong(diffuse=0.3, specular=0.3, exponent=3.0)
    made = operator(brdf, 12, order=4, view_order=6)
    light = np.zeros((16, 3))
    light[0], light[2] = 1.0, [0.2, 0.3, 0.1]
    view = up(40, low=0.2)
    out, weights = sh.quadrature(60)
    shine = sh.evaluate(out, 4) @ light
    cosine = np.maximum(out[:, 2], 0.0)
    exact = np.stack([np.einsum("d,dc,dc->c", weights * cosine, shine, brdf(out, v)) for v in view])
    opened = np.zeros(16)
    opened[0] = math.sqrt(4.0 * math.pi)
    got = made.radiance(np.broadcast_to(light, (40, 16, 3)), np.tile(opened, (40, 1)), view)
    assert np.linalg.norm(got - exact) < 0.03 * np.linalg.norm(exact)


def test_a_material_is_small_and_comes_back():
    made = operator(GGX(diffuse=(0.3, 0.2, 0.1)))
    data = made.packed()
    assert len(data) == 8 * (136 + 48) * 2 < 10_000
    again = ReflectionOperator.unpacked(data, 8)
    for name in ("matrices", "view"):
        own, back = getattr(made, name), getattr(again, name)
        assert np.abs(own - back).max() <= 1e-3 * np.abs(own).max()
    assert np.array_equal(again.matrices, again.matrices.swapaxes(1, 2))
    assert again.packed() == data
    bright = ReflectionOperator(1e6 * made.matrices, made.view)
    with pytest.raises(PrtnetError, match="half precision"):
        bright.packed()
    with pytest.raises(ValueError, match="reshape"):
        ReflectionOperator.unpacked(data[:-2], 8)
    with pytest.raises(ValueError, match="no 8 factors of order 2"):
        ReflectionOperator.unpacked(data, 8, order=2)


def test_a_black_material_reflects_nothing():
    made = operator(Lambert(0.0))
    assert np.isfinite(made.matrices).all()
    light = np.ones((3, 16, 3))
    assert not made.radiance(light, np.ones((3, 16)), up(3)).any()
