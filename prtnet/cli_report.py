"""The work of ``prtnet report``: fit models of many sizes, measure them, draw one page.

Apart from ``prtnet.cli``, which it serves, this is the one module of ``prtnet`` that imports the
other packages: a report needs training and pictures alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from prtnet.errors import PrtnetError

if TYPE_CHECKING:
    from prtnet.arrays import FloatArray
    from prtnet.cli_options import ReportOptions
    from prtnet.console import Report
    from prtnet.dataset import Dataset
    from prtnet.evaluation import NearestPose
    from prtnet.model import VisibilityModel
    from training.sweep import Candidate

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
    import torch

    from prtnet.dataset import Dataset
    from prtnet.evaluation import NearestPose
    from prtnet.files import writing
    from prtnet.light import load_light
    from prtnet.report import assemble, dataset_facts
    from runtime.report_page import page
    from training.sweep import candidates

    torch.set_num_threads(threads)
    dataset = Dataset.open(options.dataset)
    facts = dataset_facts(dataset)
    if facts["judged_poses"] == 0:
        raise PrtnetError(options.dataset, "has no poses of clips to judge by; generate some")
    light = load_light(options.light, dataset.order)
    chosen = candidates(dataset.scene_kind, facts["receivers"], options.quick, options.device)
    models: list[dict[str, Any]] = []
    best: VisibilityModel | None = None
    alphas: dict[str, float] = {}  # chosen with the first model of each family
    for index, candidate in enumerate(chosen):
        progress("models", index, len(chosen), candidate.name)
        nearest = NearestPose(dataset) if index == 0 else None
        if candidate.family in alphas:
            candidate = candidate.with_alpha(alphas[candidate.family])
        figures, model = measured(candidate, dataset, facts["clips"], nearest, threads)
        models.append(figures)
        alphas[candidate.family] = figures["alpha"]
        if figures["evaluation"]["rms"] <= min(m["evaluation"]["rms"] for m in models):
            best = model
    progress("models", len(chosen), len(chosen))
    results = assemble(facts, models)
    assert best is not None
    progress("pictures", 0, 0)
    images = draw(results, best, dataset, light, options.renderer, say)
    progress("pictures", 1, 1)
    with writing(options.out) as partial:
        partial.write_text(page(results, images), encoding="utf-8")
    return results


def measured(
    candidate: Candidate,
    dataset: Dataset,
    clips: Sequence[str],
    nearest: NearestPose | None,
    threads: int,
) -> tuple[dict[str, Any], VisibilityModel]:
    """Fit one model and judge it by the clips: its figures, and the model."""
    from prtnet.evaluation import dataset_truth, evaluate
    from runtime.onnx_model import OnnxModel
    from training.onnx_export import build_onnx
    from training.train import train

    model = train(dataset, candidate.config)
    proto = build_onnx(model).SerializeToString()
    predict = OnnxModel(proto, threads)
    clusters = len(model.latents) // model.parts
    evaluation = evaluate(model, predict, dataset_truth(model, dataset, clips), nearest)
    return {
        "name": candidate.name,
        "family": candidate.family,
        "evaluation": evaluation,
        "model_bytes": len(proto),
        "ms_per_pose": predict.milliseconds(dataset.read("pose", slice(1))),
        "fit_seconds": model.metadata["seconds"]["fit"],
        "train_seconds": model.metadata["seconds"]["total"],
        "training_rms": model.metadata["training_error"]["rms"],
        "alpha": model.metadata["alpha"],
        "clusters": clusters,
        "latents": float(model.latents.sum() / clusters),
        "inputs": int(model.input_basis.shape[2]),
        "config": model.metadata["config"],
    }, model


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
