from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from data_gen.generate import GenerateConfig, generate
from data_gen.pose_plan import plan_poses
from data_gen.procedural import arm
from data_gen.visibility import trace_pose
from prtnet.animation import Clip
from prtnet.dataset import POSE_ARRAYS, SAMPLED, Dataset
from prtnet.errors import PrtnetError
from prtnet.frames import FrameField
from prtnet.scene import SkinnedScene
from tests.data_gen.meshes import cache

CONFIG = GenerateConfig(count=5, rays=32, order=3, threads=2, block=4)
REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def scene() -> SkinnedScene:
    """An arm with three clips: its bend, and two parts of it."""
    whole = arm(segments=10)
    bend = whole.clips[0]
    middle = (bend.start + bend.end) / 2
    parts = (
        Clip("first", bend.start, middle, bend.channels),
        Clip("last", middle, bend.end, bend.channels),
    )
    return dataclasses.replace(whole, clips=(bend, *parts))


def same(a: Dataset, b: Dataset) -> None:
    for name in POSE_ARRAYS:
        np.testing.assert_array_equal(a.read(name), b.read(name))


def test_the_dataset_is_what_the_scene_does(scene: SkinnedScene, tmp_path: Path) -> None:
    config = dataclasses.replace(CONFIG, holdout=("last",), sample=3, seed=2)
    told: list[tuple[int, int]] = []
    summary = generate(scene, config, tmp_path / "arm.zarr", lambda _, *given: told.append(given))
    dataset = Dataset.open(summary.path)
    receivers = scene.receivers()
    assert (summary.poses, summary.resumed, len(dataset)) == (18, 0, 18)
    assert summary.rays == 18 * 32 * len(receivers)
    assert told == [(0, 18), (4, 18), (8, 18), (12, 18), (16, 18), (18, 18)]
    assert dataset.clip_names == ["bend", "first", "last", SAMPLED]
    assert dataset.held_out == ["last"]
    np.testing.assert_array_equal(dataset.held_out_poses(), np.arange(10, 15))
    np.testing.assert_array_equal(dataset.clip, np.repeat([0, 1, 2, 3], [5, 5, 5, 3]))
    clip = scene.clip("first")
    poses = scene.poses(clip, clip.times(count=5))
    np.testing.assert_allclose(dataset.time[5:10], clip.times(count=5), atol=1e-6)
    np.testing.assert_array_equal(dataset.poses[5:10], poses)
    surface = receivers.gather(scene.geometry(poses))
    np.testing.assert_array_equal(dataset.positions[5:10], surface.positions)
    np.testing.assert_array_equal(dataset.normals[5:10], surface.normals)
    field = FrameField(scene, receivers, dataset.rest_tangents)
    np.testing.assert_allclose(
        dataset.tangents[5:10], field.frames(poses, surface)[..., 0], atol=1e-6
    )
    np.testing.assert_allclose(
        dataset.visibility[5:10], trace_pose(scene, receivers, field, poses, 3, 32), atol=1e-5
    )
    sources = dataset.read("sources")
    np.testing.assert_array_equal(sources[:15], np.eye(4, dtype=bool)[dataset.clip[:15]])
    assert not sources[15:, 2:].any()  # neither the held-out clip nor the sampled poses
    assert sources[15:, :2].any(axis=1).all()
    np.testing.assert_array_equal(dataset.rest_pose, scene.rest_pose()[0])
    np.testing.assert_array_equal(dataset.joint_weights, scene.joint_weights[receivers.vertex])
    assert dataset.mesh_sha256 == scene.mesh_sha256


def test_threads_and_blocks_do_not_matter(scene: SkinnedScene, tmp_path: Path) -> None:
    config = dataclasses.replace(CONFIG, sample=3)
    one = generate(scene, config, tmp_path / "one.zarr").path
    other = dataclasses.replace(config, threads=3, block=3)
    same(Dataset.open(one), Dataset.open(generate(scene, other, tmp_path / "two.zarr").path))


def test_two_sided_caches(tmp_path: Path) -> None:
    frames = np.array([[[0, 0, 0], [1, 0, 0], [0, 0, 1]]] * 2, dtype=float)
    sheet = cache(frames, np.array([[0, 2, 1]]))
    config = dataclasses.replace(CONFIG, two_sided=True)
    dataset = Dataset.open(generate(sheet, config, tmp_path / "sheet.zarr").path)
    assert dataset.scene_kind == "point_cache"
    assert dataset.joint_weights is None
    np.testing.assert_array_equal(dataset.receiver_side, [1, 1, 1, -1, -1, -1])
    np.testing.assert_allclose(dataset.visibility[0][:, 0], np.sqrt(4 * np.pi), rtol=1e-6)
    normals = dataset.normals[0]
    np.testing.assert_array_equal(normals[3:], -normals[:3])


