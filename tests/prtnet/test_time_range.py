from __future__ import annotations

import numpy as np
import pytest

from prtnet.animation import Clip
from prtnet.errors import PrtnetError
from prtnet.scene import PointCacheScene
from prtnet.time_range import is_seen, part_of, time_range
from tests.data_gen.meshes import cache


def sheet(*clips: Clip) -> PointCacheScene:
    import dataclasses

    frames = np.array([[[0, 0, 0], [1, 0, 0], [0, 0, 1]]] * 3, dtype=float)
    return dataclasses.replace(cache(frames, np.array([[0, 2, 1]])), clips=clips)


def test_spelling() -> None:
    assert time_range("walk@1.5:3") == ("walk", 1.5, 3.0)
    assert time_range("a@b@:2") == ("a@b", 0.0, 2.0)
    assert time_range("walk@9:") == ("walk", 9.0, np.inf)
    assert time_range("walk") is time_range("walk@home") is time_range("@1:2") is None


@pytest.mark.parametrize("name", ["walk@2:1", "walk@1:1", "walk@1.2.3:4"])
def test_ranges_that_are_none(name: str) -> None:
    with pytest.raises(PrtnetError, match="write CLIP@START:END in seconds"):
        time_range(name)


def test_a_part_is_cut_to_its_clip() -> None:
    scene = sheet(Clip("fall", 0.5, 3.0), Clip("fall@1:2", 7.0, 8.0))
    part = part_of(scene, "fall@0:2.5")
    assert (part.name, part.start, part.end) == ("fall@0:2.5", 0.5, 2.5)
    assert part_of(scene, "fall@1:2").start == 7.0  # a clip that is called so
    assert part_of(scene, "fall").end == 3.0
    with pytest.raises(PrtnetError, match=r"fall@3:4: clip 'fall' runs from 0.5 to 3 s"):
        part_of(scene, "fall@3:4")
    with pytest.raises(PrtnetError, match="did you mean 'fall'"):
        part_of(scene, "fal@1:2.5")


def test_what_training_saw() -> None:
    training, held_out = ("fall", "run"), ("fall@9:12", "walk")
    seen = {
        "fall": True, "fall@9:12": False, "fall@9.5:10": False, "fall@8:10": True,
        "walk": False, "walk@1:2": False, "run@1:2": True, "new": False,
    }  # fmt: skip
    assert {name: is_seen(name, training, held_out) for name in seen} == seen
