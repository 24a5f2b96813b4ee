"""The work of ``prtnet report``: fit models of many sizes, measure them, draw one page.

Apart from ``prtnet.cli``, which it serves, this is the one module of ``prtnet`` that imports the
other packages: a report needs training and pictures alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from prtnet.cores import use_threads
from prtnet.errors import PrtnetError

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray
    from prtnet.cli_options import ReportOptions
    from prtnet.console import Report
    from prtnet.dataset import Dataset
    from prtnet.model import VisibilityModel

__all__ = ["in_figures", "make_report"]

COLUMNS = ("rms", "ms_per_pose", "model_bytes", "fit_seconds")


def make_report(
    options: ReportOptions, threads: int, progress: Report, say: Callable[[str], None]
) -> dict[str, Any]:
    """Write the page.

    Args:
        options: of the command.
        threads: of the processor.
        progress: is told how far the work is.
        say: is told what the user should know.

    Returns:
        What the page shows (see docs/formats.md).

    Raises:
        PrtnetError: the dataset has no poses to judge by, or the page cannot be written.
    """
    from prtnet.dataset import Dataset
    from prtnet.files import writing
    from prtnet.light import load_light
    from prtnet.report import assemble, dataset_facts
    from runtime.report_page import page
    from training.sweep import SEARCHED, candidates, fitted, searched

    use_threads(threads)
    dataset = Dataset.open(options.dataset)
    facts = dataset_facts(dataset)
    if facts["judged_poses"] == 0:
        raise PrtnetError(options.dataset, "has no poses of clips to judge by; generate some")
    light = load_light(options.light, dataset.order)
    judge = Judge(dataset, facts["clips"], threads)
    chosen = candidates(dataset.scene_kind, facts["receivers"], options.quick, options.device)
    # What kinds without a prior see of a point cache tells too little to search among them.
    search = not options.quick and dataset.scene_kind == "skinned"
    total = len(chosen) + (SEARCHED if search else 0)
    progress("models", 0, total, chosen[0].name)
    for index, (candidate, model) in enumerate(fitted(dataset, chosen), start=1):
        judge.add(model, candidate.name, candidate.family)
        following = chosen[index].name if index < len(chosen) else "a search"
        progress("models", index, total, following if index < total else "")
    if search:
        try:
            found = searched(dataset, options.device, judge.milliseconds)
            for index, model in enumerate(found, start=len(chosen) + 1):
                limit = model.metadata["search"]["budget"]["max_error"]
                judge.add(model, f"searched, {100 * limit:.3g} % expected", "searched")
                progress("models", index, total, "a search")
        except PrtnetError as error:
            say(f"no models by a search: {error}")
    progress("models", total, total)
    results = assemble(facts, judge.figures)
    assert judge.best is not None
    progress("pictures", 0, 0)
    images = draw(results, judge.best, dataset, light, options.renderer, say)
    progress("pictures", 1, 1)
    with writing(options.out) as partial:
        partial.write_text(page(results, images), encoding="utf-8")
    return results


class Judge:
    """Judges models by clips of a dataset, one after the other.

    Args:
        dataset: with the clips.
        clips: their names.
        threads: of the processor.

    Attributes:
        figures: of every model so far, for ``prtnet.report.assemble``.
        best: the most accurate so far.
    """

    def __init__(self, dataset: Dataset, clips: Sequence[str], threads: int) -> None:
        self.dataset, self.clips, self.threads = dataset, clips, threads
        self.figures: list[dict[str, Any]] = []
        self.best: VisibilityModel | None = None

    def milliseconds(self, proto: bytes) -> float:
        """Of one pose in a graph."""
        from runtime.onnx_model import OnnxModel

        pose = self.dataset.read("pose", slice(1))
        return OnnxModel(proto, self.threads).milliseconds(pose)

    def add(self, model: VisibilityModel, name: str, family: str) -> None:
        """Judge one more; the first also tells of the nearest training poses."""
        from prtnet.evaluation import NearestPose, dataset_truth, evaluate
        from runtime.onnx_model import OnnxModel
        from training.onnx_export import build_onnx

        proto = build_onnx(model).SerializeToString()
        predict = OnnxModel(proto, self.threads)
        clusters = len(model.latents) // model.parts
        blocks = dataset_truth(model, self.dataset, self.clips)
        nearest = None if self.figures else NearestPose(self.dataset)
        evaluation = evaluate(model, predict, blocks, nearest)
        facts = model.metadata
        self.figures.append(
            {
                "name": name,
                "family": family,
                "evaluation": evaluation,
                "model_bytes": len(proto),
                "ms_per_pose": predict.milliseconds(self.dataset.read("pose", slice(1))),
                "fit_seconds": facts["seconds"]["fit"],
                "train_seconds": facts["seconds"]["total"],
                "training_rms": facts.get("training_error", {"rms": None})["rms"],
                "alpha": facts["alpha"],
                "clusters": clusters,
                "latents": float(model.latents.sum() / clusters),
                "inputs": int(model.input_basis.shape[2]),
                "config": facts["config"],
            }
        )
        if evaluation["rms"] <= min(each["evaluation"]["rms"] for each in self.figures):
            self.best = model


def draw(
    results: dict[str, Any],
    model: VisibilityModel,
    dataset: Dataset,
    light: FloatArray,
    renderer_name: str | None,
    say: Callable[[str], None],
) -> list[tuple[str, str, str]]:
    """The pictures of the worst and the median pose as addresses; ``results`` is told of them."""
    import numpy as np

    from runtime.draw import opened, usable
    from runtime.error_pictures import data_uri, draw_error, error_scale, vertex_error

    rows = np.concatenate([dataset.poses_of(clip) for clip in results["dataset"]["clips"]])
    shown = {"The worst pose": results["worst"][0], "The median pose": results["median"]}
    results["pictures"] = []
    images = []
    with opened(renderer_name or usable(say)) as renderer:
        for title, k in shown.items():
            row = int(rows[k])
            predicted = model(dataset.read("pose", rows[[k]]))[0]
            top = error_scale(vertex_error(predicted, dataset.read("visibility", row)))
            results["pictures"].append({"title": title, "pose": k, "top": top})
            pictures = draw_error(renderer, dataset, row, predicted, light, top)
            three = (pictures.prediction, pictures.truth, pictures.error)
            images.append((data_uri(three[0]), data_uri(three[1]), data_uri(three[2])))
    return images


def in_figures(results: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Each model's main figures by name, for a table on the terminal."""
    return {model["name"]: {name: model[name] for name in COLUMNS} for model in results["models"]}
