"""Ray-traced visibility of a scene's clips, block by block: what a model is judged by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from data_gen.visibility import PoseTracer, trace_pose
from prtnet.arrays import FloatArray
from prtnet.evaluation import TruthBlock
from prtnet.modelled_scene import ModelledScene
from prtnet.time_range import part_of

__all__ = ["scene_truth", "true_visibility"]

BLOCK = 8  # poses


def true_visibility(actor: ModelledScene, pose: FloatArray, rays: int, threads: int) -> FloatArray:
    """Ray-traced visibility (V, n²) of one flattened pose (1, D), in the model's frames."""
    return trace_pose(
        actor.scene, actor.receivers, actor.frame_field, pose, actor.model.order, rays, threads
    )[0]


def scene_truth(
    actor: ModelledScene, clips: Sequence[str], fps: float, rays: int, threads: int
) -> Iterator[TruthBlock]:
    """Truth of the clips of a model's scene, in the model's frames.

    A clip is held out unless the model was trained on it.

    Args:
        actor: the scene, and the model whose order and frames are used.
        clips: names, or parts ``clip@start:end``.
        fps: poses a second.
        rays: above the horizon of every receiver.
        threads: that trace.
    """
    tracer = PoseTracer(actor.scene, actor.receivers, actor.frame_field, actor.model.order, rays)
    with ThreadPoolExecutor(threads) as pool:
        for clip in clips:
            times = part_of(actor.scene, clip).times(fps=fps)
            poses = actor.poses(clip, times)
            for start in range(0, len(poses), BLOCK):
                own = slice(start, start + BLOCK)
                block = poses[own]
                visibility = np.stack([pose.visibility for pose in tracer.map(block, pool)])
                held_out = not actor.model.saw(clip)
                yield TruthBlock(clip, held_out, block, visibility, times[own])
