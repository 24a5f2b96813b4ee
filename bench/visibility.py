"""Ray-traced visibility: noise, speed against bare embreex and Mitsuba 3, and memory.

python bench/visibility.py [--write]                     all of it
python bench/visibility.py noise [SCENE …] [--write]     error of few rays against many
python bench/visibility.py speed [SCENE …] [--write]     generate against bare calls of its peers
python bench/visibility.py memory [SCENE …] [--write]    peak memory of generate

Mitsuba is no dependency. To have it measured: `pip install mitsuba`, and DRJIT_LIBLLVM_PATH set to
the shared object of LLVM 19 where Dr.Jit does not find one.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from tables import per_cent, publish, scene_path

from data_gen.generate import GenerateConfig, generate
from data_gen.rays import border_operator, departure
from data_gen.readers import read_scene
from data_gen.visibility import BATCH, Hemisphere, Tracer, trace_pose
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.frames import FrameField, rest_tangents
from prtnet.scene import Scene

TRUTH = 16384  # rays
FEW = (64, 128, 256, 512, 1024)
REPEATS = 3
AGREEMENT = 0.999  # of the peers' hits; rays that graze an edge may differ


@dataclass(frozen=True, eq=False)
class PosedRays:
    """The triangles of one pose and all rays against them, in the tracer's coordinates."""

    tracer: Tracer
    vertices: FloatArray  # [V_render, 3] float32
    faces: IntArray  # [T, 3]
    batches: list[tuple[FloatArray, FloatArray]]  # origins and directions [N, 3] float32


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


def posed_rays(scene: Scene, poses: FloatArray, rays: int) -> Iterator[PosedRays]:
    """What ``generate`` traces, pose by pose, made beforehand."""
    receivers = scene.receivers()
    field = FrameField(scene, receivers, rest_tangents(scene, receivers))
    inward, hemisphere = border_operator(scene.faces, receivers), Hemisphere(4, rays)
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
        vertices = tracer.normalise(mesh.positions[0]).astype(np.float32)
        yield PosedRays(tracer, vertices, scene.faces, batches)


def embreex_hits(posed: PosedRays, threads: int) -> tuple[float, BoolArray]:
    """Seconds in which the threads call embreex on all rays of a pose, and which of them hit."""
    scene, batches = posed.tracer.scene, posed.batches
    scene.run(*(array[:1] for array in batches[0]), query="OCCLUDED")  # builds the BVH
    with ThreadPoolExecutor(threads) as pool:
        start = time.perf_counter()
        hits = list(pool.map(lambda batch: scene.run(*batch, query="OCCLUDED"), batches))
        seconds = time.perf_counter() - start
    return seconds, np.concatenate(hits) != -1


def import_mitsuba() -> ModuleType | None:
    """Mitsuba 3 for the processor; it is no dependency, and needs LLVM, so it may be absent."""
    try:
        import mitsuba

        mitsuba.set_variant("llvm_ad_rgb")
    except ImportError:
        return None
    return mitsuba


def mitsuba_hits(mi: ModuleType, posed: PosedRays, threads: int) -> tuple[float, BoolArray]:
    """Seconds of one call of Mitsuba's ``ray_test`` on all rays of a pose, and which of them hit.

    Triangles and rays are on its side beforehand, and the kernel is compiled.
    """
    import drjit as dr

    dr.set_thread_count(threads)
    mesh = mi.Mesh("pose", len(posed.vertices), len(posed.faces))
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = mi.Float(posed.vertices.ravel())
    parameters["faces"] = mi.UInt32(posed.faces.ravel().astype(np.uint32))
    parameters.update()
    scene = mi.load_dict({"type": "scene", "mesh": mesh})
    origins, directions = (
        np.ascontiguousarray(np.concatenate(arrays).T)
        for arrays in zip(*posed.batches, strict=True)
    )
    ray = mi.Ray3f(mi.Point3f(origins), mi.Vector3f(directions))
    dr.eval(ray)
    for _ in range(2):  # the first call compiles and warms up
        dr.sync_thread()
        start = time.perf_counter()
        hits = scene.ray_test(ray)
        dr.eval(hits)
        dr.sync_thread()
        seconds = time.perf_counter() - start
    return seconds, hits.numpy()


def peer_seconds(
    scene: Scene, poses: FloatArray, rays: int, threads: int
) -> tuple[float, float | None]:
    """Seconds of embreex alone, and of Mitsuba where there is one, on the rays of ``generate``."""
    mi = import_mitsuba()
    embreex, mitsuba = 0.0, 0.0
    for posed in posed_rays(scene, poses, rays):
        seconds, hits = embreex_hits(posed, threads)
        embreex += seconds
        if mi is not None:
            seconds, same = mitsuba_hits(mi, posed, threads)
            mitsuba += seconds
            agreement = float(np.mean(hits == same))
            if agreement < AGREEMENT:
                sys.exit(f"{scene.name}: Mitsuba and embreex agree on {per_cent(agreement)} only")
    return embreex, None if mi is None else mitsuba


def speed(path: Path, threads: int, count: int) -> list[str]:
    """Rays a second of whole runs of ``generate``, and of its peers alone on the same rays."""
    scene = read_scene(path)
    clip = max(scene.clips, key=lambda each: each.duration)
    config = GenerateConfig(clips=(clip.name,), count=count, threads=threads)
    poses = scene.poses(clip, clip.times(count=count))
    whole, bare, share, other = [], [], [], []
    for _ in range(REPEATS):
        with tempfile.TemporaryDirectory() as folder:
            summary = generate(scene, config, Path(folder) / "out.zarr")
        embreex, mitsuba = peer_seconds(scene, poses, config.rays, threads)
        whole.append(summary.rays / summary.seconds / 1e6)
        bare.append(summary.rays / embreex / 1e6)
        share.append(whole[-1] / bare[-1])
        if mitsuba is not None:
            other.append(summary.rays / mitsuba / 1e6)
    medians = [f"{statistics.median(rates):.2f}" for rates in (whole, bare)]
    peer = f"{statistics.median(other):.2f}" if other else "not installed"
    return [scene.name, str(count), *medians, f"{100 * statistics.median(share):.0f} %", peer]


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
    # Memory comes first: its peak is that of the process.
    parser.add_argument("what", nargs="?", choices=["memory", "noise", "speed"])
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--poses", type=int, default=None)
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    threads = arguments.threads
    for what in [arguments.what] if arguments.what else ["memory", "noise", "speed"]:
        default = ["human.glb"] if what == "memory" else ["robot.glb", "human.glb"]
        paths = arguments.scenes or [scene_path(name) for name in default]
        if what == "memory":
            rows = [memory(path, threads, arguments.poses or 1000) for path in paths]
            publish("memory", ["scene", "poses", "peak, GB"], rows)
        elif what == "noise":
            columns = ["scene", *(f"{rays} rays" for rays in FEW)]
            publish("noise", columns, [noise(path, threads) for path in paths])
        else:
            rates = [f"{name}, M rays/s" for name in ("generate", "embreex", "Mitsuba")]
            columns = ["scene", "poses", *rates[:2], "generate / embreex", rates[2]]
            rows = [speed(path, threads, arguments.poses or 16) for path in paths]
            publish("speed", columns, rows, f"Medians of {REPEATS} runs.")


if __name__ == "__main__":
    main()
