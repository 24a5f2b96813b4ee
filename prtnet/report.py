"""What a report of a dataset says: figures of many models, put in order. Plain data throughout.

A report is a dictionary that is written as JSON and that a page is drawn from, so that both say the
same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from prtnet.arrays import BoolArray, FloatArray
from prtnet.dataset import SAMPLED, Dataset

__all__ = ["assemble", "dataset_facts", "judged_clips", "pareto_front"]

WORST = 10  # poses in the table of the worst


def judged_clips(dataset: Dataset) -> list[str]:
    """The held-out clips; where there are none, the clips that training sees."""
    return list(dataset.held_out) or [name for name in dataset.clip_names if name != SAMPLED]


def dataset_facts(dataset: Dataset) -> dict[str, Any]:
    """What the dataset is made of; ``held_out``: whether the report judges unseen clips."""
    poses, receivers, coefficients = dataset.visibility.shape
    clips = judged_clips(dataset)
    return {
        "name": dataset.scene_name,
        "scene_kind": dataset.scene_kind,
        "vertices": len(dataset.receiver_of_vertex),
        "receivers": receivers,
        "faces": len(dataset.faces),
        "order": dataset.order,
        "rays": dataset.rays,
        "poses": poses,
        "training_poses": len(dataset.training_poses()),
        "judged_poses": sum(len(dataset.poses_of(clip)) for clip in clips),
        "clips": clips,
        "held_out": bool(dataset.held_out),
        "visibility_bytes": poses * receivers * coefficients * 4,
        "training_bytes": len(dataset.training_poses()) * receivers * coefficients * 4,
        "mean_bytes": receivers * coefficients * 4,
    }


def pareto_front(cost: FloatArray, error: FloatArray) -> BoolArray:
    """Which of N models no other beats in both cost and error, (N,).

    Of models equal in both, all are on the front.
    """
    cheaper = (cost[:, None] <= cost) & (error[:, None] <= error)
    better = cheaper & ((cost[:, None] < cost) | (error[:, None] < error))
    return np.logical_not(better.any(axis=0), dtype=np.bool_)


def assemble(facts: Mapping[str, Any], models: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The report.

    Args:
        facts: from :func:`dataset_facts`.
        models: for each its ``name``, ``family``, ``evaluation`` (of ``prtnet.evaluation``; the
            first with the nearest training poses), ``model_bytes``, ``ms_per_pose``,
            ``fit_seconds``, ``train_seconds``, ``latents``, ``inputs``, ``clusters``, ``alpha``
            and ``training_rms``.

    Returns:
        ``dataset``, ``models`` (with ``on_time_front`` and ``on_size_front``), ``baselines``,
        ``best`` (the name of the most accurate model), and of that one ``clips`` and ``poses``,
        ``worst`` and ``median``: positions in ``poses``.
    """
    error = np.array([model["evaluation"]["rms"] for model in models])
    fronts = {
        name: pareto_front(np.array([float(model[cost]) for model in models]), error)
        for name, cost in (("on_time_front", "ms_per_pose"), ("on_size_front", "model_bytes"))
    }
    first, best = models[0]["evaluation"], int(np.argmin(error))
    told = models[best]["evaluation"]
    clips = {
        name: clip | {"nearest_distance": first["clips"][name]["nearest_distance"]}
        for name, clip in told["clips"].items()
    }
    poses = [
        pose | {"nearest_distance": other["nearest_distance"]}
        for pose, other in zip(told["poses"], first["poses"], strict=True)
    ]
    ranking = sorted(range(len(poses)), key=lambda k: -poses[k]["rms"])
    return {
        "dataset": dict(facts),
        "models": [
            {
                **{name: value for name, value in model.items() if name != "evaluation"},
                **{name: model["evaluation"][name] for name in
                   ("rms", "p99", "max", "coherence", "pca_floor")},
                "variance_kept": variance_kept(model["evaluation"]),
                **{name: bool(front[k]) for name, front in fronts.items()},
            }
            for k, model in enumerate(models)
        ],
        "baselines": {
            "mean": {"rms": first["signal"], "bytes": facts["mean_bytes"]},
            "nearest": {"rms": first["nearest"], "bytes": facts["training_bytes"]},
            "raw": {"rms": 0.0, "bytes": facts["visibility_bytes"]},
        },
        "best": models[best]["name"],
        "clips": clips,
        "poses": poses,
        "worst": ranking[:WORST],
        "median": ranking[len(ranking) // 2],
    }  # fmt: skip


def variance_kept(evaluation: Mapping[str, Any]) -> float | None:
    """Share of the deviation from the mean that the kept components can express."""
    if not evaluation["signal"] > 0:
        return None
    return 1.0 - (evaluation["pca_floor"] / evaluation["signal"]) ** 2
