"""Light where it is known: furnaces, a hollow, and all bounces solved at once."""

from __future__ import annotations

import math

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.casters import MeshCaster, PatchCaster
from data_gen.reliefs import relief
from data_gen.transport import bounce, gather, unit_irradiance
from prtnet import sh
from prtnet.axis_frames import any_tangent
from prtnet.operators import cosine_matrix

WHITE = math.sqrt(4 * math.pi)  # what light 1 from all around is, by its first coefficient


def inside_of_a_ball() -> MeshCaster:
    ball = shapes.icosphere(2)
    inward = -np.array(ball.vertices)
    faces = np.array(ball.faces, dtype=np.int32)[:, ::-1].copy()
    return MeshCaster(-inward, faces, inward, any_tangent(inward))


def matte(albedo: float):  # type: ignore[no-untyped-def]
    return lambda arriving: albedo * arriving


@pytest.mark.parametrize("order", [1, 2, 3, 6])
def test_open_point_has_the_clamped_cosine(order: int) -> None:
    constant = np.zeros(order**2)
    constant[0] = WHITE
    expected = cosine_matrix(order) @ constant / math.pi
    np.testing.assert_allclose(unit_irradiance(order), expected, atol=1e-14)
    caster = PatchCaster(np.zeros((2, 3)), (1.0, 1.0))
    found = gather(caster, order, 64)
    np.testing.assert_allclose(found.direct[:, 0], np.tile(expected, (6, 1)), atol=1e-14)
    assert found.hidden[0].nnz == 0


@pytest.mark.parametrize("albedo", [0.2, 0.7, 0.95])
def test_furnace(albedo: float) -> None:
    """A closed ball that shines 1 everywhere inside gets 1 / (1 − albedo) in all."""
    caster = inside_of_a_ball()
    found = gather(caster, 2, 256)
    np.testing.assert_array_equal(found.direct, 0.0)  # nothing comes in from outside
    shining = np.zeros((len(caster), 4))
    shining[:, 0] = 1 / WHITE / albedo
    total, told = bounce(
        shining, found.hidden[0], matte(albedo), caster.areas, 1000, tolerance=1e-6
    )
    np.testing.assert_allclose(total[:, 0] * WHITE, 1 / (1 - albedo), rtol=1e-4)
    assert told.left <= 1e-6
    assert not told.diverges
    ratio = np.divide(told.energy[1:], told.energy[:-1])
    np.testing.assert_allclose(ratio, albedo, rtol=1e-4)


def test_furnace_of_albedo_one_is_told_to_diverge() -> None:
    caster = inside_of_a_ball()
    found = gather(caster, 1, 256)
    shining = np.full((len(caster), 1), 1 / WHITE)
    _, told = bounce(shining, found.hidden[0], matte(1.0), caster.areas, 30)
    assert told.diverges
    assert told.left == math.inf
    assert told.facts()["left"] is None
    # Dark as it is from outside it stays: the right limit.
    total, told = bounce(found.direct[:, 0], found.hidden[0], matte(1.0), caster.areas, 30)
    np.testing.assert_array_equal(total, 0.0)
    assert not told.diverges


def test_white_furnace_of_an_open_relief() -> None:
    """Where nothing absorbs and light 1 is all around, every point sends 1."""
    caster = PatchCaster(0.4 * relief("waffle", (24, 24)), (1.0, 1.0))
    found = gather(caster, 3, 256)
    assert found.direct[:, 0, 0].min() * WHITE < 0.6  # some are deep
    total, told = bounce(
        found.direct[:, 0], found.hidden[0], matte(1.0), caster.areas, 500, tolerance=1e-7
    )
    np.testing.assert_allclose(total[:, 0] * WHITE, 1.0, atol=2e-5)
    assert not told.diverges


@pytest.mark.parametrize("albedo", [0.3, 0.9])
def test_bounces_shrink_by_the_albedo_at_least(albedo: float) -> None:
    caster = PatchCaster(0.3 * relief("bumps", (20, 20)), (1.0, 1.0))
    found = gather(caster, 3, 128)
    _, told = bounce(found.direct[:, 0], found.hidden[0], matte(albedo), caster.areas, 8, 0.0)
    assert len(told.energy) == 9
    ratio = np.divide(told.largest[1:], told.largest[:-1])
    assert (ratio <= albedo * (1 + 1e-5)).all()


