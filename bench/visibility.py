"""Ray-traced visibility: noise, speed against bare embreex, and memory.

python bench/visibility.py noise [SCENE …] [--write]     error of few rays against many
python bench/visibility.py speed [SCENE …] [--write]     generate against bare embreex calls
python bench/visibility.py memory [SCENE …] [--write]    peak memory of generate
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
from tables import per_cent, publish, scene_path

from data_gen.generate import GenerateConfig, generate
from data_gen.rays import border_operator, departure
from data_gen.readers import read_scene
from data_gen.visibility import BATCH, Hemisphere, Tracer, trace_pose
from prtnet.arrays import FloatArray
from prtnet.frames import FrameField, rest_tangents
from prtnet.scene import Scene

TRUTH = 16384  # rays
FEW = (64, 128, 256, 512, 1024)
REPEATS = 3


def some_poses(scene: Scene, count: int) -> FloatArray:
    """Poses from the middle of as many clips, at most."""
    clips = scene.clips[:count]
    return np.concatenate(
        [scene.poses(clip, np.array([(clip.start + clip.end) / 2])) for clip in clips]
    )


def noise(path: Path, threads: int) -> list[str]:
    """Relative RMS of visibility traced with FEW numbers of rays."""
    scene = read_scene(path)
    receivers = scene.receivers()
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    poses = some_poses(scene, 2)
    truth = trace_pose(scene, receivers, field, poses, 4, TRUTH, threads)
    errors = []
    for rays in FEW:
        few = trace_pose(scene, receivers, field, poses, 4, rays, threads)
        errors.append(per_cent(float(np.linalg.norm(few - truth) / np.linalg.norm(truth))))
    return [scene.name, *errors]


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


def speed(path: Path, threads: int, count: int) -> list[str]:
    """Rays a second of whole runs of ``generate``, and of embreex alone on the same rays."""
    scene = read_scene(path)
    clip = max(scene.clips, key=lambda each: each.duration)
    config = GenerateConfig(clips=(clip.name,), count=count, threads=threads)
    poses = scene.poses(clip, clip.times(count=count))
    whole, bare, share = [], [], []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            summary = generate(scene, config, Path(folder) / "out.zarr")
        whole.append(summary.rays / summary.seconds / 1e6)
        bare.append(summary.rays / bare_seconds(scene, poses, config.rays, threads) / 1e6)
        share.append(whole[-1] / bare[-1])
    medians = [f"{statistics.median(rates):.2f}" for rates in (whole, bare)]
    return [scene.name, str(count), *medians, f"{100 * statistics.median(share):.0f} %"]


def memory(path: Path, threads: int, poses: int) -> list[str]:
    """Peak resident memory of this process after ``generate``; few rays, as they do not matter."""
    scene = read_scene(path)
    count = max(1, poses // len(scene.clips))
    with tempfile.TemporaryDirectory() as folder:
        config = GenerateConfig(count=count, rays=16, threads=threads)
        summary = generate(scene, config, Path(folder) / "out.zarr")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return [scene.name, str(summary.poses), f"{peak:.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["noise", "speed", "memory"])
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--poses", type=int, default=None)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    threads = arguments.threads
    default = ["human.glb"] if arguments.what == "memory" else ["robot.glb", "human.glb"]
    paths = arguments.scenes or [scene_path(name) for name in default]
    if arguments.what == "noise":
        columns = ["scene", *(f"{rays} rays" for rays in FEW)]
        publish("noise", columns, [noise(path, threads) for path in paths])
    elif arguments.what == "speed":
        columns = ["scene", "poses", "generate, M rays/s", "embreex, M rays/s", "share"]
        rows = [speed(path, threads, arguments.poses or 16) for path in paths]
        publish("speed", columns, rows, f"Medians of {REPEATS} runs.")
    else:
        rows = [memory(path, threads, arguments.poses or 1000) for path in paths]
        publish("memory", ["scene", "poses", "peak, GB"], rows)


if __name__ == "__main__":
    main()
