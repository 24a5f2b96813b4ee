from __future__ import annotations

import numpy as np
import pytest
import trimesh.creation as shapes

import data_gen.visibility
from data_gen.procedural import arm
from data_gen.visibility import Hemisphere, PoseTracer, Tracer, repeat_rows, trace_pose
from prtnet.frames import FrameField, rest_tangents
from prtnet.scene import SkinnedScene
from tests.data_gen.meshes import smooth, visibility


@pytest.fixture(scope="module")
def scene() -> SkinnedScene:
    return arm(segments=10)


def bent(scene: SkinnedScene, count: int = 3) -> np.ndarray:
    return scene.poses(scene.clips[0], scene.clips[0].times(count=count))


def test_true_visibility_of_poses(scene: SkinnedScene) -> None:
    """The same from any number of threads, and pose by pose."""
    receivers = scene.receivers()
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    poses = bent(scene)
    one = trace_pose(scene, receivers, field, poses, 4, 64)
    assert one.shape == (3, len(receivers), 16)
    assert one.dtype == np.float32
    np.testing.assert_array_equal(trace_pose(scene, receivers, field, poses, 4, 64, threads=3), one)
    tracer = PoseTracer(scene, receivers, field, 4, 64)
    traced = [tracer(pose) for pose in poses]
    np.testing.assert_array_equal(np.stack([each.visibility for each in traced]), one)
    frames = field.frames(poses)
    np.testing.assert_array_equal(traced[1].tangents, frames[1, ..., 0])
    np.testing.assert_allclose(traced[1].normals, frames[1, ..., 2], atol=1e-6)
    assert np.ptp(one[:, :, 0], axis=0).max() > 0.1  # the bend shadows itself


def test_lower_orders_are_the_head_of_higher_ones() -> None:
    mesh = smooth(shapes.torus(1.0, 0.4))
    low, high = (visibility(mesh, rays=64, order=order) for order in (2, 5))
    np.testing.assert_allclose(low, high[:, :4], atol=1e-5)


@pytest.mark.parametrize("batch", [1, 100, 1000])
def test_batches_do_not_matter(batch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = smooth(shapes.torus(1.0, 0.4, major_sections=12, minor_sections=9))
    whole = visibility(mesh, rays=30)
    monkeypatch.setattr(data_gen.visibility, "BATCH", batch)
    np.testing.assert_allclose(visibility(mesh, rays=30), whole, atol=1e-5)


def test_all_hits_take_the_upper_half_away() -> None:
    """The directions' equal weights add up to 2π, and to ∫cos = π over the hemisphere."""
    hemisphere = Hemisphere(2, 512)
    total = -hemisphere.basis.sum(axis=0)
    y0, y1 = np.sqrt(1 / (4 * np.pi)), np.sqrt(3 / (4 * np.pi))
    np.testing.assert_allclose(total, [2 * np.pi * y0, 0, np.pi * y1, 0], atol=5e-3)


def test_rays_are_blocked_by_triangles_from_both_sides() -> None:
    tracer = Tracer(np.array([[-1, 5, -1], [1, 5, -1], [0, 5, 1]], dtype=np.float32) * 3,
                    np.array([[0, 1, 2]]))  # fmt: skip
    above, below = np.array([[0, 16, 0]]), np.array([[0, 14, 0]])
    for place, direction, hit in ((above, -1, True), (below, 1, True), (above, 1, False)):
        origins = tracer.origins(place, np.zeros((1, 3)))
        directions = np.array([[0, direction, 0]], dtype=np.float32)
        assert tracer.occluded(origins, directions)[0] == hit


@pytest.mark.parametrize("count", [1, 2, 7, 64])
def test_rows_are_repeated(count: int) -> None:
    rows = np.random.default_rng(0).normal(size=(5, 3))
    out = np.empty((5, count, 3))
    repeat_rows(rows, out)
    np.testing.assert_array_equal(out, np.repeat(rows[:, None], count, axis=1))
