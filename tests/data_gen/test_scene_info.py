"""What ``prtnet info`` says of a scene."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from data_gen.readers import read_scene
from data_gen.scene_info import describe, moving_joints, open_edges
from prtnet.animation import Channel, Clip
from prtnet.scene import SkinnedScene
from tests.small_scene import small_scene

FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)


def test_facts_of_a_character() -> None:
    facts = describe(small_scene())
    assert json.loads(json.dumps(facts)) == facts
    assert (facts["kind"], facts["vertices"], facts["receivers"]) == ("skinned", 8, 8)
    assert (facts["triangles"], facts["joints"], facts["morph_targets"]) == (8, 2, 2)
    assert (facts["open_edges"], facts["closed"], facts["flat_shaded"]) == (0, True, False)
    assert facts["clips"] == {
        "one": {"seconds": 1.0, "keys": 3},
        "two": {"seconds": 1.0, "keys": 3},
    }


def test_facts_of_the_sample_cloth(shared_data: Path) -> None:
    facts = describe(read_scene(shared_data / "cloth_train.npz"))
    assert (facts["kind"], facts["open_edges"], facts["closed"]) == ("point_cache", 256, False)
    assert facts["clips"]["cloth_train"] == {"seconds": 11.966667, "keys": 360}


def test_facts_of_the_sample_arm(shared_data: Path) -> None:
    facts = describe(read_scene(shared_data / "arm.glb"))
    assert facts["closed"]
    assert facts["joints_that_never_move"] == ["Upper"]
    assert facts["box_max"][1] == pytest.approx(0.64)


def test_a_joint_moves_if_anything_above_it_does() -> None:
    scene = small_scene()

    def moving(*clips: Clip) -> list[bool]:
        return list(moving_joints(replace(scene, clips=clips)))

    keys, still, shift = np.array([0.0, 1.0]), np.ones((2, 3)), np.array([[1.0, 1, 1], [1, 2, 1]])
    high = Clip("high", 0, 1, (Channel(2, "translation", keys, shift),))
    low = Clip("low", 0, 1, (Channel(1, "translation", keys, shift),))
    hold = Clip("hold", 0, 1, (Channel(1, "translation", keys, still),))
    elsewhere = Clip("elsewhere", 0, 1, (Channel(1, "translation", keys, 2 * still),))
    assert moving() == [False, False]
    assert moving(hold) == [False, False]
    assert moving(high) == [False, True]
    assert moving(low) == [True, True]
    assert moving(elsewhere) == [False, False]
    assert moving(hold, elsewhere) == [True, True]  # it stands elsewhere in the other clip


def test_open_edges() -> None:
    assert open_edges(CORNERS, FACES) == 0
    assert open_edges(CORNERS, FACES[:3]) == 3
    split = CORNERS[FACES.ravel()]  # no shared vertex, but still closed
    assert open_edges(split, np.arange(12).reshape(4, 3)) == 0
    assert open_edges(CORNERS, np.concatenate([FACES, [[0, 0, 1]]])) == 0


def test_scenes_without_clips_are_described() -> None:
    scene: SkinnedScene = replace(small_scene(), clips=())
    facts = describe(scene)
    assert facts["clips"] == {}
    assert facts["joints_that_never_move"] == ["low", "high"]
