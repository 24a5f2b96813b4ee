"""Errors of what hardly moves, of what is all dark, of one pose: numbers or dashes, never NaN."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from prtnet.console import write_json
from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from prtnet.report import assemble
from runtime.report_page import page
from tests.hard_cases.measured import at_most, below
from tests.models import random_poses
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.train import train


def equal_poses(count):
    return memory_dataset(poses=np.repeat(random_poses(1, 4), count, axis=0), clips=1)


def measured(data):
    """The evaluation of a model of the dataset, on all of its clips, as JSON holds it."""
    model = train(data, SMALL)
    blocks = dataset_truth(model, data, data.clip_names)
    return evaluate(model, model, blocks, NearestPose(data))


def read_back(value, path):
    """As a file holds it: numbers that are not finite would be refused."""
    write_json(path, value)
    return json.loads(
        path.read_text(), parse_constant=lambda text: pytest.fail(f"{text} in the JSON")
    )


@pytest.mark.parametrize("count", [1, 2])
def test_one_pose_and_two_equal_ones(count, tmp_path):
    told = read_back(measured(equal_poses(count)), tmp_path / "errors.json")
    assert len(told["poses"]) == count
    assert told["poses"][0]["distance"] == 0.0
    assert told["nearest_distance"] is None  # there is no spacing to count in
    assert (told["coherence"] is None) == (count == 1)
    at_most(told["rms"], told["signal"] + 1e-6)


@pytest.mark.parametrize("level", [0.0, 3.5449])
def test_always_lit_or_always_dark(level, tmp_path):
    data = memory_dataset()
    data.read("visibility")[:] = level
    told = read_back(measured(data), tmp_path / "errors.json")
    below(max(told[name] for name in ("rms", "signal", "nearest", "pca_floor")), 1e-6)
    assert told["coherence"] is None  # nothing moves


@pytest.mark.parametrize("case", ["one pose", "always dark"])
def test_a_report_of_next_to_nothing(case):
    data = equal_poses(1) if case == "one pose" else memory_dataset()
    if case == "always dark":
        data.read("visibility")[:] = 0.0
    figures = {
        "name": "a model", "family": "models", "evaluation": measured(data), "model_bytes": 10_000,
        "ms_per_pose": 0.0, "fit_seconds": 0.0, "train_seconds": 0.0, "latents": 0.0, "inputs": 1,
        "clusters": 4, "alpha": 0.003, "training_rms": 0.0,
    }  # fmt: skip
    facts = dict.fromkeys(
        ("vertices", "receivers", "faces", "poses", "training_poses", "judged_poses"), 60
    )
    facts |= {"name": "still", "clips": data.clip_names, "held_out": False, "order": 2, "rays": 32}
    facts |= {"visibility_bytes": 960, "training_bytes": 960, "mean_bytes": 960}
    text = page(assemble(facts, [figures]))
    assert "The most accurate model here (a model) errs by 0.00 %" in text
    assert not re.search(r"\b(nan|inf|None)\b", text)
