"""Which poses a dataset holds: those of the clips by rate or count, then sampled ones.

A clip may be held out in part. The poses of the part are then a clip of their own, and those nearer
to it than a guard are left out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from data_gen.pose_sampling import MARGIN, PoseSampler
from prtnet.animation import Clip
from prtnet.arrays import BoolArray, FloatArray, IntArray
from prtnet.dataset import SAMPLED
from prtnet.errors import PrtnetError
from prtnet.scene import Scene
from prtnet.time_range import GUARD, part_of, time_range

__all__ = ["PosePlan", "plan_poses"]

ROUNDING = 1e-6  # seconds


@dataclass(frozen=True, eq=False)
class PosePlan:
    """A numbered list of poses; only those asked for are ever made.

    Attributes:
        scene: the animated mesh.
        clip_names: the clips, their parts that are held out (``clip@start:end``), and SAMPLED
            after them if there are sampled poses.
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
                for piece, own in zip(self.sampler.clips, used.T, strict=True):
                    sources[chosen, self.clip_names.index(piece.name)] |= own
            else:
                poses[chosen] = self.scene.poses(part_of(self.scene, name), time[chosen])
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
        holdout: names among them that are not trained on, nor sampled from, and parts of them:
            ``clip@start:end``, in seconds.
        fps: poses a second of every clip.
        count: poses of every clip, instead of ``fps``.
        sample: poses recombined from the training clips.
        seed: of those.
        margin: radians by which their joints may leave the ranges they were seen in.

    Raises:
        PrtnetError: unknown names, nothing to train on, or nothing that can be sampled.
    """
    chosen = [scene.clip(name) for name in dict.fromkeys(clips or [c.name for c in scene.clips])]
    held = {name: part_of(scene, name) for name in dict.fromkeys(holdout)}
    parts = parts_of_clips(chosen, held)
    names, times, training = [], [], []
    for clip in chosen:
        every = clip.times(fps, count)
        pieces = [clip] if clip.name in held else remaining(clip, parts[clip.name])
        for name, cut in ((clip.name, pieces), *((part.name, [part]) for part in parts[clip.name])):
            own = inside(every, cut)
            if len(own) == 0 and name in held:
                raise PrtnetError("--holdout", f"'{name}' holds no pose; widen it or raise --fps")
            names.append(name)
            times.append(own)
        if clip.name not in held and len(inside(every, pieces)):
            training += pieces
    if not training:
        raise PrtnetError("--holdout", "leaves no clip to train on; hold out fewer")
    sampler = None
    if sample:
        if SAMPLED in names:
            raise PrtnetError("--sample", f"a clip is named '{SAMPLED}'; rename it")
        sampler = PoseSampler(scene, training, seed, margin)
        names.append(SAMPLED)
        times.append(np.zeros(sample))
    return PosePlan(
        scene,
        tuple(names),
        tuple(held),
        np.repeat(np.arange(len(times)), [len(t) for t in times]).astype(np.int32),
        np.concatenate(times),
        sampler,
    )


def parts_of_clips(chosen: Sequence[Clip], held: Mapping[str, Clip]) -> dict[str, list[Clip]]:
    """The parts of each chosen clip that are held out, in the order of time, by its name.

    Raises:
        PrtnetError: a clip is not chosen, or two parts overlap.
    """
    parts: dict[str, list[Clip]] = {clip.name: [] for clip in chosen}
    for name, clip in sorted(held.items(), key=lambda item: item[1].start):
        if name in parts:
            continue
        cut = time_range(name)
        if cut is None or cut.clip not in parts:
            what = name if cut is None else cut.clip
            raise PrtnetError("--holdout", f"clip '{what}' is not among --clips; add it there")
        if cut.clip in held or (parts[cut.clip] and clip.start <= parts[cut.clip][-1].end):
            raise PrtnetError("--holdout", f"'{name}' is held out twice; name it once")
        parts[cut.clip].append(clip)
    return parts


def remaining(clip: Clip, parts: Sequence[Clip]) -> list[Clip]:
    """What parts of a clip, in the order of time, and their guards leave of it."""
    starts = [clip.start, *(part.end + GUARD for part in parts)]
    ends = [*(part.start - GUARD for part in parts), clip.end]
    pieces = zip(starts, ends, strict=True)
    return [dataclasses.replace(clip, start=a, end=b) for a, b in pieces if a <= b]


def inside(times: FloatArray, pieces: Sequence[Clip]) -> FloatArray:
    """Those of the times (P,) that lie in a piece."""
    kept = np.zeros(len(times), dtype=bool)
    for piece in pieces:
        kept |= (times >= piece.start - ROUNDING) & (times <= piece.end + ROUNDING)
    return times[kept]
