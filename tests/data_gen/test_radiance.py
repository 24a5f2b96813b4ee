from __future__ import annotations

import math

import numpy as np
import pytest

from data_gen.procedural import arm
from data_gen.radiance import trace_radiance
from data_gen.visibility import Hemisphere, trace_pose
from prtnet.brdf import BRDF, GGX, Lambert, Phong, albedo
from prtnet.frames import FrameField, rest_tangents
from prtnet.operators import cosine_matrix
from prtnet.scene import SkinnedScene

EYE = np.array([0.4, 3.0, 0.9])
SUN = np.array([1.0, 2.0, 4.0])


@pytest.fixture(scope="module")
def scene() -> SkinnedScene:
    return arm(segments=10)


def fielded(scene: SkinnedScene):
    receivers = scene.receivers()
    return receivers, FrameField(scene, receivers, rest_tangents(scene, receivers))


def white(directions: np.ndarray) -> np.ndarray:
    return np.ones((len(directions), 3)) * SUN


def above(scene: SkinnedScene, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions to the eye in local frames, and which are above the horizon."""
    receivers, field = fielded(scene)
    points = receivers.gather(scene.geometry(pose)).positions[0]
    away = EYE - points
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    view = np.einsum("vji,vj->vi", field.frames(pose)[0], away)
    return view, view[:, 2] > 0.2


@pytest.mark.parametrize("brdf", [Lambert(0.6), GGX(roughness=0.5), Phong(exponent=5.0)], ids=str)
def test_an_open_surface_under_a_white_sky_shows_its_albedo(scene: SkinnedScene, brdf: BRDF):
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    seen = trace_radiance(scene, receivers, field, pose, EYE, white, brdf, 2048, threads=2)
    view, facing = above(scene, pose)
    some = np.flatnonzero(facing)[::5]
    assert len(some) > 5
    assert seen[some] == pytest.approx(albedo(brdf, view[some], 64) * SUN, rel=0.02)


def test_what_is_blocked_sends_no_light(scene: SkinnedScene):
    """Diffuse under a white sky: the albedo times the part of cosines that is open."""
    pose = scene.poses(scene.clips[0], np.array([scene.clips[0].end / 2]))
    receivers, field = fielded(scene)
    seen = trace_radiance(scene, receivers, field, pose, EYE, white, Lambert(0.5), 512)
    open_part = trace_pose(scene, receivers, field, pose, 9, 512)[0] @ cosine_matrix(9)[0]
    expected = 0.5 / math.pi * math.sqrt(4 * math.pi) * open_part[:, None] * SUN
    assert np.ptp(expected[:, 0]) > 0.05
    assert seen == pytest.approx(expected, abs=0.01 * expected.max())


def test_batches_and_threads_do_not_matter(scene: SkinnedScene, monkeypatch):
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    given = (scene, receivers, field, pose, EYE, white, GGX(), 64)
    one = trace_radiance(*given)
    monkeypatch.setattr("data_gen.radiance.BATCH", 300)
    assert trace_radiance(*given, threads=3) == pytest.approx(one, rel=1e-5)


def test_light_comes_from_where_it_is(scene: SkinnedScene):
    """One ray's direction lit: the receiver's answer is f cos times its share."""
    pose = scene.rest_pose()
    receivers, field = fielded(scene)
    frame = field.frames(pose)[0, 0].astype(np.float64)
    local = Hemisphere(1, 64).directions[20].astype(np.float64)
    lit = frame @ local

    def lamp(directions: np.ndarray) -> np.ndarray:
        return (directions @ lit > 1.0 - 1e-6)[:, None] * SUN

    seen = trace_radiance(scene, receivers, field, pose, EYE, lamp, Lambert(1.0), 64)
    assert seen[0] == pytest.approx(SUN / math.pi * local[2] * 2 * math.pi / 64, rel=1e-5)
