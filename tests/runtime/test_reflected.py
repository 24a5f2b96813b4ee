from __future__ import annotations

import numpy as np
import pytest

from prtnet.materials import brdf_named, material
from prtnet.reflection import local_view
from prtnet.sh_rotation import rotate
from prtnet.zh import exact_lobes
from runtime.reflected import Side, local_light, outgoing_radiance
from runtime.shading import diffuse_radiance
from tests.runtime.scenes import knot_subject, sky
from tests.runtime.test_shading import random_frames


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_lobes_turned_into_frames_are_the_light_turned(order):
    frames, light = random_frames(9), sky(order)
    turned = rotate(np.broadcast_to(light.T, (9, *light.T.shape)), frames.swapaxes(1, 2)[:, None])
    assert local_light(exact_lobes(light.T), frames) == pytest.approx(
        turned.swapaxes(1, 2), abs=1e-6
    )


@pytest.mark.parametrize("order", [2, 4])
def test_a_diffuse_material_is_diffuse_shading(order, monkeypatch):
    monkeypatch.setattr("runtime.reflected.BLOCK", 100)
    subject, light = knot_subject(order), sky(order)
    side = subject.front
    expected = diffuse_radiance(side.visibility, side.frames, light, 0.8)
    got = outgoing_radiance(
        subject.positions, side, np.array([0.0, 1.0, 5.0]), exact_lobes(light.T),
        material(brdf_named("matte"), order=order),
    )  # fmt: skip
    assert got == pytest.approx(expected, abs=1e-5)


def test_views_are_in_the_frame_and_raised_to_the_horizon():
    frames = random_frames(50)
    positions = np.random.default_rng(0).normal(size=(50, 3))
    eye = np.array([3.0, 1.0, 0.0])
    view = local_view(positions, eye, frames)
    assert np.linalg.norm(view, axis=1) == pytest.approx(np.ones(50))
    away = eye - positions
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    above = (away * frames[:, :, 2]).sum(axis=1) > 0.01
    world = np.einsum("vij,vj->vi", frames, view)
    assert world[above] == pytest.approx(away[above])
    assert (view[:, 2] > 0).all()


def test_an_eye_in_a_vertex_sees_something_finite():
    frames = random_frames(1)
    side = Side(np.ones((1, 16)), frames)
    seen = outgoing_radiance(
        np.zeros((1, 3)), side, np.zeros(3), exact_lobes(sky().T), material(brdf_named("matte"))
    )
    assert np.isfinite(seen).all()


def test_total_occlusion_is_black_whatever_the_material():
    subject = knot_subject()
    dark = Side(np.zeros_like(subject.front.visibility), subject.front.frames)
    operator = material(brdf_named("phong"), 4)
    eye = np.array([0.0, 0.0, 5.0])
    seen = outgoing_radiance(subject.positions, dark, eye, exact_lobes(sky().T), operator)
    assert not seen.any()
