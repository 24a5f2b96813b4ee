"""The viewer of all-frequency fields, on a virtual screen, with the events of a person."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prtnet.all_frequency_file import load_fields, save_fields
from prtnet.cli_view_all_frequency import AllFrequencyViewOptions, opened_all_frequency_viewer
from prtnet.cube_map import segment_coefficients
from prtnet.environment import about_up, environment
from prtnet.errors import PrtnetError
from prtnet.transfer import TransferField
from prtnet.turning_light import TurningLight
from runtime.all_frequency import gathered, seen_from, transformed
from runtime.all_frequency_sight import AllFrequencySight, AllFrequencyView
from runtime.all_frequency_viewer import AllFrequencyDesk, AllFrequencyViewer
from runtime.picture import develop
from runtime.rasteriser import rasterise
from tests.all_frequency import ball, random_field
from tests.runtime.test_all_frequency_shot import on_ground
from tests.runtime.windows import SIZE, choose_from_lists, press, sized

pytestmark = [
    pytest.mark.gl,
    pytest.mark.filterwarnings("ignore:Importing PyGLM:PendingDeprecationWarning"),
]


@pytest.fixture
def viewer(window: Any, tmp_path: Path) -> Iterator[AllFrequencyViewer]:
    sized(window)
    desk = AllFrequencyDesk(["studio", "sky"], tmp_path, lambda _: None, load_fields)
    show = AllFrequencySight(window.ctx, on_ground(), environment)
    found = AllFrequencyViewer(window, show, AllFrequencyView(), desk)
    found.view.playing = found.first.playing = False
    yield found
    found.release()


def expected(viewer: AllFrequencyViewer) -> np.ndarray:
    """The picture by NumPy, one sample a pixel, with the light spread."""
    view, show = viewer.view, viewer.show
    fields = show.fields if view.ground else show.fields[:1]
    light = TurningLight(environment(view.light), 8).at(about_up(view.light_turn))
    camera, coefficients = show.camera(view), segment_coefficients(light)
    eye, matrix = np.asarray(camera.eye), camera.matrix(SIZE[0] / SIZE[1])
    colours = [seen_from(one, gathered(one, transformed(one, coefficients)), eye) for one in fields]
    before = np.cumsum([0, *(len(one) for one in fields[:-1])])
    linear = rasterise(
        np.concatenate([one.surface.positions for one in fields]),
        np.concatenate([one.surface.faces + n for one, n in zip(fields, before, strict=True)]),
        np.concatenate(colours), matrix, SIZE,
    )  # fmt: skip
    return develop(linear, show.exposures[view.light] * 2.0**view.exposure).astype(int)


def same(got: np.ndarray, want: np.ndarray) -> bool:
    return float(np.mean(np.abs(got.astype(int) - want).max(axis=-1) <= 2)) >= 0.999


def test_the_picture_is_that_of_numpy(viewer):
    viewer.show.screen.samples = 0
    view = viewer.view
    for change in ({}, {"azimuth": 2.0}, {"light_turn": 130.0}, {"ground": False}):
        for name, value in change.items():
            setattr(view, name, value)
        assert same(viewer.pixels(), expected(viewer))


def test_only_what_has_changed_is_made_anew(viewer):
    viewer.pixels()
    viewer.step(0.0)
    assert set(viewer.show.milliseconds) == {"draw", "frame"}
    viewer.view.azimuth += 0.3
    viewer.step(0.0)
    assert set(viewer.show.milliseconds) == {"draw", "frame"}
    viewer.view.light_turn += 5.0
    viewer.step(0.0)
    assert {"light", "products"} < set(viewer.show.milliseconds)


def test_light_low_in_frequency_stands_beside_all_of_it(viewer):
    viewer.change("light", "sun")
    whole = viewer.pixels()
    press(viewer, "_3")
    assert viewer.view.left == "low"
    low = viewer.pixels()
    assert np.abs(whole.astype(int) - low).max() > 10
    viewer.view.left = "all"
    press(viewer, "C")
    both = viewer.pixels()
    half = SIZE[0] // 2
    np.testing.assert_array_equal(both[:, :half], whole[:, :half])
    np.testing.assert_array_equal(both[:, half:], low[:, half:])


def test_some_wavelets_of_the_light(viewer):
    whole = viewer.pixels()
    press(viewer, "_2")
    view = viewer.view
    view.keep = 384
    np.testing.assert_array_equal(viewer.pixels(), whole)
    view.keep = 3
    assert np.abs(viewer.pixels().astype(int) - whole).max() > 10
    viewer.step(0.0)  # with its slider


def test_lists_of_the_panel_are_opened_and_chosen_from_by_the_mouse(viewer, monkeypatch):
    viewer.view.split, viewer.view.right, viewer.view.keep = 0.5, "some", 3
    choices = (
        ("light", 1, {"light": "sky"}),
        ("shown", 2, {"left": "low"}),
        ("beside", 0, {"right": "all"}),
    )
    choose_from_lists(viewer, monkeypatch, choices)


def test_the_light_turns_while_time_goes_on(viewer):
    view = viewer.view
    view.turning = 90.0
    press(viewer, "SPACE")
    viewer.step(0.5)
    assert view.light_turn == pytest.approx(45.0)
    press(viewer, "SPACE")
    viewer.step(0.5)
    assert view.light_turn == pytest.approx(45.0)
    press(viewer, "LEFT")
    assert view.light_turn == pytest.approx(42.0)


def test_a_movie_of_the_light_is_once_around(viewer):
    view = viewer.view
    view.turning, view.light_turn = -120.0, 10.0
    seen = []
    for number, count in viewer.show.through(view, 4):
        assert count == 12
        seen.append((number, round(view.light_turn)))
    assert seen[:3] == [(0, 10), (1, 340), (2, 310)]
    assert len(seen) == 12
    assert view.light_turn == 10.0
    view.turning = 0.0
    assert len(list(viewer.show.through(view, 4))) == 4


def test_the_panel_and_the_help_are_drawn(viewer):
    viewer.step(0.1)
    press(viewer, "H")
    viewer.step(0.1)
    assert viewer.helping
    assert viewer.show.memory()["GPU field"] > 1000


def test_fields_and_lights_fall_on_the_window(viewer, tmp_path):
    other = tmp_path / "other.safetensors"
    save_fields(other, [random_field(8, ball(1))])
    viewer.dropped(0, 0, [str(other)])
    viewer.opened()
    assert viewer.message == "other.safetensors"
    assert len(viewer.show.fields[0]) == 42
    viewer.step(0.0)
    matte = tmp_path / "matte.safetensors"
    TransferField(np.ones((42, 1, 4), dtype=np.float32), ball(1)).save(matte)
    viewer.dropped(0, 0, [str(matte)])
    viewer.opened()
    assert "is a prtnet transfer field" in viewer.message
    assert len(viewer.show.fields[0]) == 42
    viewer.dropped(0, 0, [str(tmp_path / "absent.hdr")])
    assert viewer.message
    viewer.step(0.0)


def test_the_command_opens_it(viewer, tmp_path, monkeypatch):
    path = tmp_path / "a.safetensors"
    save_fields(path, on_ground())
    options = AllFrequencyViewOptions(path, light="sky", turning=10.0, out=tmp_path)
    monkeypatch.setattr("runtime.base_viewer.open_window", lambda *_: viewer.window)
    found = opened_all_frequency_viewer(options, 1, lambda _: None)
    assert (found.view.light, found.view.turning) == ("sky", 10.0)
    assert found.show.file_bytes == path.stat().st_size
    found.release()
    for change, said in (
        ({"out": tmp_path / "nowhere"}, "no folder"),
        ({"light": "moonshine"}, "neither a file nor a preset"),
        ({"field": tmp_path / "absent.safetensors"}, "does not exist"),
    ):
        with pytest.raises(PrtnetError, match=said):
            opened_all_frequency_viewer(dataclasses.replace(options, **change), 1, print)
