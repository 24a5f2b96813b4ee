"""Hits against slow references: every triangle tried, and small steps over an endless tile."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.casters import MeshCaster, PatchCaster
from data_gen.reliefs import relief
from prtnet import sh
from prtnet.axis_frames import any_tangent


def ball_on_a_plate() -> MeshCaster:
    ball = shapes.icosphere(1, radius=0.5).apply_translation([0.1, 0, 0.7])
    plate = shapes.box([2, 2, 0.1])
    both = ball + plate
    normals = np.array(both.vertex_normals)
    return MeshCaster(
        np.array(both.vertices), np.array(both.faces, dtype=np.int32), normals, any_tangent(normals)
    )


def every_triangle(
    origin: np.ndarray, direction: np.ndarray, corners: np.ndarray
) -> tuple[int, np.ndarray]:
    """The nearest of the triangles (T, 3, 3) that a ray meets, −1 for none; its weights."""
    a, b, c = corners.transpose(1, 0, 2)
    system = np.stack([b - a, c - a, np.broadcast_to(-direction, a.shape)], axis=-1)
    good = np.abs(np.linalg.det(system)) > 1e-14
    solved = np.full((len(a), 3), -1.0)
    solved[good] = np.linalg.solve(system[good], (origin - a)[good][..., None])[..., 0]
    u, v, t = solved.T
    met = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    if not met.any():
        return -1, np.zeros(3)
    best = int(np.argmin(np.where(met, t, np.inf)))
    return best, np.array([1 - u[best] - v[best], u[best], v[best]])


def test_mesh_hits_are_those_of_trying_every_triangle() -> None:
    caster = ball_on_a_plate()
    local = sh.fibonacci_hemisphere(60)
    directions = (local @ caster.frames.transpose(0, 2, 1)).astype(np.float32)
    hits = caster.cast(slice(0, len(caster)), directions)
    corners = caster.tracer.normalise(caster.positions)[caster.faces]
    flat = directions.reshape(-1, 3).astype(float)
    found = {ray: (c, w) for ray, c, w in zip(hits.ray, hits.corners, hits.weights, strict=True)}
    wrong = 0
    for ray, direction in enumerate(flat):
        face, weights = every_triangle(caster.starts[ray // 60].astype(float), direction, corners)
        if (face >= 0) != (ray in found):
            wrong += 1  # by an edge's rounding
        elif face >= 0:
            normal = np.cross(*(corners[face, 1:] - corners[face, 0]))
            expected = weights if normal @ direction < 0 else np.zeros(3)
            assert set(caster.faces[face]) == set(found[ray][0])
            np.testing.assert_allclose(found[ray][1], expected, atol=1e-4)
    assert len(found) > 300
    assert wrong <= 2


def walked(caster: PatchCaster, origin: np.ndarray, direction: np.ndarray) -> bool:
    """Whether a ray meets the endless relief, by small steps over its triangles."""
    step = caster.step
    top = caster.heights.max()
    length = (top - origin[2]) / direction[2] if direction[2] > 0 else 50.0
    t = np.arange(1e-3, min(length, 50.0), 0.04 * step.min())
    place = origin + t[:, None] * direction
    rows, columns = caster.heights.shape
    x, y = place[:, 0] / step[0] - 0.5, place[:, 1] / step[1] - 0.5
    c, r = np.floor(x).astype(int), np.floor(y).astype(int)
    u, v = x - c, y - r

    def at(row: np.ndarray, column: np.ndarray) -> np.ndarray:
        row = row % rows if caster.tiles[1] else np.clip(row, 0, rows - 1)
        column = column % columns if caster.tiles[0] else np.clip(column, 0, columns - 1)
        return caster.heights[row, column]

    a, b, d, e = at(r, c), at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)
    under = np.where(u >= v, a + u * (b - a) + v * (d - b), a + v * (e - a) + u * (d - e))
    return bool((place[:, 2] < under - 1e-6).any())


@pytest.mark.parametrize("tiles", [(True, True), (True, False), (False, False)])
def test_patch_hits_are_those_of_walking_over_it(tiles: tuple[bool, bool]) -> None:
    heights = 0.25 * relief("bumps", (12, 10), seed=5)
    caster = PatchCaster(heights, (1.2, 1.0), tiles)
    local = sh.fibonacci_hemisphere(40)
    directions = (local @ caster.frames.transpose(0, 2, 1)).astype(np.float32)
    hits = caster.cast(slice(0, len(caster)), directions)
    hit = np.zeros(len(caster) * 40, dtype=bool)
    hit[hits.ray] = True
    starts = caster.starts * caster.tracer.scale + caster.tracer.centre
    expected = np.array(
        [walked(caster, starts[k // 40], d) for k, d in enumerate(directions.reshape(-1, 3))]
    )
    steep = directions.reshape(-1, 3)[:, 2] > 0.02 if not all(tiles) else np.ones(len(hit), bool)
    assert expected.mean() > 0.02
    assert np.mean((hit != expected)[steep]) < 2e-3


def test_hits_lie_where_the_ray_goes() -> None:
    """The point that three corners and their weights make is on the ray, but for whole tiles."""
    heights = 0.5 * relief("waffle", (24, 24))
    caster = PatchCaster(heights, (1.0, 1.0))
    local = sh.fibonacci_hemisphere(50)
    directions = (local @ caster.frames.transpose(0, 2, 1)).astype(np.float32)
    hits = caster.cast(slice(0, len(caster)), directions)
    lit = hits.weights.sum(axis=1) > 0.5
    assert lit.mean() > 0.95
    corners = caster.positions[hits.corners[lit]].copy()
    for axis in range(2):  # a triangle over the border has corners on either side
        first = corners[:, :1, axis]
        corners[:, :, axis] += np.round(first - corners[:, :, axis])
    place = np.einsum("hc,hci->hi", hits.weights[lit], corners)
    starts = caster.starts * caster.tracer.scale + caster.tracer.centre
    way = directions.reshape(-1, 3)[hits.ray[lit]].astype(float)
    start = starts[hits.ray[lit] // 50]
    steep = np.abs(way[:, 2]) > 0.1
    t = (place[:, 2] - start[:, 2])[steep] / way[steep, 2]
    off = start[steep, :2] + t[:, None] * way[steep, :2] - place[steep, :2]
    off -= np.round(off)
    assert np.quantile(np.abs(off), 0.999) < 2e-3


def test_tiles_may_be_shifted() -> None:
    heights = 0.3 * relief("swirl", (16, 16))
    one = PatchCaster(heights, (1.0, 1.0))
    other = PatchCaster(np.roll(heights, (3, 5), (0, 1)), (1.0, 1.0))
    rolled = np.roll(one.frames.reshape(16, 16, 3, 3), (3, 5), (0, 1)).reshape(-1, 3, 3)
    np.testing.assert_allclose(other.frames, rolled, atol=1e-12)
    rolled = np.roll(one.areas.reshape(16, 16), (3, 5), (0, 1)).ravel()
    np.testing.assert_allclose(other.areas, rolled, rtol=1e-9)


def test_border_goes_on_outwards() -> None:
    """A step up to the border is a wall without end beyond it, and nothing comes back."""
    heights = np.zeros((8, 8))
    heights[:, -1] = 0.5
    up = np.broadcast_to(np.array([[1, 0, 0.2], [-1, 0, 0.02]], np.float32), (64, 2, 3))
    clamped = PatchCaster(heights, (1.0, 1.0), (False, False)).cast(slice(0, 64), up.copy())
    tiled = PatchCaster(heights, (1.0, 1.0), (True, True)).cast(slice(0, 64), up.copy())
    first = 8 * 3 + 2  # a texel on the floor
    assert 2 * first in clamped.ray
    assert 2 * first + 1 not in clamped.ray
    assert 2 * first + 1 in tiled.ray


def test_flat_patch_hides_nothing() -> None:
    caster = PatchCaster(np.full((4, 4), 7.0), (1.0, 1.0))
    directions = np.broadcast_to(sh.fibonacci_hemisphere(500).astype(np.float32), (16, 500, 3))
    assert len(caster.cast(slice(0, 16), directions).ray) == 0


@pytest.mark.parametrize(
    "heights", [np.zeros((0, 3)), np.zeros(3), np.full((2, 2), np.nan), np.full((2, 2), -np.inf)]
)
def test_reliefs_that_are_none(heights: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"height|rows"):
        PatchCaster(heights, (1.0, 1.0))
    with pytest.raises(ValueError, match="too far"):
        PatchCaster(np.array([[0.0, 1e30]]), (1.0, 1.0))
    with pytest.raises(ValueError, match="upwards"):
        PatchCaster(np.array([[0.0, np.inf]]), (1.0, 1.0))


def test_more_than_can_be_traced_is_refused() -> None:
    with pytest.raises(ValueError, match="too much"):
        PatchCaster(np.zeros((2, 3000)), (1.0, 1e-4))


def test_backs_send_no_light() -> None:
    """A sheet over a floor faces up: from below its back is hit, and hides without shining."""
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], dtype=float)
    positions = np.concatenate([square, 2 * square + [0, 0, 0.5]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], dtype=np.int32)
    up = np.tile([0.0, 0.0, 1.0], (8, 1))
    caster = MeshCaster(positions, faces, up, any_tangent(up))
    straight = np.broadcast_to(np.array([0, 0, 1], np.float32), (8, 1, 3)).copy()
    hits = caster.cast(slice(0, 8), straight)
    assert hits.ray.tolist() == [0, 1, 2, 3]
    np.testing.assert_array_equal(hits.weights, 0.0)
    down = MeshCaster(positions, faces[:, ::-1].copy(), up, any_tangent(up))
    np.testing.assert_allclose(down.cast(slice(0, 8), straight).weights.sum(axis=1), 1.0)


@pytest.mark.parametrize("tiles", [(True, True), (True, False), (False, True), (False, False)])
def test_what_falls_lands(tiles: tuple[bool, bool]) -> None:
    """From a hill every falling ray meets the relief or what goes on beyond its border."""
    heights = np.zeros((10, 10))
    heights[5, 5] = 0.3
    caster = PatchCaster(heights, (1.0, 1.0), tiles)
    around = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    falling = np.stack([np.cos(around), np.sin(around), np.full(64, -0.05)], axis=1)
    directions = falling[None].astype(np.float32)
    hits = caster.cast(slice(55, 56), directions)
    assert hits.ray.tolist() == list(range(64))
    np.testing.assert_allclose(hits.weights.sum(axis=1), 1.0, atol=1e-6)
    far = hits.weights[:, 0] == 1.0  # a texel of the border alone
    assert far.any() == (tiles != (True, True))
    row, column = np.divmod(hits.corners[far, 0], 10)
    ends = np.zeros(far.sum(), dtype=bool)
    for index, goes_on in ((column, tiles[0]), (row, tiles[1])):
        ends |= (not goes_on) & np.isin(index, (0, 9))
    assert ends.all()
