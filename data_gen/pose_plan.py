"""Which poses a dataset holds: those of the clips by rate or count, then sampled ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from data_gen.pose_sampling import MARGIN, PoseSampler
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.dataset import SAMPLED
from prtnet.errors import PrtnetError
from prtnet.scene import Scene

__all__ = ["PosePlan", "plan_poses"]


@dataclass(frozen=True, eq=False)
class PosePlan:
    """A numbered list of poses; only those asked for are ever made.

    Attributes:
        scene: the animated mesh.
        clip_names: the clips, and SAMPLED after them if there are sampled poses.
        held_out: those not trained on.
        clip: index of each pose's clip, (P,).
        time: seconds in its clip, (P,); 0 for sampled poses.
        sampler: makes the sampled poses; None where there are none.
    """

    scene: Scene
    clip_names: tuple[str, ...]
    held_out: tuple[str, ...]
    clip: IntArray
    time: FloatArray
    sampler: PoseSampler | None

    def __len__(self) -> int:
        return len(self.clip)

    def poses(self, span: slice) -> tuple[FloatArray, BoolArray]:
        """Flattened poses (p, D) of a span, and the clips each is made of, (p, clips)."""
        clip, time = self.clip[span], self.time[span]
        poses = np.empty((len(clip), self.scene.pose_size), dtype=np.float32)
        sources = np.zeros((len(clip), len(self.clip_names)), dtype=bool)
        for index in np.unique(clip):
            chosen = np.flatnonzero(clip == index)
            name = self.clip_names[index]
            if self.sampler is not None and name == SAMPLED:
                first = int(np.flatnonzero(self.clip == index)[0])
                numbers = np.arange(span.start, span.stop)[chosen] - first
                poses[chosen], used = self.sampler.sample(numbers)
                columns = [self.clip_names.index(clip.name) for clip in self.sampler.clips]
                sources[chosen[:, None], columns] = used
            else:
                poses[chosen] = self.scene.poses(self.scene.clip(name), time[chosen])
                sources[chosen, index] = True
        return poses, sources


def plan_poses(
    scene: Scene,
    clips: tuple[str, ...] = (),
    holdout: tuple[str, ...] = (),
    fps: float | None = None,
    count: int | None = None,
    sample: int = 0,
    seed: int = 0,
    margin: float = MARGIN,
) -> PosePlan:
    """Choose the poses of a dataset.

    Args:
        scene: the animated mesh.
        clips: names; all of the scene's where none are given.
        holdout: names among them that are not trained on, nor sampled from.
        fps: poses a second of every clip.
        count: poses of every clip, instead of ``fps``.
        sample: poses recombined from the training clips.
        seed: of those.
        margin: radians by which their joints may leave the ranges they were seen in.

    Raises:
        PrtnetError: unknown names, nothing to train on, or nothing that can be sampled.
    """
    known = [clip.name for clip in scene.clips]
    chosen = [scene.clip(name) for name in dict.fromkeys(clips or known)]
    held = [scene.clip(name).name for name in dict.fromkeys(holdout)]
    names = [clip.name for clip in chosen]
    for name in held:
        if name not in names:
            raise PrtnetError("--holdout", f"clip '{name}' is not among --clips; add it there")
    training = [clip for clip in chosen if clip.name not in held]
    if not training:
        raise PrtnetError("--holdout", "leaves no clip to train on; hold out fewer")
    times = [clip.times(fps, count) for clip in chosen]
    clip = [np.full(len(t), index) for index, t in enumerate(times)]
    sampler = None
    if sample:
        if SAMPLED in names:
            raise PrtnetError("--sample", f"a clip is named '{SAMPLED}'; rename it")
        sampler = PoseSampler(scene, training, seed, margin)
        names.append(SAMPLED)
        times.append(np.zeros(sample))
        clip.append(np.full(sample, len(chosen)))
    return PosePlan(
        scene,
        tuple(names),
        tuple(held),
        np.concatenate(clip).astype(np.int32),
        np.concatenate(times),
        sampler,
    )
