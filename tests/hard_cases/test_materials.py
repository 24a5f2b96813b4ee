"""Materials and lights under torture: each a finite picture, the same from both renderers."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.materials import BRDFS, brdf_named, material
from prtnet.reflection import ReflectionOperator
from prtnet.zh import exact_lobes
from prtnet.zh_fit import fit_lobes
from runtime.draw import opened, render_material
from runtime.reflected import Side, Subject, outgoing_radiance
from tests.runtime.scenes import frames_of, knot_subject, sky, three_quarters

SIZE = (48, 36)
RENDERERS = ["cpu", pytest.param("gl", marks=pytest.mark.gl)]
EXTREMES = (
    "ggx:roughness=0", "ggx:roughness=1", "cook-torrance:roughness=0", "cook-torrance:roughness=1",
    "schlick:roughness=0,isotropy=0", "phong:exponent=0", "phong:exponent=100000",
    "ashikhmin-shirley:along=0,across=100000",
)  # fmt: skip


@functools.cache
def made(text: str) -> ReflectionOperator:
    return material(brdf_named(text), 8)


def picture(name: str, subject: Subject, light: np.ndarray, operator: ReflectionOperator):
    with opened(name) as renderer:
        camera = three_quarters(subject, SIZE)
        return render_material(renderer, subject, exact_lobes(light.T), operator, camera, SIZE)


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("text", EXTREMES)
def test_smooth_and_rough_to_the_end(name, text):
    drawn = picture(name, knot_subject(), sky(), made(text))
    assert np.isfinite(drawn).all()
    assert drawn[..., :3].max() > 0.0


@pytest.mark.parametrize("text", EXTREMES)
def test_extremes_survive_half_precision(text):
    operator = made(text)
    data = operator.packed()
    assert len(data) <= 10_000
    again = ReflectionOperator.unpacked(data, 8)
    assert np.isfinite(again.matrices).all()
    scale = np.abs(operator.matrices).max()
    assert np.abs(again.matrices - operator.matrices).max() <= 1e-3 * scale


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("kind", sorted(set(BRDFS) - {"ashikhmin-shirley"}))  # its coat stays
def test_a_black_material_is_black(name, kind):
    fields = {"diffuse", "specular"} & set(BRDFS[kind].__dataclass_fields__)
    black = ",".join(f"{field}=0" for field in sorted(fields))
    operator = made(f"{kind}:{black}")
    drawn = picture(name, knot_subject(detail=1), sky(), operator)
    assert np.isfinite(drawn).all()
    assert np.abs(drawn[..., :3]).max() < 1e-6
    assert drawn[..., 3].max() == 1.0


@pytest.mark.gl
def test_negative_factors_are_as_good_as_others():
    operator = made("gold")
    turned = ReflectionOperator(-operator.matrices, -operator.view)
    one, other = (picture("gl", knot_subject(), sky(), each) for each in (operator, turned))
    assert one == pytest.approx(other, abs=1e-6)


@pytest.mark.parametrize("name", RENDERERS)
def test_no_light_at_all(name):
    dark = Environment(Picture(np.zeros((4, 8, 3), dtype=np.float32)))
    light = dark.harmonics(4)
    drawn = picture(name, knot_subject(detail=1), light, material(brdf_named("matte")))
    assert not drawn[..., :3].any()
    assert np.isfinite(fit_lobes(light.T, 3).harmonics()).all()


@pytest.mark.parametrize("name", RENDERERS)
def test_a_sun_of_one_texel(name):
    """Its energy is that of its solid angle, whatever the lobes make of it."""
    texels = np.zeros((64, 128, 3), dtype=np.float32)
    texels[10, 40] = 70_000.0
    light = Environment(Picture(texels)).harmonics(4)
    lobes = fit_lobes(light.T, 3)
    assert np.abs(lobes.harmonics() - light.T).max() < 1e-2 * np.abs(light).max()
    drawn = picture(name, knot_subject(), light, material(brdf_named("matte")))
    assert np.isfinite(drawn).all()
    assert drawn[..., :3].max() > 1.0


def test_grazing_views_and_lights_are_finite():
    """An eye in the plane of the surface, and behind it; a light along the horizon."""
    operator = made("ashikhmin-shirley")
    frames = frames_of(np.array([[0.0, 0.0, 1.0]]))
    side = Side(np.eye(16)[:1] * np.sqrt(4 * np.pi), frames)
    lobes = exact_lobes(environment("sun").harmonics(4).T)
    eyes = [1.0, 0.0, 0.0], [1.0, 0.0, 1e-9], [0.0, 0.0, -1.0], [1e-30, 0.0, 0.0], [0.0, 0.0, 1e8]
    for eye in eyes:
        seen = outgoing_radiance(np.zeros((1, 3)), side, np.array(eye), lobes, operator)
        assert np.isfinite(seen).all()


@pytest.mark.parametrize("scale", [1e-3, 1e5])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_scale_and_place_do_not_matter(scale, shift):
    subject = knot_subject(detail=1)
    operator, lobes = made("gold"), exact_lobes(sky().T)
    eye = np.array([1.0, 2.0, 5.0])
    expected = outgoing_radiance(subject.positions, subject.front, eye, lobes, operator)
    moved = (subject.positions.astype(np.float64) + shift) * scale
    got = outgoing_radiance(moved, subject.front, (eye + shift) * scale, lobes, operator)
    assert got == pytest.approx(expected, abs=1e-4)