def test_poses_by_rate(scene: SkinnedScene) -> None:
    plan = plan_poses(scene, ("bend",), fps=5.0)
    clip = scene.clip("bend")
    assert len(plan) == round(clip.duration * 5) + 1


class StoppedError(Exception):
    """Raised in the middle of a run."""


def test_a_stopped_run_goes_on(scene: SkinnedScene, tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []

    def stop(what: str, done: int, total: int, _: str = "") -> None:
        told.append((what, done, total))
        if done >= total / 2:
            raise StoppedError

    with pytest.raises(StoppedError):
        generate(scene, CONFIG, tmp_path / "arm.zarr", stop)
    assert not (tmp_path / "arm.zarr").exists()
    assert {what for what, *_ in told} == {"poses"}
    told.clear()
    summary = generate(scene, CONFIG, tmp_path / "arm.zarr", lambda *given: told.append(given))
    assert 8 <= summary.resumed <= 15  # blocks that were under way were written
    blocks = -(-summary.resumed // CONFIG.block)
    read = [given for given in told if given[0] != "poses"]
    assert read == [("blocks read back", number + 1, blocks) for number in range(blocks)]
    assert told[-1] == ("poses", 15, 15)
    whole = generate(scene, CONFIG, tmp_path / "whole.zarr")
    assert whole.resumed == 0
    same(Dataset.open(summary.path), Dataset.open(whole.path))
    assert generate(scene, CONFIG, tmp_path / "whole.zarr").resumed == 0


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
def test_a_killed_run_goes_on(tmp_path: Path) -> None:
    """kill -9 in the middle; the rest is bit for bit what an undisturbed run writes."""
    scene = arm(segments=10)
    config = GenerateConfig(count=40, rays=64, threads=1, block=2)
    program = (
        "from data_gen.generate import GenerateConfig, generate\n"
        "from data_gen.procedural import arm\n"
        f"generate(arm(segments=10), GenerateConfig(count=40, rays=64, threads=1, block=2), "
        f"{str(tmp_path / 'arm.zarr')!r}, lambda _, done, __: print(done, flush=True))\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment, text=True
    ) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if int(line) >= 6:
                process.send_signal(signal.SIGKILL)
                break
        process.stdout.close()
        process.wait()
    assert process.returncode == -signal.SIGKILL
    assert not (tmp_path / "arm.zarr").exists()
    summary = generate(scene, config, tmp_path / "arm.zarr")
    assert 6 <= summary.resumed < 40
    undisturbed = generate(scene, config, tmp_path / "other.zarr")
    same(Dataset.open(summary.path), Dataset.open(undisturbed.path))


def test_a_flipped_bit_is_traced_again_to_the_same_bytes(
    scene: SkinnedScene, tmp_path: Path
) -> None:
    path = generate(scene, CONFIG, tmp_path / "arm.zarr").path
    before = {file: file.read_bytes() for file in path.rglob("*") if file.is_file()}
    chunk = path / "visibility/c/2/0/0"
    chunk.write_bytes(before[chunk][:50] + bytes([before[chunk][50] ^ 4]) + before[chunk][51:])
    with pytest.raises(PrtnetError, match=r"'visibility' is damaged in block 2; .* --repair"):
        Dataset.open(path).read("visibility")
    with pytest.raises(PrtnetError, match="was made with rays 32; repeat the command line"):
        generate(scene, dataclasses.replace(CONFIG, rays=40), path, repair=True)
    summary = generate(scene, CONFIG, path, repair=True)
    assert summary.mended == ("block 2 of visibility",)
    assert (summary.poses, summary.resumed) == (15, 11)
    assert {file: file.read_bytes() for file in path.rglob("*") if file.is_file()} == before
    assert generate(scene, CONFIG, path, repair=True).mended == ()


def test_other_options_start_over(scene: SkinnedScene, tmp_path: Path) -> None:
    def stop(_: str, done: int, total: int, __: str = "") -> None:
        if done:
            raise StoppedError

    with pytest.raises(StoppedError):
        generate(scene, CONFIG, tmp_path / "arm.zarr", stop)
    more = dataclasses.replace(CONFIG, rays=40)
    assert generate(scene, more, tmp_path / "arm.zarr").resumed == 0


def complaint(scene: SkinnedScene, tmp_path: Path, **options: object) -> str:
    with pytest.raises(PrtnetError) as caught:
        generate(scene, dataclasses.replace(CONFIG, **options), tmp_path / "no.zarr")
    assert list(tmp_path.iterdir()) == []
    return str(caught.value)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"clips": ("bund",)}, "has no clip 'bund'; did you mean 'bend'?"),
        ({"holdout": ("lost",)}, "has no clip 'lost'; did you mean 'last'?"),
        ({"clips": ("bend",), "holdout": ("last",)}, "'last' is not among --clips"),
        ({"clips": ("bend",), "holdout": ("bend",)}, "leaves no clip to train on"),
        ({"holdout": ("bend", "first", "last")}, "leaves no clip to train on"),
        ({"holdout": ("bend@0.1:0.2",)}, "holds no pose"),
        ({"holdout": ("bend@0:4",), "clips": ("bend",)}, "leaves no clip to train on"),
        ({"holdout": ("bend@0.2:",), "clips": ("bend",)}, "leaves no clip to train on"),
        ({"holdout": ("bend@9:12",)}, "'bend' runs from 0 to 4 s; give a range inside it"),
        ({"holdout": ("bund@1:2",)}, "has no clip 'bund'; did you mean 'bend'?"),
        ({"holdout": ("bend@1:2",), "clips": ("last",)}, "'bend' is not among --clips"),
        ({"holdout": ("bend@1:2", "bend@2:3")}, "'bend@2:3' is held out twice"),
        ({"holdout": ("bend", "bend@2:3")}, "'bend@2:3' is held out twice"),
        ({"rays": 0}, "--rays: must be at least 1"),
        ({"order": 0}, "--order: must be at least 1"),
        ({"sample": -1}, "--sample: must be at least 0"),
        ({"fps": 10.0}, "--fps: and --count exclude each other"),
        ({"fps": -1.0, "count": None}, "--fps: must be a positive number"),
        ({"fps": float("nan"), "count": None}, "--fps: must be a positive number"),
        ({"count": 0}, "--count: must be at least 1"),
    ],
)
def test_impossible_options(
    scene: SkinnedScene, tmp_path: Path, options: dict[str, object], words: str
) -> None:
    assert words in complaint(scene, tmp_path, **options)


