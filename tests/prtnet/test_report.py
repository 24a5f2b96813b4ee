from __future__ import annotations

import numpy as np
import pytest

from prtnet.report import assemble, judged_clips, pareto_front, variance_kept
from tests.training.data import memory_dataset


def slow_front(cost: np.ndarray, error: np.ndarray) -> list[bool]:
    return [
        not any(
            c <= cost[k] and e <= error[k] and (c < cost[k] or e < error[k])
            for c, e in zip(cost, error, strict=True)
        )
        for k in range(len(cost))
    ]


@pytest.mark.parametrize("seed", range(5))
def test_front_is_what_nothing_beats(seed: int) -> None:
    cost, error = np.random.default_rng(seed).integers(0, 6, (2, 20)).astype(float)
    assert pareto_front(cost, error).tolist() == slow_front(cost, error)


def test_front_of_one_and_of_equals() -> None:
    assert pareto_front(np.array([1.0]), np.array([2.0])).tolist() == [True]
    assert pareto_front(np.ones(3), np.ones(3)).tolist() == [True, True, True]


def evaluation(rms: float, nearest: float | None, errors: list[float]) -> dict:
    poses = [
        {"clip": "a", "time": float(k), "rms": e, "distance": 0.1 * k,
         "nearest_distance": None if nearest is None else float(k)}
        for k, e in enumerate(errors)
    ]  # fmt: skip
    clip = {"rms": rms, "p99": 2 * rms, "max": 3 * rms, "held_out": True, "coherence": 0.5,
            "distance": {"mean": 0.1, "max": 0.2},
            "nearest_distance": None if nearest is None else {"mean": 1.0, "max": 2.0}}  # fmt: skip
    return {**clip, "clips": {"a": clip}, "poses": poses, "signal": 0.1, "nearest": nearest,
            "pca_floor": 0.05}  # fmt: skip


def test_the_most_accurate_model_is_told_in_full() -> None:
    models = [
        {"name": "cheap", "family": "f", "evaluation": evaluation(0.06, 0.04, [0.1, 0.2, 0.3]),
         "model_bytes": 10, "ms_per_pose": 1.0},
        {"name": "good", "family": "f", "evaluation": evaluation(0.03, None, [0.2, 0.5, 0.1]),
         "model_bytes": 20, "ms_per_pose": 1.0},
    ]  # fmt: skip
    facts = {"mean_bytes": 1, "training_bytes": 2, "visibility_bytes": 3}
    told = assemble(facts, models)
    assert told["best"] == "good"
    assert told["worst"] == [1, 0, 2]
    assert told["median"] == 0
    assert [pose["nearest_distance"] for pose in told["poses"]] == [0.0, 1.0, 2.0]
    assert told["clips"]["a"]["nearest_distance"] == {"mean": 1.0, "max": 2.0}
    assert told["baselines"]["raw"] == {"rms": 0.0, "bytes": 3}
    assert told["baselines"]["nearest"] == {"rms": 0.04, "bytes": 2}
    assert [m["on_time_front"] for m in told["models"]] == [False, True]
    assert [m["on_size_front"] for m in told["models"]] == [True, True]
    assert told["models"][0]["variance_kept"] == pytest.approx(0.75)
    assert "evaluation" not in told["models"][0]


def test_nothing_to_keep_is_unknown() -> None:
    assert variance_kept({"signal": 0.0, "pca_floor": 0.0}) is None


def test_models_are_judged_by_what_they_have_not_seen_where_there_is_any() -> None:
    assert judged_clips(memory_dataset()) == ["clip2"]
    all_seen = memory_dataset(clips=1)
    all_seen.clip_names.append("sampled")
    assert judged_clips(all_seen) == ["clip0"]
