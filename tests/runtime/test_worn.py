"""What fields are shown on, as it moves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data_gen.procedural import arm
from prtnet.canvas import boxed, vase
from prtnet.errors import PrtnetError
from runtime.worn import PERIOD, Worn, swung


def dressed() -> Worn:
    scene = arm(segments=4)
    rest = scene.rest()
    canvas, source = boxed(rest.positions[0], rest.normals[0], scene.faces, (0.1, 0.1))
    return Worn("arm", canvas, scene, source)


def test_a_scene_takes_its_canvas_along():
    worn = dressed()
    clip = worn.clip(None)
    assert clip is not None
    assert worn.clip("bend") is clip
    found = worn.at(clip, 1.5)
    posed = worn.scene.geometry(worn.scene.poses(clip, np.array([1.5])))
    assert np.array_equal(found.positions, posed.positions[0, worn.source])
    again = worn.rest.moved(found.positions, found.normals)
    assert np.array_equal(found.tangents, again.tangents)
    turned = worn.at(clip, 1.5, 0.5)
    assert np.array_equal(turned.positions, found.twisted(0.5).positions)


def test_everything_it_comes_to_is_framed():
    worn = dressed()
    clip = worn.clip("bend")
    places = worn.extent(clip, 0.4)
    low, high = places.min(axis=(0, 1)), places.max(axis=(0, 1))
    for time in (0.0, 2.0, 4.0):
        seen = worn.at(clip, time, swung(0.4, time)).positions
        assert (seen >= low - 1e-6).all()
        assert (seen <= high + 1e-6).all()


def test_a_twist_goes_to_and_fro():
    assert swung(0.7, 0.0) == 0.7
    assert swung(0.7, PERIOD / 2) == pytest.approx(-0.7)
    assert swung(0.7, PERIOD) == pytest.approx(0.7)
    still = Worn("vase", vase(3))
    assert still.clip(None) is None
    times = still.times(None, True, 10.0)
    assert len(times) == 40
    assert times[-1] == pytest.approx(PERIOD - 0.1)
    assert np.array_equal(
        still.at(None, 0.0, math.pi).positions, still.rest.twisted(math.pi).positions
    )
    assert still.extent(None, 0.3).shape == (5, *still.rest.positions.shape)


def test_what_there_is_none_of_is_told():
    worn = dressed()
    with pytest.raises(PrtnetError, match="runs from 0 to 4 s"):
        worn.at(worn.clip(None), 4.1)
    with pytest.raises(PrtnetError, match="did you mean 'bend'"):
        worn.clip("bnd")
    with pytest.raises(PrtnetError, match="vase: does not move"):
        Worn("vase", vase(3)).times(None, False, 10.0)
