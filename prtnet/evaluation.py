"""Held-out error of a model beside its yardsticks, clip by clip and pose by pose.

The yardsticks: the *signal*, error of predicting the training mean; the *nearest* training pose;
the *PCA floor*, the best that the kept components could do. Beside the errors: how far the poses
are from training, and whether the error flickers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.dataset import SAMPLED, Dataset
from prtnet.features import JointAngles
from prtnet.metrics import CoherenceSum, ErrorSum, relative_rms
from prtnet.model import VisibilityModel
from prtnet.novelty import pose_novelty
from prtnet.output_space import OutputSpace

__all__ = ["NearestPose", "TruthBlock", "dataset_truth", "evaluate"]


@dataclass(frozen=True, eq=False)
class TruthBlock:
    """Some poses of one clip with their ray-traced visibility.

    Attributes:
        clip: its name.
        held_out: whether training never saw the clip.
        poses: flattened, (B, D).
        visibility: in the space of the model's output, local frames as a rule, (B, V, n²).
        time: seconds in the clip, (B,); None where it is not known. Blocks of a clip follow each
            other in time.
    """

    clip: str
    held_out: bool
    poses: FloatArray
    visibility: FloatArray
    time: FloatArray | None = None


def dataset_truth(
    model: VisibilityModel, dataset: Dataset, clips: Iterable[str], block: int = 8
) -> Iterator[TruthBlock]:
    """The poses of some clips of a dataset, block by block.

    What is held out is the model's to say: its own dataset may have held out other clips.
    """
    space = OutputSpace.of(model.metadata)
    for name in clips:
        rows = dataset.poses_of(name)
        for start in range(0, len(rows), block):
            own = rows[start : start + block]
            poses, truth = dataset.read("pose", own), space.read(dataset, own)
            held_out = not model.saw(name)
            yield TruthBlock(name, held_out, poses, truth, dataset.read("time", own))


class NearestPose:
    """Answers every pose with the visibility of the training pose most like it.

    Skinned poses are compared by their joints' local rotations, without the roots'; point caches
    by their vertices about their mean.

    Args:
        dataset: with the training poses.
        space: that the answers are in.
    """

    def __init__(self, dataset: Dataset, space: OutputSpace | None = None) -> None:
        self.dataset, self.space = dataset, space or OutputSpace()
        self.rows = dataset.training_poses()
        self.known = self.describe(dataset.read("pose", self.rows))

    def describe(self, poses: FloatArray) -> FloatArray:
        """What poses (P, D) are compared by, (P, F)."""
        parents = self.dataset.joint_parents
        if parents is None:
            points = poses.reshape(len(poses), -1, 3)
            return (points - points.mean(axis=1, keepdims=True)).reshape(len(poses), -1)
        joints = np.flatnonzero(parents >= 0).astype(np.int32)
        return JointAngles(joints, parents[joints], len(parents))(poses)[:, 0]

    def squared_distances(self, poses: FloatArray) -> FloatArray:
        """From poses (P, D) to every training pose, (P, training poses)."""
        wanted = self.describe(poses).astype(np.float64)
        known = self.known.astype(np.float64)
        square = (wanted**2).sum(1)[:, None] + (known**2).sum(1) - 2.0 * wanted @ known.T
        return np.maximum(square, 0.0)

    @cached_property
    def spacing(self) -> float:
        """Median distance from a training pose to the nearest one that is not the same."""
        own = np.sqrt(self.squared_distances(self.dataset.read("pose", self.rows)))
        own[own <= SAME * max(float(np.abs(self.known).max()), 1e-30)] = np.inf
        nearest = own.min(axis=1)
        nearest = nearest[np.isfinite(nearest)]
        return float(np.median(nearest)) if len(nearest) else 0.0

    def distance(self, poses: FloatArray) -> FloatArray:
        """From each pose to the nearest training pose, in units of their spacing, (P,)."""
        nearest = np.sqrt(self.squared_distances(poses).min(axis=1))
        return nearest / self.spacing if self.spacing > 0 else np.full(len(poses), np.nan)

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Visibility (P, V, n²)."""
        nearest = np.argmin(self.squared_distances(poses), axis=1)
        unique, inverse = np.unique(self.rows[nearest], return_inverse=True)
        return self.space.read(self.dataset, unique)[inverse]


FLOOR_STEP = 8  # of lobes the floor is that of one pose in so many: each takes a fit a receiver
SAME = 1e-4  # distances of single-precision poses that are equal, relative to their numbers


