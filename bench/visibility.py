"""Ray-traced visibility: noise, speed against bare embreex, and memory.

python bench/visibility.py noise SCENE [SCENE …]     error of few rays against many
python bench/visibility.py speed SCENE [SCENE …]     `generate` against bare embreex calls
python bench/visibility.py memory SCENE              peak memory of `generate`
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from data_gen.generate import GenerateConfig, generate
from data_gen.rays import border_operator, departure
from data_gen.readers import read_scene
from data_gen.visibility import BATCH, Hemisphere, Tracer, trace_pose
from prtnet.arrays import FloatArray
from prtnet.frames import FrameField, rest_tangents
from prtnet.scene import Scene

TRUTH = 16384  # rays


def some_poses(scene: Scene, count: int) -> FloatArray:
    """Poses from the middle of as many clips, at most."""
    clips = scene.clips[:count]
    return np.concatenate(
        [scene.poses(clip, np.array([(clip.start + clip.end) / 2])) for clip in clips]
    )


def noise(path: Path, threads: int) -> None:
    """Relative RMS of visibility traced with fewer rays."""
    scene = read_scene(path)
    receivers = scene.receivers()
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    poses = some_poses(scene, 2)
    truth = trace_pose(scene, receivers, field, poses, 4, TRUTH, threads)
    print(f"{scene.name}: {len(receivers)} receivers, {len(poses)} poses, against {TRUTH} rays")
    for rays in (64, 128, 256, 512, 1024):
        few = trace_pose(scene, receivers, field, poses, 4, rays, threads)
        error = np.linalg.norm(few - truth) / np.linalg.norm(truth)
        print(f"  {rays:5d} rays: {100 * error:.2f} %", flush=True)


def bare_seconds(scene: Scene, poses: FloatArray, rays: int, threads: int) -> float:
    """Seconds in which the threads call embreex on all rays of the poses, made beforehand."""
    receivers = scene.receivers()
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    inward, hemisphere = border_operator(scene.faces, receivers), Hemisphere(4, rays)
    seconds = 0.0
    size = BATCH // rays
    for pose in poses:
        mesh = scene.geometry(pose[None])
        surface = receivers.gather(mesh)
        tracer = Tracer(mesh.positions[0], scene.faces)
        away = departure(surface.normals[0], inward @ mesh.positions[0])
        starts = tracer.origins(surface.positions[0], away)
        frames = field.frames(pose[None], surface)[0]
        batches = []
        for first in range(0, len(receivers), size):
            batch = slice(first, first + size)
            directions = np.matmul(hemisphere.directions, frames[batch].transpose(0, 2, 1))
            origins = np.repeat(starts[batch], rays, axis=0)
            batches.append((origins, directions.reshape(-1, 3)))
        tracer.scene.run(*(array[:1] for array in batches[0]), query="OCCLUDED")  # builds the BVH
        with ThreadPoolExecutor(threads) as pool:
            start = time.perf_counter()
            list(pool.map(lambda b: tracer.scene.run(*b, query="OCCLUDED"), batches))  # noqa: B023
            seconds += time.perf_counter() - start
    return seconds


def speed(path: Path, threads: int, count: int, repeats: int) -> None:
    """Rays a second of whole runs of ``generate``, and of embreex alone on the same rays."""
    scene = read_scene(path)
    clip = max(scene.clips, key=lambda each: each.duration)
    config = GenerateConfig(clips=(clip.name,), count=count, threads=threads)
    poses = scene.poses(clip, clip.times(count=count))
    whole, bare, total = [], [], 0
    for _ in range(repeats):
        with tempfile.TemporaryDirectory() as folder:
            summary = generate(scene, config, Path(folder) / "out.zarr")
        whole.append(summary.rays / summary.seconds / 1e6)
        bare.append(summary.rays / bare_seconds(scene, poses, config.rays, threads) / 1e6)
        total = summary.rays
    a, b = statistics.median(whole), statistics.median(bare)
    print(
        f"{scene.name}: {count} poses, {total / 1e6:.0f} M rays, {threads} threads: "
        f"generate {a:.2f} M rays/s, embreex alone {b:.2f} M rays/s: {100 * a / b:.0f} %",
        flush=True,
    )


def memory(path: Path, threads: int, poses: int) -> None:
    """Peak resident memory of this process after ``generate``."""
    scene = read_scene(path)
    count = max(1, poses // len(scene.clips))
    with tempfile.TemporaryDirectory() as folder:
        config = GenerateConfig(count=count, rays=16, threads=threads)
        summary = generate(scene, config, Path(folder) / "out.zarr")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"{scene.name}: {summary.poses} poses, peak {peak:.2f} GB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["noise", "speed", "memory"])
    parser.add_argument("scenes", nargs="+", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--poses", type=int, default=None)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    for path in arguments.scenes:
        if arguments.what == "noise":
            noise(path, arguments.threads)
        elif arguments.what == "speed":
            speed(path, arguments.threads, arguments.poses or 16, arguments.repeats)
        else:
            memory(path, arguments.threads, arguments.poses or 1000)


if __name__ == "__main__":
    main()
