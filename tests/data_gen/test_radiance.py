from __future__ import annotations

import math
import threading
from typing import Any

import numpy as np
import pytest

from data_gen.procedural import arm
from data_gen.radiance import trace_radiance, trace_surface
from data_gen.visibility import Tracer, trace_pose
from prtnet.brdf import BRDF, GGX, Lambert, Phong, Schlick, albedo
from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.frames import FrameField, rest_tangents
from prtnet.operators import cosine_matrix
from prtnet.presets import Disc, Preset
from prtnet.scene import Scene, SkinnedScene
from prtnet.transfer import Surface
from tests.data_gen.meshes import cache, quad, together

EYE = np.array([0.4, 3.0, 0.9])
SUN = np.array([1.0, 2.0, 4.0])
BLACK = (0.0, 0.0, 0.0)
WAYS = ("uniform", "light", "brdf", "mixed")


@pytest.fixture(scope="module")
def scene() -> SkinnedScene:
    return arm(segments=6)


def fielded(scene: Scene):
    receivers = scene.receivers()
    return receivers, FrameField(scene, receivers, rest_tangents(scene, receivers))


def white(directions: np.ndarray) -> np.ndarray:
    return np.ones((len(directions), 3)) * SUN


SKY = Environment(Picture(np.ones((4, 8, 3)) * SUN))


