from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import trimesh.creation as shapes
from scipy.spatial.transform import Rotation

from data_gen.bake import BakeConfig, bake_mesh, bake_patch, bake_wrinkle
from data_gen.reliefs import relief
from data_gen.static_mesh import StaticMesh, clean_mesh
from data_gen.transport import unit_irradiance
from prtnet import sh
from prtnet.brdf import GGX, Lambert
from prtnet.dipole import MATERIALS
from prtnet.glossy import brdf_rows
from prtnet.sh_rotation import rotate
from prtnet.transfer import Patch, Surface
from prtnet.wrinkle import Wrinkle

WHITE = math.sqrt(4 * math.pi)
TILED = (True, True)
QUICK = BakeConfig(order=3, rays=128)


def two_balls() -> StaticMesh:
    both = shapes.icosphere(1) + shapes.icosphere(1).apply_translation([1.6, 0.3, 0.2])
    return clean_mesh("balls", np.array(both.vertices), np.array(both.faces))


def test_flat_patch_is_the_clamped_cosine() -> None:
    field = bake_patch(np.zeros((3, 4)), (0.4, 0.3), TILED, dataclasses.replace(QUICK, order=6))
    expected = 0.8 * unit_irradiance(6)
    np.testing.assert_allclose(field.vectors, np.tile(expected, (12, 1)), atol=1e-7)
    assert isinstance(field.layout, Patch)
    np.testing.assert_array_equal(field.layout.normals[..., 2], 1.0)
    assert field.metadata["bounces"] == 0  # the first bounce would add nothing


def test_convex_mesh_is_the_clamped_cosine_in_every_frame() -> None:
    mesh = clean_mesh("ball", *(np.array(one) for one in _parts(shapes.icosphere(2))))
    field = bake_mesh(mesh, QUICK)
    np.testing.assert_allclose(
        field.vectors, np.tile(0.8 * unit_irradiance(3), (162, 1)), atol=1e-6
    )
    assert isinstance(field.layout, Surface)


def _parts(mesh):  # type: ignore[no-untyped-def]
    return mesh.vertices, mesh.faces


def test_turned_mesh_has_the_same_transfer_in_its_own_frames() -> None:
    mesh = two_balls()
    turn = Rotation.from_euler("xyz", [0.3, 1.1, -0.7]).as_matrix()
    turned = StaticMesh(
        *(
            (one @ turn.T).astype(np.float32)
            for one in (mesh.positions, mesh.normals, mesh.tangents)
        ),
        mesh.faces,
        mesh.vertices,
    )
    one, other = bake_mesh(mesh, QUICK), bake_mesh(turned, QUICK)
    assert one.metadata["energy"][1] > 0.01
    np.testing.assert_allclose(other.vectors, one.vectors, atol=3e-3)
    assert np.abs(one.vectors[:, 0] - 0.8 * unit_irradiance(3)[0]).max() > 0.05


def test_more_bounces_and_more_albedo_are_more_light() -> None:
    heights = 0.3 * relief("waffle", (16, 16))
    white = [
        bake_patch(heights, (1, 1), TILED, dataclasses.replace(QUICK, bounces=most)).vectors[:, 0]
        for most in (0, 1, 16)
    ]
    assert (white[1] >= white[0] - 1e-7).all()
    assert (white[2] >= white[1] - 1e-7).all()
    assert white[2].min() > 1.1 * white[0].min()
    black = bake_patch(heights, (1, 1), TILED, dataclasses.replace(QUICK, albedo=0.0))
    np.testing.assert_array_equal(black.transfer, 0.0)


def test_matte_material_has_the_matte_transfer() -> None:
    """Rows of a Lambert BRDF times its view function are the diffuse vectors."""
    heights = 0.3 * relief("bumps", (16, 16))
    matte = bake_patch(heights, (1, 1), TILED, QUICK)
    rows = brdf_rows(Lambert(0.8), 1, 3)
    glossy = bake_patch(heights, (1, 1), TILED, dataclasses.replace(QUICK, glossy=rows))
    assert glossy.view is not None
    seen = glossy.view[0, :, 1].mean() * glossy.transfer[:, 0]
    np.testing.assert_allclose(seen, matte.vectors, atol=1e-2 * matte.vectors.max())


def test_glossy_open_place_reflects_the_brdf() -> None:
    """Equation 15 with nothing hidden: the radiance of a view is the BRDF's own integral."""
    brdf = GGX(diffuse=0.2, specular=0.6, roughness=0.5)
    rows = brdf_rows(brdf, 9, 3)
    config = dataclasses.replace(QUICK, glossy=rows)
    field = bake_patch(np.zeros((2, 2)), (1, 1), TILED, config)
    assert field.view is not None
    light = np.random.default_rng(0).normal(size=9)
    directions, weights = sh.quadrature(127)
    up = directions[:, 2] > 0
    cell = 32 * 20 + 9
    view = _middle_of(cell)
    value = brdf(directions[up], view) * directions[up, 2:]
    radiance = sh.evaluate(directions[up], 3) @ light
    exact = (weights[up] * radiance) @ value
    found = np.einsum("bc,bj,j->c", field.view[:, cell], field.transfer[0], light)
    np.testing.assert_allclose(found, exact, rtol=0.03)


