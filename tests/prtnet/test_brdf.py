from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet import sh
from prtnet.brdf import (
    GGX,
    AshikhminShirley,
    BlinnPhong,
    CookTorrance,
    Lambert,
    Phong,
    Schlick,
    albedo,
    mirrored,
)
from prtnet.errors import PrtnetError

ALL = [
    Lambert(), Phong(), BlinnPhong(), CookTorrance(), GGX(), Schlick(), AshikhminShirley(),
    Phong(diffuse=(0.1, 0.2, 0.3), specular=(0.5, 0.4, 0.3), exponent=200.0),
    CookTorrance(diffuse=0.2, specular=0.5, roughness=0.15, fresnel=(0.9, 0.6, 0.3)),
    GGX(roughness=0.05, fresnel=1.0), GGX(roughness=1.0), Schlick(isotropy=1.0, roughness=0.9),
    AshikhminShirley(along=500.0, across=3.0),
]  # fmt: skip


def up(count, seed=0, low=0.0):
    """Random directions above the horizon."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(low, 1.0, count)
    phi = rng.uniform(0.0, 2.0 * math.pi, count)
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1)


@pytest.mark.parametrize("brdf", ALL, ids=str)
def test_reciprocal_finite_and_never_negative(brdf):
    light, view = up(5000), up(5000, seed=1)
    value = brdf(light, view)
    assert value.shape == (5000, 3)
    assert np.isfinite(value).all()
    assert (value >= 0.0).all()
    assert value == pytest.approx(brdf(view, light), rel=1e-9, abs=1e-300)


@pytest.mark.parametrize("brdf", ALL, ids=str)
def test_black_below_the_horizon(brdf):
    light, view = up(50), up(50, seed=1)
    down = light * [1.0, 1.0, -1.0]
    for pair in ((down, view), (view, down), (down, -view)):
        assert not brdf(*pair).any()


@pytest.mark.parametrize("brdf", ALL, ids=str)
def test_no_more_light_leaves_than_comes(brdf):
    angles = np.radians([0.0, 20.0, 45.0, 70.0, 85.0])
    for azimuth in (0.0, 0.7, math.pi / 2):
        view = np.stack(
            [np.sin(angles) * math.cos(azimuth), np.sin(angles) * math.sin(azimuth),
             np.cos(angles)], axis=-1,
        )  # fmt: skip
        reflected = albedo(brdf, view)
        if isinstance(brdf, Schlick):  # his facets and shadows do not quite match
            assert (reflected[-1] < 1.3).all()
            reflected = reflected[:-1]
        assert (reflected <= 1.002).all()


def test_closed_forms_along_the_normal():
    normal = np.array([0.0, 0.0, 1.0])
    assert albedo(Lambert((0.1, 0.5, 0.9)), normal) == pytest.approx([0.1, 0.5, 0.9])
    assert albedo(Phong(diffuse=0.25, specular=0.5), normal) == pytest.approx([0.75] * 3, rel=1e-4)
    assert albedo(BlinnPhong(diffuse=0.0, specular=0.4), normal) == pytest.approx(
        [0.4] * 3, rel=1e-3
    )
    base = AshikhminShirley(diffuse=0.5, specular=0.0, along=1.0, across=1.0)
    lobe = dataclasses.replace(base, diffuse=0.0)
    assert albedo(base, normal) - albedo(lobe, normal) == pytest.approx([0.5] * 3, rel=0.05)


@pytest.mark.parametrize("kind", [GGX, CookTorrance])
def test_a_smooth_perfect_mirror_reflects_everything(kind):
    """White furnace: facets are normalised, and little is shadowed."""
    view = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, math.sqrt(0.75)]])
    assert albedo(kind(roughness=0.05, fresnel=1.0), view, rings=1024) == pytest.approx(
        np.ones((2, 3)), abs=0.01
    )


@pytest.mark.parametrize("kind", [GGX, CookTorrance])
@pytest.mark.parametrize("roughness", [0.2, 0.5])
def test_facets_cover_the_surface_once(kind, roughness):
    """∫ D(h) (n·h) dh within 45° of the normal, where light mirrored to it is above the horizon."""
    directions, weights = sh.quadrature(240)
    half = directions[directions[:, 2] > 0.0]
    weight = weights[directions[:, 2] > 0.0]
    normal = np.array([0.0, 0.0, 1.0])
    light = 2.0 * half[:, 2:] * half - normal  # the normal mirrored about each half vector
    keep = light[:, 2] > 0.0
    f = kind(roughness=roughness, fresnel=1.0)(light[keep], normal)[:, 0]
    shadow = np.minimum(1.0, 2.0 * half[keep, 2] * light[keep, 2] / half[keep, 2])
    if kind is GGX:
        alpha2 = roughness**2
        z = light[keep, 2]
        shadow = 2.0 * z / (np.sqrt(alpha2 + (1 - alpha2) * z * z) + z)
    facets = f * 4.0 * light[keep, 2] / shadow
    covered = float((weight[keep] * facets * half[keep, 2]).sum())
    exact = 1.0 / (1.0 + roughness**2) if kind is GGX else 1.0 - math.exp(-1.0 / roughness**2)
    assert covered == pytest.approx(exact, rel=5e-3)


@pytest.mark.parametrize("slope", [0.15, 0.3, 0.3**0.5])
def test_roughness_of_cook_torrance_is_its_slope(slope):
    """Their D, exp(−tan² / m²) / (π m² cos⁴) of the angle of the half vector, seen along the
    normal, where grooves hide nothing of slopes like these."""
    half = np.linspace(0.0, 0.35, 8)
    light = np.stack([np.sin(2 * half), 0 * half, np.cos(2 * half)], axis=-1)
    facets = np.exp(-((np.tan(half) / slope) ** 2)) / (math.pi * slope**2 * np.cos(half) ** 4)
    seen = CookTorrance(roughness=slope, fresnel=1.0)(light, np.tile([0.0, 0.0, 1.0], (8, 1)))
    np.testing.assert_allclose(seen[:, 0], facets / (4.0 * np.cos(2 * half)), rtol=1e-12)


def test_anisotropy_turns_with_the_tangent():
    view = up(1, seed=3, low=0.5)
    light = mirrored(up(200, seed=4, low=0.5))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for one, other in (
        (AshikhminShirley(along=9.0, across=70.0), AshikhminShirley(along=70.0, across=9.0)),
    ):
        assert one(light @ turn.T, view @ turn.T) == pytest.approx(other(light, view))
    scratched = Schlick(isotropy=0.1)
    tilt = math.radians(15.0)
    normal = np.array([0.0, 0.0, 1.0])
    along, across = ([math.sin(tilt), 0.0, math.cos(tilt)], [0.0, math.sin(tilt), math.cos(tilt)])
    assert scratched(np.array(across), normal)[0] > 3.0 * scratched(np.array(along), normal)[0]
    round_one = Schlick(isotropy=1.0)
    assert round_one(light @ turn.T, view @ turn.T) == pytest.approx(round_one(light, view))


@given(
    roughness=st.sampled_from([0.0, 1e-6, 0.3, 1.0]),
    z=st.sampled_from([1e-9, 1e-4, 0.5, 1.0]),
    other=st.sampled_from([1e-9, 1e-4, 0.5, 1.0]),
    phi=st.floats(0.0, 6.28),
)
def test_extremes_stay_finite(roughness, z, other, phi):
    def direction(height, turn):
        r = math.sqrt(1.0 - height * height)
        return np.array([r * math.cos(turn), r * math.sin(turn), height])

    light, view = direction(z, phi), direction(other, 0.0)
    for brdf in (
        GGX(roughness=roughness), CookTorrance(roughness=roughness), BlinnPhong(exponent=1e4),
        Schlick(roughness=roughness, isotropy=roughness), AshikhminShirley(along=1e4, across=0.0),
        Phong(exponent=0.0), Lambert(0.0),
    ):  # fmt: skip
        value = brdf(light, view)
        assert np.isfinite(value).all()
        assert (value >= 0.0).all()


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: GGX(roughness=math.nan), "roughness must be finite"),
        (lambda: GGX(roughness=-1.0), "roughness must be finite, at least 0"),
        (lambda: Phong(exponent=-5.0), "exponent must be finite, at least 0"),
        (lambda: Lambert((0.1, 1.2, 0.3)), "diffuse must be at most 1"),
        (lambda: CookTorrance(fresnel=2.0), "fresnel must be at most 1"),
        (lambda: AshikhminShirley(along=math.inf), "along must be finite"),
    ],
)
def test_parameters_that_no_surface_has_are_refused(make, told):
    with pytest.raises(PrtnetError, match=told):
        make()


def test_a_black_surface_is_black():
    for brdf in (Lambert(0.0), Phong(0.0, 0.0), GGX(specular=0.0), CookTorrance(specular=0.0)):
        assert not brdf(up(20), up(20, seed=1)).any()
