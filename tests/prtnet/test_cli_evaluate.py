from __future__ import annotations

from typing import Any

from prtnet.cli_evaluate import summary


def pose(clip: str, rms: float, time: float | None = 1.25, **distances: float) -> dict[str, Any]:
    return {"clip": clip, "time": time, "rms": rms, "distance": None, "nearest_distance": None,
            **distances}  # fmt: skip


def results(*poses: dict[str, Any], held_out: str) -> dict[str, Any]:
    clips = {p["clip"]: {"rms": 0.1, "held_out": p["clip"] == held_out} for p in poses}
    return {"rms": 0.1, "clips": clips, "poses": list(poses)}


def test_worst_poses_are_shown_with_their_distance_from_training() -> None:
    seen = pose("Walk", 0.9)
    near = pose("Jump", 0.05, time=0.5, distance=0.0, nearest_distance=0.25)
    far = pose("Jump", 0.125, distance=1.5, nearest_distance=4.0)
    unknown = pose("Jump", 0.0625, time=None)
    shown = summary(results(seen, near, far, unknown, held_out="Jump"))
    assert list(shown["worst_poses"].items()) == [
        ("Jump at 1.25 s", {"rms": "12.50 %", "distance": "1.500", "nearest_distance": "4.000"}),
        ("Jump", {"rms": "6.25 %", "distance": "–", "nearest_distance": "–"}),
        ("Jump at 0.50 s", {"rms": "5.00 %", "distance": "0.000", "nearest_distance": "0.250"}),
    ]
    assert shown["rms"] == "10.00 %"
    assert "poses" not in shown


def test_poses_that_training_saw_are_shown_where_there_are_no_others_and_only_a_few() -> None:
    seen = [pose("Walk", 0.01 * k, time=float(k)) for k in range(20)]
    worst = summary(results(*seen, held_out="none"))["worst_poses"]
    assert list(worst) == [f"Walk at {k}.00 s" for k in (19, 18, 17, 16, 15)]