def _middle_of(cell: int) -> np.ndarray:
    from prtnet.hemisphere import cells

    return np.asarray(cells(32, 1, "concentric")[0][cell, 0])


def test_glossy_rows_are_in_the_patch_frame() -> None:
    """A gentle slope, whose sky is nearly open, turns the rows of its own frame with it."""
    angle = math.radians(18)
    rows = brdf_rows(GGX(roughness=0.5), 2, 3)
    x = np.arange(64) / 64
    ridge = np.abs((x * 4) % 1 - 0.5) / 4 * math.tan(angle)
    config = dataclasses.replace(QUICK, glossy=rows, rays=4096, bounces=0)
    field = bake_patch(np.tile(ridge, (2, 1)), (1.0, 1 / 32), TILED, config)
    top = 16 * 1 + 1  # just beside a ridge
    assert isinstance(field.layout, Patch)
    normal = field.layout.normals[0, top]
    np.testing.assert_allclose(normal, [math.sin(angle), 0, math.cos(angle)], atol=1e-5)
    frame = Rotation.from_rotvec([0, angle, 0]).as_matrix()
    expected = rotate(rows.harmonics(3), frame)
    error = np.abs(field.transfer[top] - expected).max() / np.abs(expected).max()
    assert error < 0.05
    assert np.abs(rows.harmonics(3) - expected).max() > 0.2 * np.abs(expected).max()


def test_scatter_on_a_plane_is_its_reflectance() -> None:
    marble = MATERIALS["marble"]
    config = dataclasses.replace(QUICK, medium=marble)
    field = bake_patch(np.zeros((24, 24)), (0.03, 0.03), TILED, config)
    expected = marble.reflectance() * unit_irradiance(3)
    np.testing.assert_allclose(field.vectors, np.tile(expected, (576, 1)), atol=0.006)


def test_light_comes_through_where_a_relief_is_thin() -> None:
    heights = 0.004 * relief("waffle", (18, 18))
    config = dataclasses.replace(QUICK, medium=MATERIALS["marble"], bounces=0)
    up, down = (sh.evaluate(np.array([[0, 0, z]]), 3)[0] for z in (1.0, -1.0))

    def lit(light: np.ndarray, thickness: float | None) -> np.ndarray:
        field = bake_patch(heights, (0.03, 0.03), TILED, config, thickness)
        return (field.vectors @ light).reshape(18, 18)

    behind = lit(down, 0.001) - lit(down, None)
    low, high = heights < heights.min() + 1e-4, heights > heights.max() - 1e-4
    assert behind[low].mean() > 1.5 * behind[high].mean() > 0
    thick = np.abs(lit(down, 0.3) - lit(down, None)).max()
    assert thick < 0.05 * behind.max()
    assert (lit(up, 0.001) > 0).all()


def test_scatter_in_a_mesh_knows_its_size() -> None:
    """A ball much larger than the medium's reach is as a plane; a small one is not."""
    mesh = clean_mesh("ball", *(np.array(one) for one in _parts(shapes.icosphere(3))))
    medium = MATERIALS["marble"]
    config = dataclasses.replace(QUICK, medium=medium)
    large = bake_mesh(mesh, config, metres=5.0).vectors
    expected = medium.reflectance() * unit_irradiance(3)
    np.testing.assert_allclose(large, np.tile(expected, (642, 1)), atol=0.01)
    small = bake_mesh(mesh, config, metres=0.01).vectors
    shaded = [(one[:, 2] / one[:, 0]).mean() for one in (large, small)]  # up against all around
    assert shaded[1] < 0.9 * shaded[0]


def test_metres_are_the_size_of_the_mesh() -> None:
    mesh = two_balls()
    config = dataclasses.replace(QUICK, medium=MATERIALS["marble"])
    longest = float(np.ptp(mesh.positions, axis=0).max())
    told = bake_mesh(mesh, config, metres=0.01)
    scaled = dataclasses.replace(mesh, positions=mesh.positions * np.float32(0.01 / longest))
    itself = bake_mesh(scaled, config)
    np.testing.assert_allclose(told.vectors, itself.vectors, atol=2e-4)
    assert np.abs(told.vectors - bake_mesh(mesh, config).vectors).max() > 0.02


