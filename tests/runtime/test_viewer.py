"""A real window, on a virtual screen, driven by the events it would get from a person."""

from __future__ import annotations

import dataclasses
import itertools
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet.cli_options import ViewOptions
from prtnet.cli_view import opened_viewer
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.gpu_tables import gpu_tables
from runtime.draw import opened, render_material
from runtime.picture import develop
from runtime.posed_surface import posed_subject
from runtime.show import MODES, Show, View
from runtime.viewer import Viewer, open_window
from tests.models import random_model
from tests.priors import random_prior
from tests.runtime.test_posed_surface import modelled

pytestmark = [
    pytest.mark.gl,
    pytest.mark.filterwarnings("ignore:Importing PyGLM:PendingDeprecationWarning"),
]

SIZE = (160, 120)


def shown(context, actor=None) -> Show:
    actor = actor or modelled(arm(segments=6), two_sided=False)
    truth = np.zeros((len(actor.receivers), actor.model.order**2), dtype=np.float32)
    truth[:, 0] = np.sqrt(4 * np.pi)
    tables = gpu_tables(actor.model)

    def latents(pose: np.ndarray) -> np.ndarray:
        found = actor.model.latent(pose)
        used = np.arange(found.shape[2]) < actor.model.latents[:, None]
        return found[:, used] * tables.latent_scale

    return Show(context, actor, actor.model, lambda _: truth, environment, (latents, tables))


@pytest.fixture(scope="module")
def window(display: str) -> Iterator[Any]:
    """One for all: a process has one window."""
    found = open_window("test", SIZE)
    yield found
    found.close()
    found.destroy()


@pytest.fixture
def viewer(window: Any, tmp_path: Path) -> Iterator[Viewer]:
    window.use()
    window._window.set_size(*SIZE)
    window._window.dispatch_events()
    view = View("bend", brdf="phong")
    found = Viewer(window, shown(window.ctx), view, ["studio", "sky"], ["matte", "gold"],
                   tmp_path, lambda _: None)  # fmt: skip
    found.view.playing = False
    found.first.playing = False
    yield found
    found.release()


def send(viewer: Viewer, *event: Any) -> None:
    """An event through the window's queue."""
    viewer.window._window.dispatch_event(*event)
    viewer.window._window.dispatch_events()


def press(viewer: Viewer, *names: str) -> None:
    """As the window system tells of keys."""
    from pyglet.window import key

    for name in names:
        for kind in ("on_key_press", "on_key_release"):
            send(viewer, kind, getattr(key, name), 0)


def drag(viewer: Viewer, button: str, right: int, up: int) -> None:
    """As the window system tells of a mouse, away from the panel."""
    from pyglet.window import mouse

    pressed = getattr(mouse, button)
    for kind, rest in (
        ("on_mouse_press", (pressed, 0)),
        ("on_mouse_drag", (right, up, pressed, 0)),
        ("on_mouse_release", (pressed, 0)),
    ):
        send(viewer, kind, 150, 10, *rest)


def read(viewer: Viewer, path: Path) -> np.ndarray:
    viewer.save(path)
    return np.asarray(Image.open(path)).astype(int)


def test_it_plays_until_it_is_told_to_stop(viewer):
    viewer.view.playing = True
    for _ in range(3):
        viewer.step(0.1)
    assert viewer.view.time == pytest.approx(0.3)
    press(viewer, "SPACE")
    viewer.step(0.1)
    assert viewer.view.time == pytest.approx(0.3)
    press(viewer, "RIGHT")
    assert viewer.view.time == pytest.approx(0.3 + 1 / 30)
    clip = viewer.show.actor.scene.clip("bend")
    viewer.advance(clip.end - clip.start)  # around
    assert viewer.view.time == pytest.approx(0.3 + 1 / 30)


