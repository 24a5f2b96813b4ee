"""Materials and lights under torture: each a finite picture, the same from both renderers."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.materials import BRDFS, brdf_named, material
from prtnet.presets import Lamp, Preset
from prtnet.reflection import ReflectionOperator
from prtnet.zh import exact_lobes
from prtnet.zh_fit import fit_lobes
from runtime.camera import Camera
from runtime.draw import opened, render_material
from runtime.reflected import Side, Subject, outgoing_radiance
from tests.hard_cases.measured import above, at_least, at_most, below, close, equal, finite
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
    finite(drawn)
    above(drawn[..., :3].max(), 0.0)


@pytest.mark.parametrize("text", EXTREMES)
def test_extremes_survive_half_precision(text):
    operator = made(text)
    data = operator.packed()
    at_most(len(data), 10_000)
    again = ReflectionOperator.unpacked(data, 8)
    finite(again.matrices)
    scale = np.abs(operator.matrices).max()
    at_most(np.abs(again.matrices - operator.matrices).max(), 1e-3 * scale)


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("kind", sorted(set(BRDFS) - {"ashikhmin-shirley"}))  # its coat stays
def test_a_black_material_is_black(name, kind):
    fields = {"diffuse", "specular"} & set(BRDFS[kind].__dataclass_fields__)
    black = ",".join(f"{field}=0" for field in sorted(fields))
    operator = made(f"{kind}:{black}")
    drawn = picture(name, knot_subject(detail=1), sky(), operator)
    finite(drawn)
    below(np.abs(drawn[..., :3]).max(), 1e-6)
    assert drawn[..., 3].max() == 1.0


@pytest.mark.gl
def test_negative_factors_are_as_good_as_others():
    operator = made("gold")
    turned = ReflectionOperator(-operator.matrices, -operator.view)
    one, other = (picture("gl", knot_subject(), sky(), each) for each in (operator, turned))
    close(one, other, 0.0, 1e-6)


@pytest.mark.parametrize("name", RENDERERS)
def test_no_light_at_all(name):
    dark = Environment(Picture(np.zeros((4, 8, 3), dtype=np.float32)))
    light = dark.harmonics(4)
    drawn = picture(name, knot_subject(detail=1), light, material(brdf_named("matte")))
    equal(drawn[..., :3], 0)
    finite(fit_lobes(light.T, 3).harmonics())


@pytest.mark.parametrize("name", RENDERERS)
def test_a_sun_of_one_texel(name):
    """Its energy is that of its solid angle, whatever the lobes make of it."""
    texels = np.zeros((64, 128, 3), dtype=np.float32)
    texels[10, 40] = 70_000.0
    light = Environment(Picture(texels)).harmonics(4)
    lobes = fit_lobes(light.T, 3)
    below(np.abs(lobes.harmonics() - light.T).max(), 1e-2 * np.abs(light).max())
    drawn = picture(name, knot_subject(), light, material(brdf_named("matte")))
    finite(drawn)
    above(drawn[..., :3].max(), 1.0)


HEIGHTS = (1e-300, 1e-150, 1e-12, 1e-6, 1e-3, 0.0, -1e-12)


@pytest.mark.parametrize("kind", sorted(BRDFS))
def test_light_and_view_along_the_surface(kind):
    """Either or both, on the same side, opposite, and across: nothing is infinite or below zero."""
    turn = np.array([0.0, 1e-9, 0.5 * np.pi, np.pi - 1e-9, np.pi])
    height, turn = np.meshgrid(np.array([*HEIGHTS, 0.5, 1.0]), turn)
    flat = np.sqrt(1.0 - height**2)
    every = np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=-1).reshape(-1, 3)
    brdf = BRDFS[kind]()
    reflected = brdf(every[:, None], every) * np.maximum(every[:, None, 2:], 0.0)
    finite(reflected)
    at_least(reflected, 0.0)
    equal(reflected[every[:, 2] <= 0.0], 0)
    equal(reflected[:, every[:, 2] <= 0.0], 0)


def test_eyes_in_the_plane_and_behind_it():
    operator = made("ashikhmin-shirley")
    frames = frames_of(np.array([[0.0, 0.0, 1.0]]))
    side = Side(np.eye(16)[:1] * np.sqrt(4 * np.pi), frames)
    lobes = exact_lobes(environment("sun").harmonics(4).T)
    eyes = [1.0, 0.0, 0.0], [1.0, 0.0, 1e-9], [0.0, 0.0, -1.0], [1e-30, 0.0, 0.0], [0.0, 0.0, 1e8]
    for eye in eyes:
        seen = outgoing_radiance(np.zeros((1, 3)), side, np.array(eye), lobes, operator)
        finite(seen)


def floor() -> Subject:
    """A square of 8 × 8 vertices that nothing hides anything from, its normals along +y."""
    x, z = np.meshgrid(np.linspace(-1.0, 1.0, 8), np.linspace(1.0, -1.0, 8))
    positions = np.stack([x, 0.0 * x, z], axis=-1).reshape(-1, 3)
    corner = (np.arange(7)[:, None] * 8 + np.arange(7)).ravel()
    lower = np.stack([corner, corner + 1, corner + 9], axis=1)
    faces = np.concatenate([lower, np.stack([corner, corner + 9, corner + 8], axis=1)])
    frames = frames_of(np.broadcast_to([0.0, 1.0, 0.0], positions.shape))
    visibility = np.zeros((len(positions), 16))
    visibility[:, 0] = np.sqrt(4 * np.pi)
    return Subject(positions, faces.astype(np.int32), Side(visibility, frames))


@pytest.mark.gl
@pytest.mark.parametrize("elevation", [0.0, 1e-3, -5.0])
@pytest.mark.parametrize("text", ["ggx:roughness=0.1", "ashikhmin-shirley", "schlick"])
def test_a_floor_seen_along_itself_under_a_light_along_it(text, elevation):
    """Both renderers: finite, and alike."""
    sun = Preset((Lamp(180.0, elevation, 500.0, (400.0, 380.0, 350.0)),), *[(0.1, 0.1, 0.1)] * 3)
    lobes = exact_lobes(Environment(sun).harmonics(4).T)
    camera = Camera((0.0, 0.02, 3.0), (0.0, 0.0, 0.0), fov=0.03, near=0.1, far=10.0)
    pictures = []
    for name in ("cpu", "gl"):
        with opened(name) as renderer:
            pictures.append(render_material(renderer, floor(), lobes, made(text), camera, SIZE))
    finite(pictures)
    above(pictures[0][..., 3].mean(), 0.1)
    scale = max(1.0, float(np.abs(pictures[0]).max()))
    at_most(np.abs(pictures[0] - pictures[1]).max(), 2e-2 * scale)


@pytest.mark.parametrize("name", RENDERERS)
@pytest.mark.parametrize("text", ["matte", "gold", "ashikhmin-shirley"])
def test_vertices_that_see_nothing_are_black_and_the_others_as_before(name, text):
    subject = knot_subject(detail=1)
    whole = picture(name, subject, sky(), made(text))
    ball = np.abs(np.linalg.norm(subject.positions, axis=1) - 0.7) < 1e-4
    visibility = np.where(ball[:, None], 0.0, subject.front.visibility)
    blind = Side(visibility, subject.front.frames)
    part = picture(name, Subject(subject.positions, subject.faces, blind), sky(), made(text))
    changed = (part != whole).any(axis=-1)
    above(changed.mean(), 0.02)
    below(changed.mean(), 0.5)
    above((part[changed][:, :3] == 0.0).all(axis=1).mean(), 0.6)  # others hold the ring, too
    none = Side(np.zeros_like(visibility), subject.front.frames)
    dark = picture(name, Subject(subject.positions, subject.faces, none), sky(), made(text))
    equal(dark[..., :3], 0)
    equal(dark[..., 3], whole[..., 3])


@pytest.mark.parametrize("scale", [1e-3, 1e5])
@pytest.mark.parametrize("shift", [0.0, 1e3])
def test_scale_and_place_do_not_matter(scale, shift):
    subject = knot_subject(detail=1)
    operator, lobes = made("gold"), exact_lobes(sky().T)
    eye = np.array([1.0, 2.0, 5.0])
    expected = outgoing_radiance(subject.positions, subject.front, eye, lobes, operator)
    moved = (subject.positions.astype(np.float64) + shift) * scale
    got = outgoing_radiance(moved, subject.front, (eye + shift) * scale, lobes, operator)
    close(got, expected, 0.0, 1e-4)