def horizons(wrinkle: Wrinkle, x: np.ndarray, depth: float) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of the horizon towards −x and +x of places in a groove, in closed form but for max."""
    fine = np.linspace(0, 1, 40001)
    h = wrinkle.heights(fine, depth)
    left, right = [], []
    for place in x:
        here = wrinkle.heights(np.array(place), depth)
        run = (fine - place) * wrinkle.width
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (h - here) / np.abs(run)
        left.append(max(np.max(slope[run < -1e-9], initial=0.0), 0.0))
        right.append(max(np.max(slope[run > 1e-9], initial=0.0), 0.0))
    return np.array(left), np.array(right)


def test_wrinkle_is_shadowed_by_its_two_horizons() -> None:
    """A groove is endless: a direction is free where it rises over a line on either side."""
    wrinkle = Wrinkle(width=0.01, deepest=0.008, columns=9, rows=3)
    config = BakeConfig(order=3, rays=2048, bounces=0, albedo=1.0)
    field = bake_wrinkle(wrinkle, config)
    x = np.arange(9) / 8
    directions = sh.fibonacci_sphere(40000)
    basis = sh.evaluate(directions, 3) * (4 * math.pi / len(directions)) / math.pi
    for row, depth in enumerate(wrinkle.depths):
        left, right = horizons(wrinkle, x, depth)
        for column, normal in enumerate(wrinkle.normals(x, depth)):
            rise = np.where(directions[:, 0] < 0, left[column], right[column])
            free = directions[:, 2] > rise * np.abs(directions[:, 0])
            expected = (free * np.maximum(directions @ normal, 0)) @ basis
            found = field.vectors[row * 9 + column]
            np.testing.assert_allclose(found, expected, atol=0.012)
    # Flat where the groove is: the first row, and the edges of the others nearly.
    np.testing.assert_allclose(field.vectors[:9], np.tile(unit_irradiance(3), (9, 1)), atol=1e-6)


def test_wrinkle_map_lies_as_its_parameters_say() -> None:
    wrinkle = Wrinkle(width=0.02, deepest=0.01, columns=5, rows=3)
    field = bake_wrinkle(wrinkle, dataclasses.replace(QUICK, rays=64))
    assert isinstance(field.layout, Patch)
    assert field.layout.size == (0.02, 0.01)
    assert field.layout.tiles == (False, False)
    np.testing.assert_allclose(field.layout.heights[:, 2], [0, -0.005, -0.01], atol=1e-9)
    np.testing.assert_allclose(field.layout.heights[:, [0, 4]], 0, atol=1e-9)
    assert field.metadata["wrinkle"]["columns"] == 5
    # x → 1 − x mirrors the light.
    mirrored = field.vectors.reshape(3, 5, 9)[:, ::-1].copy()
    mirrored[..., [3, 4, 7]] *= -1  # odd in x: y₁₁, y₂₋₂, y₂₁
    np.testing.assert_allclose(field.vectors.reshape(3, 5, 9), mirrored, atol=0.02)


def test_shifted_tile_has_shifted_transfer() -> None:
    heights = 0.3 * relief("swirl", (16, 12))
    one = bake_patch(heights, (1.0, 0.75), TILED, QUICK).vectors.reshape(12, 16, -1)
    rolled = np.roll(heights, (5, 3), (0, 1))
    other = bake_patch(rolled, (1.0, 0.75), TILED, QUICK).vectors.reshape(12, 16, -1)
    np.testing.assert_allclose(other, np.roll(one, (5, 3), (0, 1)), atol=2e-3)
    assert np.abs(other - one).max() > 0.05


def test_size_alone_changes_nothing_without_scatter() -> None:
    heights = relief("bumps", (12, 12))
    one = bake_patch(0.2 * heights, (1.0, 1.0), TILED, QUICK).vectors
    other = bake_patch(2e-4 * heights, (1e-3, 1e-3), TILED, QUICK).vectors
    np.testing.assert_allclose(other, one, atol=1e-5)


@pytest.mark.parametrize("bad", [np.full((2, 2), np.nan), np.zeros((0, 0))])
def test_reliefs_that_are_none(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"height|rows"):
        bake_patch(bad, (1.0, 1.0), TILED, QUICK)


def test_wrinkle_that_scatters_is_flat_where_the_groove_is() -> None:
    """Its flat sides are as wide as the medium reaches, so the first row is the plane's."""
    skin = MATERIALS["skin"]
    wrinkle = Wrinkle(width=0.008, deepest=0.004, columns=5, rows=2)
    field = bake_wrinkle(wrinkle, dataclasses.replace(QUICK, medium=skin, rays=64))
    expected = skin.reflectance() * unit_irradiance(3)
    np.testing.assert_allclose(field.vectors[:5], np.tile(expected, (5, 1)), atol=0.003)
    assert np.abs(field.vectors[7] - expected).max() > 0.005  # at the bottom of the other