def test_the_window_shows_what_is_drawn_without_one(viewer, tmp_path):
    show, view = viewer.show, viewer.view
    show.screen.samples = 0  # one, in the middle of a pixel
    show.operator(view, wait=True)
    viewer.step(0.0)
    seen = read(viewer, tmp_path / "seen.png")
    assert seen.shape == (SIZE[1], SIZE[0], 3)
    assert np.ptp(seen) > 60
    pose, predicted = show.pose(view), show.predicted(view)
    with opened("cpu") as renderer:
        linear = render_material(
            renderer, posed_subject(show.actor, pose, predicted), show.lit(view),
            show.operator(view), show.camera(view), SIZE, samples=1,
        )  # fmt: skip
    assert linear[..., 3].mean() > 0.03
    expected = develop(linear, show.exposures["studio"]).astype(int)
    assert np.mean(np.abs(seen - expected).max(axis=-1) <= 2) >= 0.999


def test_light_material_and_camera_change_the_picture(viewer, tmp_path):
    viewer.step(0.0)
    pictures = [read(viewer, tmp_path / "0.png")]
    view = viewer.view
    before = view.azimuth, view.light_turn, view.distance
    drag(viewer, "RIGHT", 120, 0)
    assert view.light_turn == pytest.approx(60.0)
    pictures.append(read(viewer, tmp_path / "1.png"))
    drag(viewer, "LEFT", 100, 40)
    assert view.azimuth != before[0]
    pictures.append(read(viewer, tmp_path / "2.png"))
    viewer.panel.set_checked("brdf", "gold")
    viewer.show.operator(view, wait=True)
    pictures.append(read(viewer, tmp_path / "3.png"))
    send(viewer, "on_mouse_scroll", 150, 10, 0, 3)
    assert view.distance < before[2]
    pictures.append(read(viewer, tmp_path / "4.png"))
    for one, other in itertools.pairwise(pictures):
        assert np.abs(one - other).max() > 20
    press(viewer, "R")
    assert (view.azimuth, view.light_turn, view.distance, view.brdf) == (*before, "phong")


def test_every_mode_shows_something_of_its_own(viewer, tmp_path):
    viewer.show.operator(viewer.view, wait=True)
    viewer.show.truth(viewer.view, wait=True)
    pictures = []
    for number, mode in enumerate(MODES, start=1):
        press(viewer, f"_{number}")
        assert viewer.view.left == mode
        pictures.append(read(viewer, tmp_path / f"{mode}.png"))
    for a in range(len(MODES)):
        for b in range(a):
            # The truth here is open everywhere.
            same = {MODES[a], MODES[b]} == {"truth", "open"}
            assert np.array_equal(pictures[a], pictures[b]) == same
    press(viewer, "_1", "C")
    viewer.view.right = "error"
    split = read(viewer, tmp_path / "split.png")
    half = SIZE[0] // 2
    assert np.array_equal(split[:, :half], pictures[0][:, :half])
    assert np.array_equal(split[:, half:], pictures[4][:, half:])


def test_the_panel_draws_and_explains_the_keys(viewer):
    press(viewer, "H")
    for brdf in ("matte", "gold", "satin", "phong", "ggx:roughness=0.123456789"):
        viewer.view.brdf = brdf
        viewer.step(0.02)
        assert viewer.view.brdf == brdf  # drawing sliders moves none
    assert viewer.helping
    viewer.view.split = 0.4
    viewer.step(0.02)
    viewer.window._window.set_size(200, 150)
    send(viewer, "on_resize", 200, 150)
    viewer.step(0.02)
    assert viewer.window.buffer_size == (200, 150)


def test_what_cannot_be_shown_is_said_and_left_as_it_was(viewer, tmp_path):
    viewer.dropped(0, 0, [tmp_path / "none.binary"])
    assert "does not exist" in viewer.message
    assert viewer.view.brdf == "phong"
    (tmp_path / "dark.hdr").write_bytes(b"#?RADIANCE\n")
    viewer.dropped(0, 0, [tmp_path / "dark.hdr"])
    assert "dark.hdr" in viewer.message
    viewer.panel.set_checked("light", "moon")
    assert viewer.view.light == "studio"
    viewer.step(0.0)


