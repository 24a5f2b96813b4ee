"""Scenes in, visibility datasets out: ``prtnet generate``.

A block of poses is a task that ends in the dataset. Threads of this process take whole poses of a
few blocks at a time: geometry, acceleration structure, rays, projection. Workers of a cluster take
whole blocks, and make everything else for themselves of the scene's file. Memory is bounded by the
block and the number of threads, not by the number of poses.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from data_gen.pose_plan import PosePlan, plan_poses
from data_gen.pose_sampling import MARGIN
from data_gen.readers import read_scene
from data_gen.visibility import PoseTracer, TracedPose
from prtnet.arrays import BoolArray, FloatArray
from prtnet.console import Report, silent
from prtnet.cores import core_count
from prtnet.dataset import Block
from prtnet.dataset_repair import DatasetRepair
from prtnet.dataset_writer import DatasetWriter
from prtnet.errors import PrtnetError
from prtnet.executor import Task, executor
from prtnet.frames import FrameField, rest_tangents
from prtnet.kept import keeps_last
from prtnet.places import place
from prtnet.provenance import made_with
from prtnet.scene import PointCacheScene, Receivers, Scene, SkinnedScene

__all__ = ["GenerateConfig", "GenerateSummary", "generate"]

PACKAGES = ("embreex", "numpy", "scipy", "zarr")  # that decide the bytes of a dataset
DEFAULT_FPS = 10.0  # neighbouring frames of 30 are nearly alike and cost three times the rays


@dataclass(frozen=True)
class GenerateConfig:
    """Options of `prtnet generate`."""

    clips: tuple[str, ...] = ()
    """Clips to trace; all of them when none are named."""
    holdout: tuple[str, ...] = ()
    """Clips among them to keep from training, for evaluation; or parts of them, CLIP@START:END in
    seconds."""
    fps: float | None = None
    """Poses a second of every clip; 10 when neither this nor a count is given."""
    count: int | None = None
    """Poses of every clip, evenly spaced, instead of a rate."""
    order: int = 4
    """Bands of the spherical harmonics: order² coefficients a receiver."""
    rays: int = 512
    """Rays a receiver, over the hemisphere above it."""
    sample: int = 0
    """Poses beyond the clips, recombined from the limbs of the training clips."""
    margin: float = MARGIN
    """Radians by which their joints may leave the ranges seen in the clips."""
    two_sided: bool = False
    """Trace the back of the surface too: for cloth."""
    seed: int = 0
    """Of the sampled poses."""
    threads: int = field(default_factory=core_count)
    """Threads that trace."""
    block: int = 8
    """Poses written at a time: one chunk of every array."""

    @property
    def rate(self) -> float | None:
        """Poses a second; None where a count is given instead."""
        return DEFAULT_FPS if self.fps is None and self.count is None else self.fps

    def check(self) -> None:
        """Raise PrtnetError where a value is impossible."""
        least = {"order": 1, "rays": 1, "threads": 1, "block": 1, "sample": 0, "seed": 0}
        for name, low in least.items():
            if not getattr(self, name) >= low:
                raise PrtnetError(f"--{name}", f"must be at least {low}")
        if self.fps is not None and self.count is not None:
            raise PrtnetError("--fps", "and --count exclude each other; give one")
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise PrtnetError("--fps", "must be a positive number")
        if not 0 <= self.margin < float("inf"):
            raise PrtnetError("--margin", "must be an angle in radians, at least 0")
        if self.count is not None and self.count < 1:
            raise PrtnetError("--count", "must be at least 1")


@dataclass(frozen=True)
class GenerateSummary:
    """What a run of ``generate`` did."""

    path: Path
    poses: int  # in the dataset
    resumed: int  # of those, found from an earlier run that was stopped, or sound
    receivers: int
    rays: int  # traced in this run
    seconds: float
    mended: tuple[str, ...] = ()  # by a repair: files, and blocks of arrays


def generate(
    scene: Scene,
    config: GenerateConfig,
    out: str | Path,
    report: Report = silent,
    repair: bool = False,
    cluster: str | None = None,
    source: Path | None = None,
) -> GenerateSummary:
    """Trace visibility over the poses of a scene and write the dataset ``out``.

    An equal run that was stopped is gone on with. A repair traces again, in a dataset that was
    generated with these options, the blocks that are damaged.

    Args:
        scene: the animated mesh.
        config: what to trace of it.
        out: the dataset's folder.
        report: of progress.
        repair: see above.
        cluster: address of a Dask scheduler whose workers trace; threads of this process if None.
        source: the scene's file, which every worker has under this name, as it has ``out``.

    Raises:
        PrtnetError: impossible options, unknown clips, or ``out`` cannot be written; nothing to
            repair, or made with other options.
    """
    config.check()
    if repair and cluster is not None:
        raise PrtnetError("--repair", "works on this machine alone; leave out --cluster")
    started = time.perf_counter()
    plan, receivers, tangents = planned(scene, config)
    attributes, fixed = describe(scene, config, plan, receivers, tangents)
    given = attributes, fixed, len(plan), config.block
    writer = (DatasetRepair if repair else DatasetWriter)(out, *given, report=report)
    missing = writer.missing()
    todo = sum(len(range(len(plan))[writer.span(block)]) for block in missing)
    done = len(plan) - todo
    report("poses", done, len(plan))
    if cluster is None or source is None:
        task: Task = TraceBlock(plan, writer, tracer_of(scene, receivers, tangents, config))
    else:
        task = TraceElsewhere(source.resolve(), scene.sha256, config, str(place(out).resolve()))
    # BLAS would start threads of its own in every worker.
    with threadpool_limits(1, user_api="blas"):
        ahead = 1 + -(-config.threads // config.block)
        tasks = executor(cluster, config.threads, PACKAGES, report)
        for block in tasks.run(task, missing, ahead):
            done += len(range(len(plan))[writer.span(block)])
            report("poses", done, len(plan))
    path = writer.finish()
    return GenerateSummary(
        path=path,
        poses=len(plan),
        resumed=len(plan) - todo,
        receivers=len(receivers),
        rays=todo * len(receivers) * config.rays,
        seconds=time.perf_counter() - started,
        mended=tuple(writer.mended) if isinstance(writer, DatasetRepair) else (),
    )


def tracer_of(
    scene: Scene, receivers: Receivers, tangents: FloatArray, config: GenerateConfig
) -> PoseTracer:
    """Traces poses of a scene as configured."""
    frames = FrameField(scene, receivers, tangents)
    return PoseTracer(scene, receivers, frames, config.order, config.rays)


@dataclass(frozen=True, eq=False)
class TraceBlock:
    """The task: traces a block of poses and writes it."""

    plan: PosePlan
    writer: DatasetWriter
    tracer: PoseTracer

    def __call__(self, number: int, pool: Executor) -> None:
        """Trace block ``number``, its poses in the pool."""
        span = self.writer.span(number)
        poses, sources = self.plan.poses(span)
        traced = list(pool.map(self.tracer, poses))
        self.writer.write(number, assemble(self.plan, span, poses, sources, traced))


@dataclass(frozen=True)
class TraceElsewhere:
    """The same task as it travels to another process: names of files, and the options.

    Attributes:
        scene: the scene's file.
        sha256: of it.
        config: the options.
        out: the dataset that is being written.
    """

    scene: Path
    sha256: str
    config: GenerateConfig
    out: str

    def __call__(self, number: int, pool: Executor) -> None:
        """Trace block ``number`` with what this process has read once."""
        prepared(self)(number, pool)


@keeps_last
def prepared(task: TraceElsewhere) -> TraceBlock:
    """The task in a process that has the files.

    Raises:
        PrtnetError: it has them not, others, or other versions of the packages.
    """
    scene = read_scene(task.scene)
    if scene.sha256 != task.sha256:
        raise PrtnetError(task.scene, "is another file on a worker; make them the same")
    plan, receivers, tangents = planned(scene, task.config)
    attributes, fixed = describe(scene, task.config, plan, receivers, tangents)
    given = attributes, fixed, len(plan), task.config.block
    writer = DatasetWriter(task.out, *given, join=True)
    return TraceBlock(plan, writer, tracer_of(scene, receivers, tangents, task.config))


def planned(scene: Scene, config: GenerateConfig) -> tuple[PosePlan, Receivers, FloatArray]:
    """The poses of a dataset, its receivers, and their tangents at rest."""
    plan = plan_poses(
        scene,
        config.clips,
        config.holdout,
        config.rate,
        config.count,
        config.sample,
        config.seed,
        config.margin,
    )
    receivers = scene.receivers(config.two_sided)
    return plan, receivers, rest_tangents(scene, receivers)


def assemble(
    plan: PosePlan,
    span: slice,
    poses: FloatArray,
    sources: BoolArray,
    traced: Sequence[TracedPose],
) -> Block:
    """One block of the dataset."""
    return Block(
        visibility=np.stack([pose.visibility for pose in traced]),
        pose=poses,
        positions=np.stack([pose.positions for pose in traced]),
        normals=np.stack([pose.normals for pose in traced]),
        tangents=np.stack([pose.tangents for pose in traced]),
        clip=plan.clip[span],
        time=plan.time[span].astype(np.float32),
        sources=sources,
    )


def describe(
    scene: Scene, config: GenerateConfig, plan: PosePlan, receivers: Receivers, tangents: FloatArray
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The attributes of a dataset, and its arrays that no pose changes."""
    rest = receivers.gather(scene.rest())
    skinned = scene if isinstance(scene, SkinnedScene) else None
    attributes: dict[str, Any] = {
        "order": config.order,
        "rays": config.rays,
        "seed": config.seed,
        "margin": config.margin,
        "fps": config.rate,
        "count": config.count,
        "sample": config.sample,
        "two_sided": config.two_sided,
        "scene_kind": "skinned" if skinned else "point_cache",
        "scene_name": scene.name,
        "scene_sha256": scene.sha256,
        "mesh_sha256": scene.mesh_sha256,
        "clip_names": list(plan.clip_names),
        "held_out": list(plan.held_out),
        "joint_names": list(skinned.joint_names) if skinned else [],
        "morph_count": skinned.morph_count if skinned else 0,
        "made_with": made_with(*PACKAGES),
    }
    fixed: dict[str, Any] = {
        "faces": np.asarray(scene.faces, dtype=np.int32),
        "receiver_of_vertex": np.asarray(receivers.of_vertex, dtype=np.int32),
        "receiver_side": receivers.side,
        "rest_positions": rest.positions[0],
        "rest_normals": rest.normals[0],
        "rest_tangents": tangents,
    }
    if skinned:
        fixed["rest_pose"] = skinned.rest_pose()[0]
        fixed["joint_weights"] = skinned.joint_weights[receivers.vertex]
        fixed["joint_parents"] = np.asarray(skinned.joint_parents, dtype=np.int32)
    elif isinstance(scene, PointCacheScene):
        fixed["rest_pose"] = np.asarray(scene.frames[0], dtype=np.float32).ravel()
    return attributes, fixed