def test_bounces_are_the_solution_of_the_whole_system() -> None:
    caster = PatchCaster(0.5 * relief("swirl", (14, 14)), (1.0, 1.0))
    found = gather(caster, 4, 128)
    arriving, hidden = found.direct[:, 0], found.hidden[0].toarray()
    total, _ = bounce(arriving, found.hidden[0], matte(0.8), caster.areas, 100, 1e-9)
    exact = np.linalg.solve(np.eye(len(caster)) - 0.8 * hidden, 0.8 * arriving)
    np.testing.assert_allclose(total, exact, atol=1e-7)


@pytest.mark.parametrize("most", [0, 1, 2, 3, 6])
def test_no_more_is_left_than_was_said(most: int) -> None:
    caster = PatchCaster(0.5 * relief("swirl", (14, 14)), (1.0, 1.0))
    found = gather(caster, 1, 128)
    arriving, hidden = found.direct[:, 0], found.hidden[0]
    exact, _ = bounce(arriving, hidden, matte(0.8), caster.areas, 200, 1e-9)
    early, told = bounce(arriving, hidden, matte(0.8), caster.areas, most, 0.0)
    left = (exact - early).max() / early.max()
    assert 0 < left <= told.left
    assert told.left < 8 * left  # nor is the bound an empty one


def cap(texels: int, half_angle: float) -> tuple[PatchCaster, np.ndarray]:
    """A hollow that is part of a ball of radius 1, in a plane; which texels are well inside."""
    rim = math.sin(half_angle)
    size = 2.6 * rim
    x = (np.arange(texels) + 0.5) / texels * size - size / 2
    r2 = x[:, None] ** 2 + x**2
    heights = np.where(r2 < rim**2, math.cos(half_angle) - np.sqrt(np.maximum(1 - r2, 0)), 0.0)
    return PatchCaster(heights, (size, size), (False, False)), (r2 < (0.8 * rim) ** 2).ravel()


def test_hollow_of_a_ball() -> None:
    """All points of a ball see a part of it alike: the share of its area, whatever they are.

    So a cap of half angle θ hides F = (1 − cos θ)/2 of the sky of each of its points, and of light
    1 from all around each sends ρ (1 − F) / (1 − ρ F).
    """
    half_angle, albedo = math.radians(65), 0.75
    caster, inside = cap(72, half_angle)
    share = (1 - math.cos(half_angle)) / 2
    found = gather(caster, 2, 1024)
    direct = found.direct[inside, 0, 0] * WHITE
    np.testing.assert_allclose(direct, 1 - share, atol=0.015)
    total, _ = bounce(found.direct[:, 0], found.hidden[0], matte(albedo), caster.areas, 30, 1e-5)
    expected = albedo * (1 - share) / (1 - albedo * share)
    np.testing.assert_allclose(total[inside, 0] * WHITE, expected, atol=0.01)


def test_frames_and_threads_change_nothing() -> None:
    """Light in the surface's frame does not know the tangents of its points."""
    ball = shapes.icosphere(1) + shapes.icosphere(1).apply_translation([1.5, 0.2, 0.1])
    normals = np.array(ball.vertex_normals)
    places, faces = np.array(ball.vertices), np.array(ball.faces, dtype=np.int32)
    turned = np.cross(normals, any_tangent(normals))
    one = gather(MeshCaster(places, faces, normals, any_tangent(normals)), 4, 4096)
    other = gather(MeshCaster(places, faces, normals, turned), 4, 4096, threads=2)
    np.testing.assert_allclose(one.direct, other.direct, atol=6e-3)
    assert np.abs(one.direct[:, 0] - sh.evaluate(normals, 4)).max() > 0.1  # there are shadows
    again = gather(MeshCaster(places, faces, normals, turned), 4, 4096, threads=1)
    np.testing.assert_array_equal(again.direct, other.direct)


def test_functions_of_ones_own() -> None:
    """Twice the cosine is twice the light."""
    caster = PatchCaster(0.3 * relief("waffle", (10, 10)), (1.0, 1.0))
    plain = gather(caster, 3, 64)
    sky = unit_irradiance(3)
    both = gather(
        caster, 3, 64,
        lambda d: np.stack([d[:, 2], 2 * d[:, 2]]) / math.pi, np.stack([sky, 2 * sky]),
    )  # fmt: skip
    np.testing.assert_allclose(both.direct[:, 0], plain.direct[:, 0], atol=1e-6)
    np.testing.assert_allclose(both.direct[:, 1], 2 * plain.direct[:, 0], atol=1e-6)
    difference = both.hidden[1] - 2 * plain.hidden[0]
    assert abs(difference).max() < 1e-6