def test_part_of_a_clip_is_held_out_with_a_guard(scene: SkinnedScene) -> None:
    plan = plan_poses(scene, ("first", "bend"), ("bend@2.4:3", "bend@0.9:1"), count=41)
    assert plan.clip_names == ("first", "bend", "bend@0.9:1", "bend@2.4:3")
    assert plan.held_out == ("bend@2.4:3", "bend@0.9:1")
    times = [plan.time[plan.clip == index] for index in range(4)]
    assert len(times[0]) == 41
    every = np.linspace(0.0, 4.0, 41)
    near = ((every > 0.4 + 1e-9) & (every < 1.5 - 1e-9)) | (
        (every > 1.9 + 1e-9) & (every < 3.5 - 1e-9)
    )
    np.testing.assert_allclose(times[1], every[~near])
    np.testing.assert_allclose(times[2], [0.9, 1.0])
    np.testing.assert_allclose(times[3], np.arange(24, 31) / 10)
    poses, sources = plan.poses(slice(0, len(plan)))
    np.testing.assert_array_equal(sources, np.eye(4, dtype=bool)[plan.clip])
    bend = scene.poses(scene.clip("bend"), plan.time[41:])
    np.testing.assert_array_equal(poses[41:], bend)


def test_sampled_poses_keep_away_from_parts_held_out(scene: SkinnedScene) -> None:
    """The joint bends with time alone, so a pose tells the time it was taken from."""
    plan = plan_poses(
        scene, ("bend", "first"), ("bend@1.2:4", "first"), count=5, sample=30, margin=0.0
    )
    poses, sources = plan.poses(slice(len(plan) - 30, len(plan)))
    np.testing.assert_array_equal(sources, [[True, False, False, False]] * 30)
    allowed = scene.poses(scene.clip("bend"), np.linspace(0.0, 0.7, 50))
    low, high = allowed.min(axis=0), allowed.max(axis=0)
    assert ((poses > low - 0.02) & (poses < high + 0.02)).all()
    # From both sides of a part: both are the clip.
    plan = plan_poses(scene, ("bend",), ("bend@1.9:2.1",), count=9, sample=30)
    _, sources = plan.poses(slice(len(plan) - 30, len(plan)))
    np.testing.assert_array_equal(sources, [[True, False, False]] * 30)


def test_point_caches_cannot_be_sampled(tmp_path: Path) -> None:
    sheet = cache(np.zeros((2, 3, 3)), np.array([[0, 1, 2]]))
    assert "--sample: recombines" in complaint(sheet, tmp_path, sample=3)


def test_clips_named_twice_are_traced_once(scene: SkinnedScene) -> None:
    plan = plan_poses(scene, ("bend", "first", "bend"), ("first", "first"), count=2)
    assert plan.clip_names == ("bend", "first")
    assert plan.held_out == ("first",)


def test_a_clip_that_is_named_as_the_sampled_ones(scene: SkinnedScene) -> None:
    odd = dataclasses.replace(scene, clips=(Clip(SAMPLED, 0.0, 1.0),))
    with pytest.raises(PrtnetError, match="rename it"):
        plan_poses(odd, sample=1)
