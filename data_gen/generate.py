"""Scenes in, visibility datasets out: ``prtnet generate``.

Worker threads take whole poses: geometry, acceleration structure, rays, projection. The main thread
collects them in order and writes a block of poses at a time. Memory is bounded by the block and
the number of threads, not by the number of poses.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from data_gen.pose_plan import PosePlan, plan_poses
from data_gen.pose_sampling import MARGIN
from data_gen.visibility import PoseTracer, TracedPose
from prtnet.arrays import BoolArray, FloatArray
from prtnet.cores import core_count
from prtnet.dataset import Block, DatasetWriter
from prtnet.dataset_repair import DatasetRepair
from prtnet.errors import PrtnetError
from prtnet.frames import FrameField, rest_tangents
from prtnet.provenance import made_with
from prtnet.scene import PointCacheScene, Receivers, Scene, SkinnedScene

__all__ = ["GenerateConfig", "GenerateSummary", "Progress", "generate"]

Progress = Callable[[int, int], None]  # poses done, poses in all

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
    progress: Progress | None = None,
    repair: bool = False,
) -> GenerateSummary:
    """Trace visibility over the poses of a scene and write the dataset ``out``.

    An equal run that was stopped is gone on with. A repair traces again, in a dataset that was
    generated with these options, the blocks that are damaged.

    Raises:
        PrtnetError: impossible options, unknown clips, or ``out`` cannot be written; nothing to
            repair, or made with other options.
    """
    config.check()
    started = time.perf_counter()
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
    tangents = rest_tangents(scene, receivers)
    attributes, fixed = describe(scene, config, plan, receivers, tangents)
    writer = (DatasetRepair if repair else DatasetWriter)(
        out, attributes, fixed, len(plan), config.block
    )
    tracer = PoseTracer(
        scene, receivers, FrameField(scene, receivers, tangents), config.order, config.rays
    )
    missing = writer.missing()
    todo = sum(len(range(len(plan))[writer.span(block)]) for block in missing)
    done = len(plan) - todo
    report = progress or silent
    report(done, len(plan))
    # BLAS would start threads of its own in every worker.
    with threadpool_limits(1, user_api="blas"), ThreadPoolExecutor(config.threads) as pool:
        for block, values in traced_blocks(plan, writer, missing, tracer, pool, config.threads):
            writer.write(block, values)
            done += len(values.clip)
            report(done, len(plan))
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


def silent(done: int, total: int) -> None:
    """Progress nobody asked for."""


def traced_blocks(
    plan: PosePlan,
    writer: DatasetWriter,
    blocks: Sequence[int],
    tracer: PoseTracer,
    pool: Executor,
    threads: int,
) -> Iterator[tuple[int, Block]]:
    """Blocks in order, with enough of the next ones under way to keep all threads busy."""
    ahead: deque[tuple[int, FloatArray, BoolArray, list[Future[TracedPose]]]] = deque()
    depth = 1 + -(-threads // writer.block)
    try:
        for turn in range(len(blocks) + depth):
            if turn < len(blocks):
                poses, sources = plan.poses(writer.span(blocks[turn]))
                futures = [pool.submit(tracer, pose) for pose in poses]
                ahead.append((blocks[turn], poses, sources, futures))
            if turn >= depth and ahead:
                block, poses, sources, futures = ahead.popleft()
                traced = [future.result() for future in futures]
                yield block, assemble(plan, writer.span(block), poses, sources, traced)
    finally:
        for _, _, _, futures in ahead:
            for future in futures:
                future.cancel()


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
