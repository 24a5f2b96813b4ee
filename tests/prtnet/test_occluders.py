from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet import sh
from prtnet.occluders import cap_integrals, fit_spheres


@given(st.floats(-1.0, 1.0))
def test_cap_integrals_against_quadrature(cosine):
    nodes, weights = np.polynomial.legendre.leggauss(16)
    t = 0.5 * (1 - cosine) * nodes + 0.5 * (1 + cosine)
    for degree, value in enumerate(cap_integrals(np.array(cosine), 6)):
        legendre = np.polynomial.legendre.Legendre.basis(degree)(t)
        assert value == pytest.approx(0.5 * (1 - cosine) * weights @ legendre, abs=1e-12)


def test_cap_coefficients_against_samples():
    """2π I_l y_lm(u) is the projection of the cap's indicator."""
    axis = np.array([0.36, 0.48, 0.8])
    cosine = np.cos(0.7)
    integrals = cap_integrals(np.array(cosine), 5)
    degree = np.repeat(np.arange(5), 2 * np.arange(5) + 1)
    closed = 2 * np.pi * integrals[degree] * sh.evaluate(axis, 5)
    s = sh.fibonacci_sphere(200_000)
    sampled = 4 * np.pi * ((s @ axis > cosine)[:, None] * sh.evaluate(s, 5)).mean(axis=0)
    assert np.allclose(closed, sampled, atol=2e-3)


def ball(count, centre, radius, seed):
    v = np.random.default_rng(seed).normal(size=(count, 3))
    return centre + radius * v / np.linalg.norm(v, axis=1, keepdims=True)


def test_one_ball_a_joint_is_found_in_the_joint_frame():
    joints = np.zeros((2, 3, 4))
    joints[:, :, :3] = np.eye(3) * 2.0  # scaled joints: radius and centre are in joint units
    joints[1, :, 3] = [5.0, 0.0, 0.0]
    positions = np.concatenate([ball(400, [0, 1, 0], 0.5, 0), ball(400, [5, 0, 0], 1.0, 1)])
    weights = np.repeat(np.eye(2), 400, axis=0)
    spheres = fit_spheres(positions, weights, joints, count=2)
    assert spheres.joint.tolist() == [0, 1]
    assert np.allclose(spheres.centre, [[0, 0.5, 0], [0, 0, 0]], atol=0.05)
    assert np.allclose(spheres.radius, [0.9 * 0.25, 0.9 * 0.5], atol=0.03)


def test_many_spheres_follow_the_vertices_and_the_limit():
    joints = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None]
    positions = ball(1000, [0, 0, 0], 1.0, 2)
    weights = np.ones((1000, 1))
    assert len(fit_spheres(positions, weights, joints, count=40, most_per_joint=9)) == 9


def test_tiny_meshes_and_duplicates_have_spheres_too():
    joints = np.concatenate([np.eye(3), np.zeros((3, 1))], axis=1)[None]
    for positions in (np.eye(3), np.zeros((20, 3))):
        spheres = fit_spheres(positions, np.ones((len(positions), 1)), joints, count=8)
        assert len(spheres) >= 1
        assert np.isfinite(spheres.radius).all()
