from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.frames import FrameField
from prtnet.occluders import cap_integrals
from prtnet.patches import PatchSurroundings, flipped
from prtnet.storage import Packing, rounded
from tests.cloth import folding_sheet, surroundings_of

SCENE = folding_sheet()
POSES = SCENE.frames.reshape(len(SCENE.frames), -1)


@pytest.fixture(scope="module")
def fitted():
    return surroundings_of(SCENE)


def slow(seen: PatchSurroundings, points: np.ndarray, frame: np.ndarray, receiver: int):
    """Features of one receiver in one pose, a patch at a time; its frame is given."""
    here = points[seen.vertex[receiver % len(seen.vertex)]]
    row = receiver % len(seen.vertex)
    local = np.array([(points[v] - here) @ frame / seen.size for v in seen.control[row]])
    local = local / seen.radius[:, None]
    total = np.zeros(seen.order**2)
    for patch in seen.near[row]:
        if patch < 0:
            continue
        members = np.flatnonzero((seen.patch == patch).any(axis=0))
        weight = seen.area[members].astype(float)
        centre = (weight[:, None] * points[members]).sum(axis=0) / weight.sum()
        area = np.zeros(3)
        for face in seen.faces:
            a, b, c = points[face]
            area += np.isin(face, members).sum() / 3 * 0.5 * np.cross(b - a, c - a)
        away = centre - here
        distance = np.linalg.norm(away)
        direction = away / distance
        solid = abs(area @ direction)
        sine2 = solid / (np.pi * distance**2 + solid)
        toward = direction @ frame
        above = np.clip(0.5 + 0.5 * toward[2] / max(np.sqrt(sine2), 0.05), 0, 1)
        integrals = 2 * np.pi * cap_integrals(np.sqrt(1 - sine2), seen.order)
        total += above * integrals[sh.bands(seen.order)] * sh.evaluate(toward, seen.order)
    return np.concatenate([local.T.ravel(), total])


def test_features_are_those_of_the_slow_reference(fitted):
    seen, receivers, tangents = fitted
    frames = FrameField(SCENE, receivers, tangents).frames(POSES).astype(np.float64)
    values = seen(POSES)
    assert values.shape == (len(POSES), len(receivers), seen.feature_count)
    assert values.dtype == np.float32
    for pose in (0, 2, 3):
        for receiver in (0, 17, 60, 107, 108, 125, 200):
            wanted = slow(seen, SCENE.frames[pose].astype(float), frames[pose, receiver], receiver)
            np.testing.assert_allclose(values[pose, receiver], wanted, atol=2e-5)


@pytest.mark.parametrize("storage", ["float32", "float16"])
def test_features_ignore_where_the_sheet_is_and_how_it_is_turned(fitted, storage):
    seen = fitted[0]
    if storage == "float16":  # as a model keeps it: weights no longer add up to zero
        weight = rounded(seen.carry_weight, Packing("float16", axis=(-2, -1)))
        seen = dataclasses.replace(seen, carry_weight=weight)
    turn = Rotation.random(rng=np.random.default_rng(3)).as_matrix()
    moved = SCENE.frames.astype(np.float64) @ turn.T + np.array([3.0, -1.0, 2.0])
    np.testing.assert_allclose(
        seen(moved.reshape(len(POSES), -1)), seen(POSES.astype(np.float64)), atol=1e-5
    )


def test_the_back_is_the_front_of_the_sheet_turned_over(fitted):
    seen = fitted[0]
    over = dataclasses.replace(seen, faces=seen.faces[:, ::-1])
    half = len(seen.vertex)
    np.testing.assert_allclose(over(POSES)[:, :half], seen(POSES)[:, half:], atol=1e-5)


def test_blocks_do_not_matter(fitted, monkeypatch):
    whole = fitted[0](POSES)
    monkeypatch.setattr("prtnet.patches.BLOCK_PAIRS", 1)
    np.testing.assert_array_equal(fitted[0](POSES), whole)


def test_half_a_turn_about_x_changes_signs_only():
    directions = sh.fibonacci_sphere(40)
    turned = sh.evaluate(directions * np.array([1.0, -1.0, -1.0]), 4)
    np.testing.assert_allclose(turned, flipped(4) * sh.evaluate(directions, 4), atol=1e-6)


def test_arrays_are_all_of_it(fitted):
    seen = fitted[0]
    again = PatchSurroundings.from_arrays(seen.arrays())
    np.testing.assert_array_equal(again(POSES[2:]), seen(POSES[2:]))


@pytest.mark.parametrize("name", ["faces", "vertex", "carry_vertex", "control", "near"])
def test_arrays_that_point_nowhere_are_refused(fitted, name):
    arrays = fitted[0].arrays()
    arrays[name] = arrays[name] + 1000
    with pytest.raises(ValueError, match=f"{name} points outside"):
        PatchSurroundings.from_arrays(arrays)