def above(scene: SkinnedScene, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions to the eye in local frames, and which are above the horizon."""
    receivers, field = fielded(scene)
    points = receivers.gather(scene.geometry(pose)).positions[0]
    away = EYE - points
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    view = np.einsum("vji,vj->vi", field.frames(pose)[0], away)
    return view, view[:, 2] > 0.2


@pytest.mark.parametrize("light", [white, SKY], ids=["function", "picture"])
@pytest.mark.parametrize("brdf", [Lambert(0.6), GGX(roughness=0.5), Phong(exponent=5.0)], ids=str)
def test_an_open_surface_under_a_white_sky_shows_its_albedo(scene: SkinnedScene, brdf: BRDF, light):
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    seen = trace_radiance(scene, receivers, field, pose, EYE, light, brdf, 2048, threads=2)
    view, facing = above(scene, pose)
    some = np.flatnonzero(facing)[::5]
    assert len(some) > 5
    assert seen[some] == pytest.approx(albedo(brdf, view[some], 64) * SUN, rel=0.02)


@pytest.mark.parametrize("brdf", [GGX(roughness=0.05), Schlick(roughness=0.1)], ids=str)
def test_a_narrow_highlight_shows_its_albedo_with_few_rays(scene: SkinnedScene, brdf: BRDF):
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    seen = trace_radiance(scene, receivers, field, pose, EYE, SKY, brdf, 256)
    view, facing = above(scene, pose)
    some = np.flatnonzero(facing)[::5]
    expected = albedo(brdf, view[some], 256) * SUN
    assert np.abs(seen[some] / expected - 1.0).mean() < 0.03
    assert seen[some].mean() == pytest.approx(expected.mean(), rel=0.01)


def test_what_is_blocked_sends_no_light(scene: SkinnedScene):
    """Diffuse under a white sky: the albedo times the part of cosines that is open."""
    pose = scene.poses(scene.clips[0], np.array([scene.clips[0].end / 2]))
    receivers, field = fielded(scene)
    seen = trace_radiance(scene, receivers, field, pose, EYE, white, Lambert(0.5), 512)
    open_part = trace_pose(scene, receivers, field, pose, 9, 512)[0] @ cosine_matrix(9)[0]
    expected = 0.5 / math.pi * math.sqrt(4 * math.pi) * open_part[:, None] * SUN
    assert np.ptp(expected[:, 0]) > 0.05
    error = seen - expected
    assert np.sqrt(np.mean(error**2)) < 0.01 * expected.max()
    assert abs(error.mean()) < 1e-3 * expected.max()


def test_batches_and_threads_do_not_matter(scene: SkinnedScene, monkeypatch):
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    given = (scene, receivers, field, pose, EYE, environment("studio"), GGX(), 64)
    one = trace_radiance(*given)
    monkeypatch.setattr("data_gen.radiance.BATCH", 300)
    assert trace_radiance(*given, threads=3) == pytest.approx(one, rel=1e-5)
    assert np.abs(trace_radiance(*given, seed=1) - one).max() > 1e-3


def disc_beyond_a_wall(offset: float) -> tuple[np.ndarray, float]:
    """Traced radiance (3,) of a floor under a small disc, and the part of it that is expected.

    The upper edge of a wall passes ``offset`` degrees below the disc's middle, as seen from the
    floor's middle: half a plane, for so small a disc.
    """
    floor = quad([[0, 0, 0], [0, 0, 1], [0.5, 0, 1], [0.5, 0, 0]])
    wall = quad([[1, -0.2, -0.6], [1, 1, -0.6], [1, 1, 0.6], [1, -0.2, 0.6]])
    positions, faces, _ = together(floor, wall)
    still = cache(positions[None].astype(np.float32), faces.astype(np.int32))
    receivers, field = fielded(still)
    disc = Disc(90.0, 45.0 + offset, 0.8, 1.0, (3.0, 2.0, 1.0))
    light = Environment(Preset((disc,), BLACK, BLACK, BLACK))
    pose = still.frames[:1].reshape(1, -1)
    given = (still, receivers, field, pose, np.array([0.0, 5.0, 0.3]))
    seen = trace_radiance(*given, light, Lambert(1.0), 1024)[0]

    theta = math.radians(1.0) * (np.arange(500) + 0.5) / 500
    around = 2 * np.pi * (np.arange(2000) + 0.5) / 2000
    tilt = math.radians(45.0 + offset)
    up = np.array([-math.sin(tilt), math.cos(tilt)])  # of x and y, across the disc's middle
    axis = np.array([math.cos(tilt), math.sin(tilt)])
    s = (np.cos(theta)[:, None, None] * axis
         + np.sin(theta)[:, None, None] * np.cos(around)[:, None] * up)  # fmt: skip
    value = disc.profile(np.cos(theta))[:, None] * s[..., 1] * (s[..., 1] > s[..., 0])
    irradiance = (value.mean(axis=1) * np.sin(theta)).sum() * 2 * np.pi * math.radians(1.0) / 500
    return seen, irradiance / math.pi


@pytest.mark.parametrize("offset", [-2.0, -0.5, 0.0, 0.3, 2.0])
def test_a_wall_hides_the_part_of_a_small_light_that_is_behind_it(offset):
    seen, expected = disc_beyond_a_wall(offset)
    assert seen == pytest.approx(expected * np.array([3.0, 2.0, 1.0]), rel=0.02, abs=1e-12)
    assert (expected == 0.0) == (offset < -1.0)


def test_a_small_light_is_its_irradiance(scene: SkinnedScene):
    """Of a convex, diffuse thing: albedo/π · cos · ∫ radiance · cos, where all of it is seen."""
    disc = Disc(20.0, 60.0, 0.5, 0.7, (500.0, 300.0, 200.0))
    light = Environment(Preset((disc,), BLACK, BLACK, BLACK)).turned(50.0)
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    seen = trace_radiance(scene, receivers, field, pose, EYE, light, Lambert(0.5), 64)
    toward = np.array([math.sin(math.radians(70.0)), 0.0, math.cos(math.radians(70.0))]) * 0.5
    toward[1] = math.sin(math.radians(60.0))
    cosine = receivers.gather(scene.geometry(pose)).normals[0] @ toward
    expected = 0.5 / math.pi * disc.zonal(2)[1] * np.array(disc.colour)
    lit = cosine > 0.2
    assert lit.sum() > 10
    assert seen[lit] == pytest.approx(cosine[lit, None] * expected, rel=0.03)
    assert (seen[cosine < -0.02] == 0.0).all()


@pytest.mark.parametrize("name", ["studio", "area"])
def test_all_ways_agree_where_light_is_soft(scene: SkinnedScene, name: str):
    pose = scene.poses(scene.clips[0], np.array([scene.clips[0].end / 2]))
    receivers, field = fielded(scene)
    light, brdf = environment(name).turned(30.0), GGX(diffuse=0.3, roughness=0.5)
    given = (scene, receivers, field, pose, EYE, light, brdf)
    reference = trace_radiance(*given, 4096, 2, sampling="uniform")
    scale = np.sqrt(np.mean(reference**2))
    for way in WAYS:
        error = trace_radiance(*given, 1024, 2, sampling=way) - reference
        assert np.sqrt(np.mean(error**2)) < 0.02 * scale, way
        assert abs(error.mean()) < 2e-3 * scale, way


@pytest.mark.parametrize("brdf", [Lambert(0.7), Schlick()], ids=["lambert", "schlick"])
def test_few_rays_are_right_on_average(scene: SkinnedScene, brdf: BRDF):
    """Means over seeds against the uniform estimator with many rays, in standard errors."""
    picture = np.random.default_rng(2).random((8, 16, 3)) ** 4
    light = Environment(Picture(picture)).rotated(np.eye(3)[[1, 2, 0]])
    pose = scene.poses(scene.clips[0], np.array([scene.clips[0].end / 2]))
    receivers, field = fielded(scene)
    _, facing = above(scene, pose)
    given = (scene, receivers, field, pose, EYE, light, brdf)
    reference = trace_radiance(*given, 1 << 14, 2, sampling="uniform")[facing]
    for way in ("light", "mixed"):
        runs = np.stack([trace_radiance(*given, 6, sampling=way, seed=k) for k in range(64)])
        runs = runs[:, facing].astype(np.float64)
        spread = runs.std(axis=0, ddof=1) / 8.0 + 2e-3 * reference + 1e-6
        score = (runs.mean(axis=0) - reference) / spread
        assert abs(score.mean()) < 0.5, way
        assert np.sqrt(np.mean(score**2)) < 1.3, way


def test_a_sun_is_found(scene: SkinnedScene):
    """A thousand even rays are noisier than 64 that know where it is."""
    pose = scene.poses(scene.clips[0], np.array([scene.clips[0].end / 2]))
    receivers, field = fielded(scene)
    given = (scene, receivers, field, pose, EYE, environment("sun"), GGX(roughness=0.3))
    reference = trace_radiance(*given, 2048, 2, seed=7)
    scale = np.sqrt(np.mean(reference**2))
    errors = [
        np.sqrt(np.mean((trace_radiance(*given, rays, sampling=way) - reference) ** 2)) / scale
        for way, rays in (("uniform", 1024), ("mixed", 64))
    ]
    assert errors[1] < 0.03
    assert errors[0] > 5.0 * errors[1]


def test_a_still_surface_is_traced_as_the_scene_at_rest(scene: SkinnedScene):
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    posed = receivers.gather(scene.geometry(pose))
    tangents = np.ascontiguousarray(field.frames(pose)[0, :, :, 0])
    faces = receivers.of_vertex[scene.faces]
    surface = Surface(posed.positions[0], posed.normals[0], tangents, faces)
    given = EYE, environment("sun"), GGX(roughness=0.4), 64
    alone = trace_surface(surface, [surface], *given)
    assert alone == pytest.approx(trace_radiance(scene, receivers, field, pose, *given), abs=1e-3)
    corners = np.array([[-2, 0.5, -2], [-2, 0.5, 2], [2, 0.5, 2], [2, 0.5, -2]], dtype=np.float32)
    up, along = (np.tile(np.float32(one), (4, 1)) for one in ((0, 1, 0), (1, 0, 0)))
    lid = Surface(corners, up, along, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32))
    assert trace_surface(surface, [surface, lid], *given).sum() < 0.8 * alone.sum()


def test_threads_that_trace_last(scene: SkinnedScene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Embree keeps a kilobyte for each that ever traced: a window would take more and more."""
    receivers, field = fielded(scene)
    pose = scene.rest_pose()
    seen: set[threading.Thread] = set()  # whose numbers are used again
    occluded = Tracer.occluded

    def noted(tracer: Tracer, *rays: Any) -> Any:
        seen.add(threading.current_thread())
        return occluded(tracer, *rays)

    monkeypatch.setattr(Tracer, "occluded", noted)
    for _ in range(4):
        trace_radiance(scene, receivers, field, pose, EYE, SKY, Lambert(0.5), 64, threads=2)
        trace_pose(scene, receivers, field, pose, 3, 64, threads=2)
    assert 1 <= len(seen) <= 2
    assert threading.current_thread() not in seen
