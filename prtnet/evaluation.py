"""Held-out error of a model beside its yardsticks, clip by clip.

The yardsticks: the *signal*, error of predicting the training mean; the *nearest* training pose;
the *PCA floor*, the best that the kept components could do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.dataset import Dataset
from prtnet.features import JointAngles
from prtnet.metrics import ErrorSum
from prtnet.model import VisibilityModel
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
    """

    clip: str
    held_out: bool
    poses: FloatArray
    visibility: FloatArray


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
            yield TruthBlock(name, name not in model.training_clips, poses, truth)


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

    def __call__(self, poses: FloatArray) -> FloatArray:
        """Visibility (P, V, n²)."""
        wanted = self.describe(poses).astype(np.float64)
        known = self.known.astype(np.float64)
        distance = (known**2).sum(1) - 2.0 * wanted @ known.T
        nearest = np.argmin(distance, axis=1)
        unique, inverse = np.unique(self.rows[nearest], return_inverse=True)
        return self.space.read(self.dataset, unique)[inverse]


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
        ``clips``: name -> rms, p99, max, held_out; ``rms``, ``p99``, ``max``, ``signal``,
        ``nearest`` (None without the argument) and ``pca_floor`` over the held-out clips, or over
        all where none is held out.
    """
    mean = model.decode(np.zeros((1, len(model.latents), int(model.latents.max(initial=0)))))
    rows: dict[str, dict[str, ErrorSum]] = {}
    held_out: dict[str, bool] = {}
    for block in blocks:
        sums = rows.setdefault(
            block.clip, {name: ErrorSum() for name in ("model", "signal", "nearest", "floor")}
        )
        held_out[block.clip] = block.held_out
        truth = block.visibility
        sums["model"].add(predict(block.poses), truth)
        sums["signal"].add(mean, truth)
        sums["floor"].add(model.decode(model.encode(truth)), truth)
        if nearest is not None:
            sums["nearest"].add(nearest(block.poses), truth)
    counted = [name for name in rows if held_out[name]] or list(rows)
    totals = {name: ErrorSum() for name in ("model", "signal", "nearest", "floor")}
    for clip in counted:
        for name, total in totals.items():
            total.merge(rows[clip][name])
    return {
        "clips": {
            clip: {**sums["model"].summary(), "held_out": held_out[clip]}
            for clip, sums in rows.items()
        },
        **totals["model"].summary(),
        "signal": totals["signal"].rms(),
        "nearest": None if nearest is None else totals["nearest"].rms(),
        "pca_floor": totals["floor"].rms(),
    }
