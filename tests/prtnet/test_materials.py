from __future__ import annotations

import numpy as np
import pytest

from prtnet import sh
from prtnet.brdf import GGX, AshikhminShirley, CookTorrance, Lambert, Phong, Schlick
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.factors import factorise, harmonic_factors, symmetries, tabulate
from prtnet.materials import BRDFS, PRESETS, SAMPLES, brdf_named, material
from prtnet.one_dimensional import OneDimensional
from prtnet.reflection import operator_of, reflection_operator


def test_names_stand_for_brdfs_and_their_parameters():
    assert brdf_named("gold") == PRESETS["gold"]
    assert brdf_named("phong: exponent = 40") == Phong(exponent=40.0)
    assert brdf_named("ggx:roughness=0.2,fresnel=1/0.77/0.34") == GGX(
        roughness=0.2, fresnel=(1.0, 0.77, 0.34)
    )
    assert brdf_named("gold:roughness=0.7") == GGX(roughness=0.7, fresnel=(1.0, 0.77, 0.34))
    assert {brdf_named(name).name for name in BRDFS} == set(BRDFS)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("gild", "did you mean 'gold'"),
        ("ggx:rough=0.2", "did you mean 'roughness'"),
        ("ggx:roughness", "NAME=VALUE"),
        ("ggx:roughness=a", "neither a number nor a colour"),
        ("ggx:roughness=1/2", "neither a number nor a colour"),
        ("ggx:roughness=2", "at most 1"),
        ("ggx:roughness=0.1/0.2/0.3", "is one number, no colour"),
        ("x" * 5000, "neither a BRDF nor a file"),
        ("phong:exponent=nan", "must be finite"),
        ("lobe", "of models that --kind lobes trained"),
        ("lobe:exponent=3", "of visibility in zonal lobes"),
        ("missing.binary", "does not exist"),
        ("pyproject.toml", "is no MERL file"),
    ],
)
def test_what_stands_for_nothing_is_said(text, told):
    with pytest.raises(PrtnetError, match=told):
        brdf_named(text)


def test_lobes_have_a_material_of_their_own():
    found = brdf_named("lobe:exponent=7.5,transmitted=0.1/0.2/0.3", of_lobes=True)
    assert found == OneDimensional(exponent=7.5, transmitted=(0.1, 0.2, 0.3))
    assert brdf_named("gold", of_lobes=True) == PRESETS["gold"]
    with pytest.raises(PrtnetError, match="did you mean 'lobe'"):
        brdf_named("lobes", of_lobes=True)
    with pytest.raises(PrtnetError, match="transmitted must be at most 1"):
        brdf_named("lobe:transmitted=1.5", of_lobes=True)


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_a_diffuse_material_is_exact(order):
    rng = np.random.default_rng(order)
    light, visibility = rng.normal(size=(2, order**2))
    directions, weights = sh.quadrature(400)
    rows = sh.evaluate(directions, order)
    product = weights * np.maximum(directions[:, 2], 0.0) * (rows @ light) * (rows @ visibility)
    exact = np.array([0.2, 0.5, 0.8]) / np.pi * product.sum()
    operator = material(Lambert((0.2, 0.5, 0.8)), order=order)
    view = np.array([0.6, 0.0, 0.8])
    got = operator.radiance(np.repeat(light[:, None], 3, 1), visibility, view)
    assert got == pytest.approx(exact, rel=1e-3, abs=1e-4)
    assert len(operator.matrices) == 1


def test_other_materials_are_their_factors():
    operator = material(Phong(), 3, 3, 2)
    same = operator_of(*harmonic_factors(tabulate(Phong(), samples=SAMPLES), 3, 5, 2), 3)
    assert np.array_equal(operator.matrices, same.matrices)
    assert operator.view.shape == (3, 4, 3)


@pytest.mark.parametrize("mapping", ["concentric", "parabolic"])
@pytest.mark.parametrize("brdf", [CookTorrance(), Schlick(), AshikhminShirley()], ids=str)
def test_cells_alike_by_symmetry_have_the_same_numbers(brdf, mapping):
    class Plain(type(brdf)):
        turns = mirrors = False

    plain = Plain(**vars(brdf))
    expected = tabulate(plain, 6, 2, mapping)
    assert tabulate(brdf, 6, 2, mapping) == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_symmetries_are_as_many_as_there_are():
    assert [len(symmetries(4, *pair)) for pair in ((0, 0), (0, 1), (1, 0), (1, 1))] == [1, 4, 4, 8]
    for moved in symmetries(4, True, True):
        assert sorted(moved) == list(range(16))


@pytest.mark.parametrize("name", ["copper", "satin", "plastic"])
def test_factors_for_order_limited_light_err_less_than_the_plain_ones(name):
    """Of an open ball in a picture, against the integral itself."""
    brdf = brdf_named(name)
    views = sh.fibonacci_hemisphere(60)
    views = views[views[:, 2] > 0.1]
    directions = sh.fibonacci_hemisphere(4096)
    light = environment("studio").harmonics(4)
    arriving = sh.evaluate(directions, 4) @ light * directions[:, 2:] * (2 * np.pi / 4096)
    exact = np.stack([(brdf(directions, view[None]) * arriving).sum(axis=0) for view in views])
    visibility = np.eye(16)[0] * np.sqrt(4 * np.pi)

    def error(operator):
        seen = operator.radiance(light, visibility, views)
        return np.sqrt((views[:, 2:] * (seen - exact) ** 2).sum())

    table = tabulate(brdf, samples=SAMPLES)
    plain = reflection_operator(factorise(table, 8), 4, 4)
    assert error(material(brdf)) < 0.6 * error(plain)
    # With all the factors that such light can tell apart, bands of the view are what is left.
    every = operator_of(*harmonic_factors(table, 49, 7, 8), 4)
    assert error(every) < 0.3 * error(material(brdf))


def test_factors_are_at_least_one_and_at_most_what_light_tells_apart():
    with pytest.raises(ValueError, match="at least one factor"):
        material(brdf_named("phong"), 0)
    assert len(material(brdf_named("phong"), 60, 2).matrices) == 9
