"""1D BRDFs of lobes, against sums over directions."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.axis_frames import frame_about
from prtnet.brdf import BRDF, Phong, mirrored
from prtnet.errors import PrtnetError
from prtnet.factors import harmonic_factors, tabulate
from prtnet.one_dimensional import OneDimensional
from prtnet.phong import phong_matrix
from prtnet.reflection import ReflectionOperator, local_view, operator_of
from prtnet.sh_rotation import rotate
from prtnet.zh import Lobes, exact_lobes
from runtime.one_dimensional import (
    LobeSide,
    above_horizon,
    lobe_radiance,
    one_dimensional_radiance,
    unshadowed_radiance,
)
from runtime.reflected import Side, outgoing_radiance
from runtime.shading import diffuse_radiance
from tests.runtime.lobes import random_light, random_lobes, random_side
from tests.runtime.scenes import sky

EXPONENTS = (0.0, 0.5, 1.0, 7.3, 1e3, 1e5)
DIRECTIONS = 1 << 17
EYE = np.array([3.0, 1.0, 0.5])


def around(axis: np.ndarray, alpha: float) -> np.ndarray:
    """Directions distributed as the lobe: z^(α + 1) is uniform. The mean over them is R(α, a)."""
    uniform = sh.fibonacci_hemisphere(DIRECTIONS)
    z = uniform[:, 2] ** (1.0 / (alpha + 1.0))
    # 1 − z² of z near 1
    sine = np.sqrt(-np.expm1(2.0 / (alpha + 1.0) * np.log(uniform[:, 2])))
    sine = sine / np.sqrt(1.0 - uniform[:, 2] ** 2)
    points = np.stack([uniform[:, 0] * sine, uniform[:, 1] * sine, z], axis=-1)
    turn, _ = Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])
    return turn.apply(points)


def summed(light: np.ndarray, seen: np.ndarray, axis: np.ndarray, alpha: float) -> np.ndarray:
    """Brute force: the product of light (3, n²) and visibility (n²) at many directions."""
    basis = sh.evaluate(around(axis, alpha), sh.order_of(seen))
    return ((basis @ light.T) * (basis @ seen)[:, None]).mean(axis=0)


def brute_force(
    side: LobeSide,
    light: Lobes,
    material: OneDimensional,
    positions: np.ndarray,
    behind: np.ndarray | None = None,
) -> np.ndarray:
    """Radiance in world space: visibility is turned there, everything summed over directions."""
    shed = light.harmonics()
    order = light.coefficients.shape[-1]
    white = np.zeros(order**2)
    white[0] = math.sqrt(4.0 * math.pi)
    views = local_view(positions, EYE, side.frames)
    result = np.empty((len(positions), 3))
    for vertex, frame in enumerate(side.frames):
        own = side.visibility.harmonics()[vertex]
        seen = rotate(own, frame)
        mirror, up = frame @ mirrored(views[vertex]), frame[:, 2]
        back = white if behind is None else behind[vertex]
        result[vertex] = (
            material.specular * summed(shed, seen, mirror, material.exponent)
            + material.diffuse * summed(shed, seen, up, 1.0)
            + material.transmitted * summed(shed, back, -up, 1.0)
        )
    return result


MIXED = OneDimensional((0.1, 0.2, 0.3), (0.5, 0.4, 0.3), 7.3, (0.2, 0.1, 0.4))


@pytest.mark.parametrize("alpha", EXPONENTS)
@pytest.mark.parametrize("order", [1, 4])
def test_radiance_is_the_sum_over_directions(order, alpha):
    side, light = random_side(3, order), random_light(order)
    positions = np.random.default_rng(1).normal(size=(3, 3))
    material = dataclasses.replace(MIXED, exponent=alpha)
    got = one_dimensional_radiance(positions, side, EYE, light, material)
    expected = brute_force(side, light, material, positions)
    np.testing.assert_allclose(got, expected, atol=2e-4 * np.abs(expected).max())


@pytest.mark.parametrize("order", [2, 4])
def test_the_other_side_shadows_what_is_transmitted(order):
    side, light = random_side(3, order), random_light(order)
    other = LobeSide(
        random_lobes((3, 2), order, 5),
        # normal and bitangent turned round, the tangent the same
        side.frames * np.array([1.0, -1.0, -1.0]),
    )
    positions = np.random.default_rng(1).normal(size=(3, 3))
    world = rotate(other.visibility.harmonics(), other.frames)
    got = one_dimensional_radiance(positions, side, EYE, light, MIXED, other)
    expected = brute_force(side, light, MIXED, positions, world)
    np.testing.assert_allclose(got, expected, atol=2e-4 * np.abs(expected).max())
    # An open other side is no other side.
    white = np.zeros((3, 1, order))
    white[..., 0] = 4.0 * math.pi  # over y_00: the function 1
    open_side = LobeSide(Lobes(other.visibility.axes[:, :1], white), other.frames)
    plain = one_dimensional_radiance(positions, side, EYE, light, MIXED)
    again = one_dimensional_radiance(positions, side, EYE, light, MIXED, open_side)
    np.testing.assert_allclose(again, plain, atol=1e-6)


def test_harmonics_of_light_turned_by_matrices():
    """Another way to the reflection frame: light and visibility as harmonics, rotated."""
    order, alpha = 4, 12.5
    side, light = random_side(6, order), sky(order)
    views = local_view(np.zeros((6, 3)), EYE, side.frames)
    local = mirrored(views)
    exact = exact_lobes(light.T)
    turned = Lobes(np.einsum("vji,cnj->vcni", side.frames, exact.axes), exact.coefficients)
    got = lobe_radiance(side.visibility, turned, local, alpha)
    inverse = np.swapaxes(frame_about(local), -1, -2)
    seen = rotate(side.visibility.harmonics(), inverse)
    turn = inverse @ side.frames.swapaxes(1, 2)
    shed = rotate(np.broadcast_to(light.T, (6, 3, order**2)), turn[:, None])
    matrix = (alpha + 1.0) / (2.0 * math.pi) * phong_matrix(alpha, order)
    np.testing.assert_allclose(got, np.einsum("vci,ij,vj->vc", shed, matrix, seen), atol=1e-10)


@pytest.mark.parametrize("order", [2, 4])
def test_the_diffuse_term_is_diffuse_shading(order, monkeypatch):
    monkeypatch.setattr("runtime.one_dimensional.BLOCK", 3)
    side, light = random_side(8, order), sky(order)
    material = OneDimensional(0.8, 0.0, 5.0)
    got = one_dimensional_radiance(np.zeros((8, 3)), side, EYE, exact_lobes(light.T), material)
    visibility = side.visibility.harmonics()
    expected = diffuse_radiance(visibility, side.frames, light, 0.8)
    np.testing.assert_allclose(got, expected, atol=1e-5)


@pytest.mark.parametrize("alpha", [0.0, 1.0, 30.0])
def test_what_nothing_shadows_is_zonal(alpha):
    order = 5
    light = random_light(order)
    axis = random_lobes((4, 2), 1, 2).axes.reshape(-1, 3)
    own = Lobes(np.broadcast_to(light.axes, (8, *light.axes.shape)), light.coefficients)
    white = np.zeros((8, 1, order))
    white[..., 0] = 4.0 * math.pi
    expected = lobe_radiance(Lobes(axis[:, None], white), own, axis, alpha)
    np.testing.assert_allclose(unshadowed_radiance(own, axis, alpha), expected, atol=1e-13)


def general(brdf: BRDF, order: int, view_order: int) -> ReflectionOperator:
    table = tabulate(brdf, samples=2)
    return operator_of(*harmonic_factors(table, 40, 2 * order - 1, view_order), order)


class Single(Phong):
    """The 1D lobe as a BRDF: over the cosine, which the general operator multiplies with."""

    def above(self, light, view):
        along = np.clip((mirrored(light) * view).sum(axis=-1), 0.0, 1.0)
        lobe = (self.exponent + 1.0) / (2.0 * math.pi) * along**self.exponent
        return np.repeat((lobe / np.maximum(light[..., 2], 1e-3))[..., None], 3, axis=-1)


def compared(brdf: BRDF, alpha: float, tilt: float) -> tuple[np.ndarray, np.ndarray]:
    """Radiance of many vertices seen at an angle, by lobes and by the general operator."""
    order, count = 3, 12
    side, light = random_side(count, order), exact_lobes(sky(order).T)
    around_normal = np.linspace(0.0, 6.0, count)
    view = np.stack([np.sin(tilt) * np.cos(around_normal), np.sin(tilt) * np.sin(around_normal),
                     np.full(count, np.cos(tilt))], axis=-1)  # fmt: skip
    positions = EYE - 10.0 * np.einsum("vij,vj->vi", side.frames, view)
    material = OneDimensional(0.0, 1.0, alpha)
    got = one_dimensional_radiance(positions, side, EYE, light, material)
    plain = Side(side.visibility.harmonics(), side.frames)
    return got, outgoing_radiance(positions, plain, EYE, light, general(brdf, order, 8))


@pytest.mark.parametrize("exponent", [1.0, 4.0, 15.0])
def test_seen_from_above_it_is_the_phong_brdf_of_an_exponent_less(exponent):
    """There the lobe's cosine is the cosine: (n + 2)/2π zⁿ z is the lobe of α = n + 1."""
    got, expected = compared(Phong(0.0, 1.0, exponent), exponent + 1.0, 0.0)
    np.testing.assert_allclose(got, expected, atol=0.01 * np.abs(expected).max())