@dataclass(eq=False)
class ClipErrors:
    """What is summed over the poses of one clip, or of many."""

    model: ErrorSum = field(default_factory=ErrorSum)
    signal: ErrorSum = field(default_factory=ErrorSum)
    nearest: ErrorSum = field(default_factory=ErrorSum)
    floor: ErrorSum = field(default_factory=ErrorSum)
    steps: CoherenceSum = field(default_factory=CoherenceSum)
    poses: list[dict[str, Any]] = field(default_factory=list)

    def merge(self, other: ClipErrors) -> None:
        """Add another clip's."""
        for name in ("model", "signal", "nearest", "floor", "steps"):
            getattr(self, name).merge(getattr(other, name))
        self.poses.extend(other.poses)

    def beside(self) -> dict[str, Any]:
        """``coherence``, ``distance`` and ``nearest_distance``: what stands beside the error."""
        return {
            "coherence": self.steps.value(),
            "distance": mean_and_max(self.poses, "distance"),
            "nearest_distance": mean_and_max(self.poses, "nearest_distance"),
        }


def mean_and_max(poses: list[dict[str, Any]], name: str) -> dict[str, float] | None:
    """Of a number of every pose; None where it is not known."""
    values = [pose[name] for pose in poses if pose[name] is not None]
    return {"mean": float(np.mean(values)), "max": max(values)} if values else None


def pose_records(
    model: VisibilityModel, block: TruthBlock, predicted: FloatArray, nearest: NearestPose | None
) -> list[dict[str, Any]]:
    """``clip``, ``time``, ``rms``, ``distance`` and ``nearest_distance`` of every pose."""
    unknown = np.full(len(block.poses), np.nan)
    each = model.novelty(block.poses)
    columns = {
        "time": unknown if block.time is None else block.time,
        "distance": unknown if each is None else pose_novelty(each),
        "nearest_distance": unknown if nearest is None else nearest.distance(block.poses),
    }
    return [
        {"clip": block.clip, "rms": relative_rms(predicted[row], block.visibility[row])}
        | {n: float(v[i]) if np.isfinite(v[i]) else None for n, v in columns.items()}
        for i, row in enumerate(np.arange(len(block.poses))[:, None])
    ]


def evaluate(
    model: VisibilityModel,
    predict: Callable[[FloatArray], FloatArray],
    blocks: Iterable[TruthBlock],
    nearest: NearestPose | None = None,
) -> dict[str, Any]:
    """Errors per clip and in all, as fractions.

    Args:
        model: for its mean and its components.
        predict: poses (P, D) to visibility (P, V, n²); the exported model at run time.
        blocks: poses and truth.
        nearest: answers with training poses; None where their data is not at hand.

    Returns:
        ``clips``: name -> rms, p99, max, held_out, coherence, distance and nearest_distance (each
        a mean and max over poses); ``rms``, ``p99``, ``max``, ``coherence``, the distances,
        ``signal``, ``nearest`` (None without the argument) and ``pca_floor`` over the held-out
        clips, or over all where none is held out; ``poses``: a list of every pose's clip, time,
        rms, distance and nearest_distance.
    """
    mean = model.training_mean[None]
    rows: dict[str, ClipErrors] = {}
    held_out: dict[str, bool] = {}
    for block in blocks:
        sums = rows.setdefault(block.clip, ClipErrors())
        held_out[block.clip] = block.held_out
        truth, predicted = block.visibility, predict(block.poses)
        sums.model.add(predicted, truth)
        sums.signal.add(mean, truth)
        some = slice(None, None, FLOOR_STEP if model.lobes else 1)
        sums.floor.add(model.closest(block.poses[some], truth[some]), truth[some])
        if nearest is not None:
            sums.nearest.add(nearest(block.poses), truth)
        if block.clip != SAMPLED:  # those do not follow each other in time
            sums.steps.add(predicted, truth)
        sums.poses += pose_records(model, block, predicted, nearest)
    counted = [name for name in rows if held_out[name]] or list(rows)
    total = ClipErrors()
    for clip in counted:
        total.merge(rows[clip])
    return {
        "clips": {
            clip: {**sums.model.summary(), "held_out": held_out[clip], **sums.beside()}
            for clip, sums in rows.items()
        },
        **total.model.summary(),
        **total.beside(),
        "signal": total.signal.rms(),
        "nearest": None if nearest is None else total.nearest.rms(),
        "pca_floor": total.floor.rms(),
        "poses": [pose for sums in rows.values() for pose in sums.poses],
    }