def test_a_frame_that_cannot_be_drawn_is_told_and_taken_back(viewer, tmp_path):
    viewer.step(0.0)
    changes = {"brdf": "gild", "light": "moon", "factors": 0, "lobes": 99, "time": 99.0}
    for name, value in changes.items():
        before = vars(viewer.view).copy()
        setattr(viewer.view, name, value)
        viewer.message = ""
        for _ in range(40):  # what is made in the background fails there
            viewer.step(0.0)
            if viewer.message:
                break
            time.sleep(0.05)
        assert viewer.message
        assert vars(viewer.view) == before

    def broken(_pose: np.ndarray) -> np.ndarray:
        raise RuntimeError("no rays today")

    viewer.show.trace = broken
    viewer.message = ""
    viewer.view.left = "truth"
    for _ in range(40):
        viewer.step(0.0)
        if viewer.message:
            break
        time.sleep(0.05)
    assert "no rays today" in viewer.message
    assert viewer.view.left == "prediction"


def test_pictures_that_cannot_be_saved_are_told(viewer, tmp_path):
    viewer.step(0.0)
    viewer.out = tmp_path / "none"
    press(viewer, "S", "T")
    assert "none" in viewer.message
    assert not list(tmp_path.iterdir())


def test_truth_is_not_shown_before_it_is_known(viewer, tmp_path):
    viewer.step(0.0)
    viewer.view.playing, viewer.view.left = True, "truth"
    viewer.step(0.0)
    viewer.show.screen.clear(SIZE)
    viewer.picture()
    assert not viewer.show.screen.linear()[..., 3].any()  # nothing rather than the prediction
    read(viewer, tmp_path / "stopped.png")
    assert viewer.show.screen.linear()[..., 3].any()
    assert not viewer.view.playing


@pytest.mark.parametrize("kind", ["neural", "constant", "hybrid", "two-sided"])
def test_the_command_opens_what_it_is_given(window, tmp_path, monkeypatch, kind):
    actor = modelled(arm(segments=6), kind == "two-sided")
    model = actor.model
    if kind == "constant":
        model = random_model("constant", joints=2, receivers=len(actor.receivers))
        model.metadata.update(actor.model.metadata)
        model.rest_tangents[:] = actor.model.rest_tangents
    if kind == "hybrid":
        prior = random_prior("maps", 2, len(actor.receivers), model.order)
        signal = np.zeros((len(actor.receivers), model.order**2), dtype=np.float32)
        model = dataclasses.replace(model, prior=prior, signal=signal)
    model.save(tmp_path / "arm.safetensors")
    write_glb(arm(segments=6), tmp_path / "arm.glb")
    files = tmp_path / "arm.safetensors", tmp_path / "arm.glb"
    monkeypatch.setattr("runtime.viewer.open_window", lambda *_: window)
    window.use()
    options = ViewOptions(*files, out=tmp_path, rays=16, threads=1, brdf="phong")
    found = opened_viewer(options, 1, lambda _: None)
    found.step(0.01)
    assert (found.show.latents is None) == (kind == "constant")
    assert (found.show.occluders is None) == (kind != "hybrid")
    found.view.playing = False
    found.view.left, found.view.right, found.view.split = "prediction", "truth", 0.5
    picture = read(found, tmp_path / "seen.png")
    assert np.ptp(picture) > 60
    found.release()
    with pytest.raises(PrtnetError, match="is no folder"):
        opened_viewer(dataclasses.replace(options, out=tmp_path / "none"), 1, lambda _: None)
    with pytest.raises(PrtnetError, match="has no clip"):
        opened_viewer(dataclasses.replace(options, clip="bnd"), 1, lambda _: None)


def test_a_turntable_is_a_row_of_pictures(viewer, tmp_path, monkeypatch):
    monkeypatch.setattr("runtime.viewer.TURNTABLE", 3)
    viewer.step(0.0)
    press(viewer, "T")
    press(viewer, "T")  # beside the first, not over it
    files = sorted(path.name for path in tmp_path.glob("turn_*.png"))
    assert files == [f"turn_{k:03d}_{number:02d}.png" for k in range(2) for number in range(3)]


def test_no_display_is_told(monkeypatch):
    import moderngl_window

    def broken(_name: str) -> None:
        raise RuntimeError('Cannot connect to "None"')

    monkeypatch.setattr(moderngl_window, "get_local_window_cls", broken)
    with pytest.raises(PrtnetError, match=r"cannot open a window .*prtnet render"):
        open_window("test", SIZE)


def test_without_the_extra_it_is_told_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    with pytest.raises(PrtnetError, match=r"pip install 'prtnet\[viewer\]'"):
        open_window("test", SIZE)