@pytest.mark.parametrize("tilt", [0.2, 0.4, 0.8])
def test_narrow_lobes_are_those_of_the_general_operator(tilt):
    """Above the horizon both integrate the same."""
    got, expected = compared(Single(0.0, 1.0, 60.0), 60.0, tilt)
    np.testing.assert_allclose(got, expected, atol=0.015 * np.abs(expected).max())


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_above_the_horizon_only(order):
    side = random_side(5, order)
    more = above_horizon(side.visibility)
    expected = side.visibility.harmonics() - sh.lower_hemisphere(order)
    np.testing.assert_allclose(more.harmonics(), expected, atol=1e-13)
    assert more.axes.shape == (5, 4, 3)
    single = Lobes(side.visibility.axes.astype("f4"), side.visibility.coefficients.astype("f4"))
    assert above_horizon(single).axes.dtype == above_horizon(single).coefficients.dtype == "f4"


def test_the_horizon_darkens_oblique_views():
    """An open vertex in a white world, mirrored along the horizon: half the lobe is below."""
    order = 8
    white = np.zeros((1, 1, order))
    white[..., 0] = 4.0 * math.pi
    up = np.array([[[0.0, 0.0, 1.0]]])
    world = Lobes(np.broadcast_to(up, (1, 3, 1, 3)), np.broadcast_to(white, (3, 1, order)))
    grazing = np.array([[1.0, 0.0, 0.0]])
    full = lobe_radiance(Lobes(up, white), world, grazing, 3.0)
    half = lobe_radiance(above_horizon(Lobes(up, white)), world, grazing, 3.0)
    np.testing.assert_allclose(full, 1.0, atol=1e-12)
    np.testing.assert_allclose(half, 0.5, atol=1e-12)


def test_bad_input_is_told():
    for changed in ({"diffuse": -0.1}, {"specular": 1.5}, {"transmitted": (0.0, 2.0, 0.0)}):
        with pytest.raises(PrtnetError, match=r"BRDF lobe: .* must be .*at (least 0|most 1)"):
            OneDimensional(**changed)
    for alpha in (-1.0, math.nan, math.inf):
        with pytest.raises(PrtnetError, match="exponent must be finite, at least 0"):
            OneDimensional(exponent=alpha)
    with pytest.raises(ValueError, match="different orders"):
        one_dimensional_radiance(np.zeros((2, 3)), random_side(2, 3), EYE, random_light(4), MIXED)
