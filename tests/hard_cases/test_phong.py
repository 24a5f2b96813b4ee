"""The Phong operator and 1D BRDFs at their ends: exponents, orders, poles, darkness."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest

from prtnet import sh
from prtnet.axis_frames import frame_about
from prtnet.one_dimensional import OneDimensional
from prtnet.phong import phong_matrix, phong_transfer, phong_zonal
from prtnet.sh_rotation import rotate
from prtnet.zh import Lobes
from runtime.one_dimensional import (
    LobeSide,
    above_horizon,
    lobe_radiance,
    one_dimensional_radiance,
)
from tests.hard_cases.measured import above, at_most, below, close, equal, finite, numbers
from tests.prtnet.test_phong import exact_matrix, scale_of
from tests.runtime.lobes import random_light, random_lobes, random_side

EXPONENTS = (0.0, 0.5, 1.0, 1e3, 1e5)
POLES = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])


def lobes_of(lobes: Lobes, dtype: str) -> Lobes:
    return Lobes(lobes.axes.astype(dtype), lobes.coefficients.astype(dtype))


def side_of(side: LobeSide, dtype: str) -> LobeSide:
    return LobeSide(lobes_of(side.visibility, dtype), side.frames.astype(dtype))


@pytest.mark.parametrize("alpha", EXPONENTS)
@pytest.mark.parametrize("order", range(1, 11))
def test_every_entry_keeps_its_digits(order, alpha, dtype, put):
    """Also those of m > 0, which fall like α^−m: down to where float32 ends."""
    expected = exact_matrix(alpha, order)
    got = numbers(phong_matrix(put(alpha), order)).astype(np.float64)
    digits = {"float32": 3e-7, "float64": 1e-14}[dtype]
    at_most(np.abs(got - expected), digits * order * scale_of(expected) + 1e-37)


@pytest.mark.parametrize("alpha", [1e-30, 1e6, 1e12, 1e30, 1e38])
@pytest.mark.parametrize("order", [1, 4, 10])
def test_the_limits_are_reached_and_not_passed(dtype, order, alpha, put):
    """No overflow on the way: the mean over the hemisphere, or a mirror but for l(l + 1)/2α."""
    vector = np.random.default_rng(0).normal(size=order**2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        got = phong_transfer(alpha, put(vector))
        zonal = phong_zonal(put(alpha), order)
        finite(phong_matrix(put(alpha), order))
    digits, far = {"float32": 1e-7, "float64": 3e-15}[dtype] * order, 0.0
    if alpha < 1.0:
        expected = phong_transfer(0.0, vector)
        close(zonal, phong_zonal(0.0, order), atol=digits)
    else:
        up = sh.evaluate(np.array([0.0, 0.0, 1.0]), order)
        expected, far = (up @ vector) * up, order * order / alpha
        close(zonal, 1.0, atol=far + digits)
    close(got, expected, atol=10.0 * (far + digits))


@pytest.mark.parametrize("order", [1, 2, 4, 10])
def test_it_never_takes_light_away(order, dtype, put):
    """A lobe is positive: so is every function seen through it."""
    for alpha in EXPONENTS:
        values = np.linalg.eigvalsh(numbers(phong_matrix(put(alpha), order)))
        above(values.min(), {"float32": -1e-6, "float64": -1e-13}[dtype])


@pytest.mark.parametrize("axis", [*POLES, [0.0, 1e-9, -1.0], [1e-4, -1e-4, 1.0], [1.0, 0.0, -0.0],
                                  [0.6, 0.8, -1e-17]])  # fmt: skip
def test_axes_at_and_beside_the_poles(axis, dtype):
    """Turned by matrices instead of axes; whichever way frames turn around the axis."""
    order = 4
    axis = np.array(axis) / np.linalg.norm(axis)
    visibility = random_lobes((1, 3), order, 0)
    light = random_light(order)
    seen, shed = lobes_of(visibility, dtype), lobes_of(light, dtype)
    shed = Lobes(shed.axes[None], shed.coefficients)
    got = lobe_radiance(seen, shed, axis[None].astype(dtype), 5.0)
    frame = frame_about(axis)
    close(frame.T @ frame, np.eye(3), atol=1e-15)
    spin = np.array([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]])
    turn = (frame @ spin).T
    whole, sent = rotate(visibility.harmonics()[0], turn), rotate(light.harmonics(), turn)
    exact = sent @ phong_transfer(5.0, whole)
    close(got[0], exact, atol={"float32": 1e-5, "float64": 1e-12}[dtype])


MIXED = OneDimensional(0.3, 0.4, 1e5, 0.2)


def test_no_visibility_is_black(dtype):
    side, light = side_of(random_side(7, 4), dtype), lobes_of(random_light(4), dtype)
    dark = Lobes(side.visibility.axes, np.zeros_like(side.visibility.coefficients))
    none, positions = LobeSide(dark, side.frames), np.zeros((7, 3), dtype)
    eye = np.array([1.0, 2.0, 3.0], dtype)
    equal(one_dimensional_radiance(positions, none, eye, light, MIXED, none), 0)
    # Nothing shadows what is transmitted when the other side is not known.
    assert one_dimensional_radiance(positions, none, eye, light, MIXED).any()
    white = OneDimensional(0.3, 0.4, 0.0)
    equal(one_dimensional_radiance(positions, none, eye, light, white), 0)


def test_no_light_and_no_vertices(dtype):
    side, light = side_of(random_side(4, 3), dtype), lobes_of(random_light(3), dtype)
    night = Lobes(light.axes, np.zeros_like(light.coefficients))
    eye = np.ones(3, dtype)
    equal(one_dimensional_radiance(np.zeros((4, 3), dtype), side, eye, night, MIXED), 0)
    empty = LobeSide(
        Lobes(side.visibility.axes[:0], side.visibility.coefficients[:0]), side.frames[:0]
    )
    seen = one_dimensional_radiance(np.zeros((0, 3), dtype), empty, eye, light, MIXED)
    assert seen.shape == (0, 3)


@pytest.mark.parametrize("alpha", EXPONENTS)
def test_eyes_in_a_vertex_and_behind_it_see_something_finite(alpha, dtype):
    side, light = side_of(random_side(5, 4), dtype), lobes_of(random_light(4), dtype)
    material = OneDimensional(0.3, 0.4, alpha, 0.2)
    behind = -1e6 * side.frames[0, :, 2]
    for eye in (np.zeros(3, dtype), behind):
        seen = one_dimensional_radiance(np.zeros((5, 3), dtype), side, eye, light, material)
        finite(seen)


@pytest.mark.parametrize("order", [4, 6])
def test_a_white_world_reflects_what_it_is_given(order, dtype):
    """White furnace: open vertices reflect the sum of their factors, at every exponent."""
    count = 6
    side = side_of(random_side(count, order), dtype)
    open_lobes = Lobes(side.visibility.axes[:, :1], np.zeros((count, 1, order), dtype))
    open_lobes.coefficients[..., 0] = 4.0 * math.pi
    poles = np.broadcast_to(POLES[0].astype(dtype), (count, 3, 1, 3))
    world = Lobes(poles[0], np.zeros((3, 1, order), dtype))
    world.coefficients[..., 0] = 4.0 * math.pi
    positions = np.random.default_rng(0).normal(size=(count, 3)).astype(dtype)
    eye = np.array([5.0, 0.0, 0.0], dtype)
    for alpha in EXPONENTS:
        material = OneDimensional(0.25, 0.5, alpha, 0.125)
        whole = LobeSide(open_lobes, side.frames)
        seen = one_dimensional_radiance(positions, whole, eye, world, material)
        close(seen, 0.875, atol=3e-7)  # pictures are float32
        part = lobe_radiance(open_lobes, Lobes(poles, world.coefficients), poles[:, 0, 0], alpha)
        close(part, 1.0, atol={"float32": 1e-6, "float64": 5e-15}[dtype])
        upper = LobeSide(above_horizon(open_lobes), side.frames)
        cut = one_dimensional_radiance(positions, upper, eye, world, material)
        below(cut, 0.875 + 0.06)  # rings, but makes no light
