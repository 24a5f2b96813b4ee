from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from prtnet import sh
from prtnet.brdf import (
    BRDF,
    GGX,
    AshikhminShirley,
    BlinnPhong,
    CookTorrance,
    Lambert,
    Phong,
    Schlick,
    albedo,
)
from prtnet.brdf_sampling import BRDFSampler, brdf_sampler
from prtnet.merl import SHAPE, Measured
from prtnet.sampling import lattice

MEASURED = np.zeros((*SHAPE, 3), dtype=np.float32)
MEASURED += 0.1 + 4.0 * np.exp(-((np.arange(90) / 30.0) ** 2))[:, None, None, None]
BRDFS: list[BRDF] = [
    Lambert(), Phong(), BlinnPhong(), CookTorrance(), GGX(), GGX(roughness=0.02), Schlick(),
    AshikhminShirley(), AshikhminShirley(along=5.0, across=2000.0), Measured(MEASURED),
]  # fmt: skip
VIEWS = np.array([[0.0, 0.0, 1.0], [0.5, -0.4, 0.75], [-0.3, 0.85, 0.4], [0.9, 0.3, 0.05]])
VIEWS /= np.linalg.norm(VIEWS, axis=1, keepdims=True)
COUNT = 1 << 14


@pytest.mark.parametrize("brdf", BRDFS, ids=lambda brdf: brdf.name)
def test_draws_follow_the_density(brdf):
    """Means over draws above the horizon are integrals of the density there."""
    sampler = BRDFSampler(brdf)
    z, weight = np.polynomial.legendre.leggauss(500)
    turn = np.arange(1000) * (2 * np.pi / 1000)
    z, weight = (z + 1) / 2, weight / 2
    sine = np.sqrt(1 - z**2)[:, None]
    grid = np.stack(np.broadcast_arrays(sine * np.cos(turn), sine * np.sin(turn), z[:, None]), -1)
    grid, weight = grid.reshape(-1, 3), np.repeat(weight * 2 * np.pi / 1000, 1000)
    for view in VIEWS[1:3]:
        share = weight * sampler.density(grid, np.broadcast_to(view, grid.shape))
        expected = share @ sh.evaluate(grid, 5)
        drawn = sampler.draw(np.broadcast_to(view, (COUNT, 3)), lattice(COUNT))
        assert np.linalg.norm(drawn, axis=1) == pytest.approx(np.ones(COUNT))
        above = drawn[drawn[:, 2] > 0.0]
        found = sh.evaluate(above, 5).sum(axis=0) / COUNT
        assert len(above) / COUNT == pytest.approx(share.sum(), abs=0.02)
        assert found == pytest.approx(expected, abs=0.02 * np.abs(expected).max())


@pytest.mark.parametrize("brdf", BRDFS, ids=lambda brdf: brdf.name)
def test_the_albedo_is_what_draws_say(brdf):
    """∫ f cos by f cos/p: the same as by quadrature, and the terms do not spread far."""
    sampler = BRDFSampler(brdf)
    for view in VIEWS[1:3]:
        same = np.broadcast_to(view, (COUNT, 3))
        drawn = sampler.draw(same, lattice(COUNT))
        above = drawn[:, 2] > 1e-9
        drawn, same = drawn[above], same[above]
        value = brdf(drawn, same) * (drawn[:, 2] / sampler.density(drawn, same))[:, None]
        expected = albedo(brdf, view, 512)
        assert value.sum(axis=0) / COUNT == pytest.approx(expected, rel=0.02)
        assert np.sqrt((value[:, 0] ** 2).sum() / COUNT) < 1.7 * expected[0]


def test_a_narrow_highlight_is_drawn_by_nearly_all():
    """A tenth of a degree wide: even directions would find it once in a million."""
    view = np.broadcast_to(VIEWS[1], (COUNT, 3))
    drawn = BRDFSampler(GGX(roughness=2e-3)).draw(view, lattice(COUNT))
    mirror = VIEWS[1] * [-1, -1, 1]
    assert np.mean(drawn @ mirror > np.cos(np.radians(2.0))) > 0.9


def test_isotropic_draws_turn_with_the_view():
    sampler = BRDFSampler(GGX())
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    view = np.broadcast_to(VIEWS[1], (50, 3))
    drawn = sampler.draw(view, lattice(50))
    turned = sampler.draw(view @ turn.T, lattice(50))
    assert turned == pytest.approx(drawn @ turn.T, abs=1e-9)
    again = sampler.density(drawn @ turn.T, view @ turn.T)
    assert again == pytest.approx(sampler.density(drawn, view), rel=1e-6)


def test_a_sampler_is_made_once_and_goes_with_its_brdf():
    brdf = GGX()
    sampler = weakref.ref(brdf_sampler(brdf))
    assert brdf_sampler(GGX()) is sampler()
    assert brdf_sampler(GGX(roughness=0.5)) is not sampler()
    del brdf
    gc.collect()
    assert sampler() is None
