"""The truth that ``prtnet evaluate`` measures a model by: clips of a dataset or of a scene.

Beside ``prtnet.cli``, which it serves, it may import the other packages: a scene's truth is traced.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from prtnet.errors import PrtnetError, nearest_name

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray
    from prtnet.cli_options import EvaluateOptions
    from prtnet.console import Report
    from prtnet.evaluation import NearestPose, TruthBlock
    from prtnet.model import VisibilityModel
    from runtime.onnx_model import OnnxModel

__all__ = ["Truth", "dataset_truth", "scene_truth", "summary"]

WORST = 5  # poses that people are shown


@dataclass(frozen=True)
class Truth:
    """What a model is evaluated on.

    Attributes:
        blocks: poses and their visibility.
        total: number of poses.
        pose: one of them, (1, D), for timing.
        nearest: answers with training poses; None where their data is not at hand.
    """

    blocks: Iterable[TruthBlock]
    total: int
    pose: FloatArray
    nearest: NearestPose | None = None

    def counted(self, report: Report) -> Iterator[TruthBlock]:
        """The blocks, each reported when it is done with."""
        done = 0
        for block in self.blocks:
            yield block
            done += len(block.poses)
            report("poses", done, self.total)


def dataset_truth(options: EvaluateOptions, model: VisibilityModel) -> Truth:
    """The clips of a dataset.

    Raises:
        PrtnetError: it is of another mesh than the model, or has not the clips asked for.
    """
    from prtnet import evaluation
    from prtnet.dataset import SAMPLED, Dataset
    from prtnet.output_space import OutputSpace

    dataset = Dataset.open(options.data)
    if options.dump is not None:
        raise PrtnetError("--dump", "needs a scene in place of the dataset")
    known = dataset.mesh_sha256, dataset.order, len(dataset.receiver_side)
    if known != (model.metadata.get("mesh_sha256"), model.order, model.receiver_count):
        what = f"is of another mesh, order or number of receivers than {options.model}"
        raise PrtnetError(options.data, f"{what} (two-sided or not?); train a model on it")
    clips = chosen(options, [name for name in dataset.clip_names if name != SAMPLED])
    return Truth(
        evaluation.dataset_truth(model, dataset, clips),
        sum(len(dataset.poses_of(clip)) for clip in clips),
        dataset.read("pose", slice(1)),
        evaluation.NearestPose(dataset, OutputSpace.of(model.metadata)),
    )


def scene_truth(
    options: EvaluateOptions,
    model: VisibilityModel,
    predict: OnnxModel,
    dumped: Callable[[int, int], object],
    threads: int,
) -> Truth:
    """The clips of a scene, traced when they are wanted; writes the dump if there is to be one.

    Raises:
        PrtnetError: the scene has no clips, or not those asked for, or is another than the model's.
    """
    from data_gen import truth
    from data_gen.readers import read_scene, require_clips
    from prtnet.modelled_scene import ModelledScene
    from prtnet.time_range import part_of

    scene = read_scene(options.data)
    require_clips(scene)
    actor = ModelledScene(model, scene)
    clips = [part_of(scene, name).name for name in dict.fromkeys(options.clips)]
    clips = clips or [clip.name for clip in scene.clips]
    if options.dump is not None:
        actor.dump(options.dump, clips, options.fps, predict, dumped)
    return Truth(
        truth.scene_truth(actor, clips, options.fps, options.rays, threads),
        sum(len(part_of(scene, clip).times(options.fps)) for clip in clips),
        actor.poses(clips[0], fps=options.fps)[:1],
    )


def chosen(options: EvaluateOptions, known: Sequence[str]) -> Sequence[str]:
    """The clips asked for, checked, or all that are known."""
    for name in options.clips:
        if name not in known:
            raise PrtnetError(options.data, f"has no clip '{name}'; {nearest_name(name, known)}")
    return list(dict.fromkeys(options.clips)) or known


def summary(results: Mapping[str, Any]) -> dict[str, Any]:
    """What people are shown: errors, and the worst poses with how far they are from training."""
    from prtnet.console import in_per_cent

    held_out = [pose for pose in results["poses"] if results["clips"][pose["clip"]]["held_out"]]
    poses = sorted(held_out or results["poses"], key=lambda pose: -float(pose["rms"]))
    return in_per_cent(results) | {"worst_poses": dict(map(told, poses[:WORST]))}


def told(pose: Mapping[str, Any]) -> tuple[str, dict[str, str]]:
    """A pose by clip and time, and its figures; a dash where one is not known."""

    def number(value: float | None) -> str:
        return "–" if value is None else f"{value:.3f}"

    name = pose["clip"] if pose["time"] is None else f"{pose['clip']} at {pose['time']:.2f} s"
    distances = {key: number(pose[key]) for key in ("distance", "nearest_distance")}
    return name, {"rms": f"{100 * pose['rms']:.2f} %", **distances}
