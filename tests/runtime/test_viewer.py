"""A real window, on a virtual screen, driven by the events it would get from a person."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import sys
import threading
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
from prtnet.cli_view import cast_of, opened_viewer
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.gpu_tables import gpu_tables
from prtnet.materials import material
from prtnet.modelled_scene import Moment
from runtime import recording
from runtime.base_viewer import open_window
from runtime.cast import Cast
from runtime.crowd import crowd_places, crowd_poses, elbow_room
from runtime.draw import opened, render_material
from runtime.looks import lobes_of
from runtime.pick import projected
from runtime.picture import develop, laid_over
from runtime.posed_surface import posed_subject
from runtime.reflected import Side, Subject
from runtime.show import Show
from runtime.stage import Stage
from runtime.studio import Studio
from runtime.view import MODES, View
from runtime.viewer import Desk, Viewer
from tests.models import random_model
from tests.priors import random_prior
from tests.runtime.test_posed_surface import modelled
from tests.runtime.windows import (
    SIZE,
    choose_from_lists,
    click,
    drag,
    noted,
    press,
    read,
    save,
    send,
    sized,
)

pytestmark = [
    pytest.mark.gl,
    pytest.mark.filterwarnings("ignore:Importing PyGLM:PendingDeprecationWarning"),
]


def cast(actor=None) -> Cast:
    actor = actor or modelled(arm(segments=6), two_sided=False)
    truth = np.zeros((len(actor.receivers), actor.model.order**2), dtype=np.float32)
    truth[:, 0] = np.sqrt(4 * np.pi)
    tables = gpu_tables(actor.model)

    def latents(pose: np.ndarray) -> np.ndarray:
        found = actor.model.latent(pose)
        used = np.arange(found.shape[2]) < actor.model.latents[:, None]
        return found[:, used] * tables.latent_scale

    def radiance(pose, eye, light, brdf) -> np.ndarray:
        """The part of the light that comes straight from above, and where the eye is."""
        up = light.radiance(np.array([[0.0, 1.0, 0.0]]))
        return np.repeat(up + 0.1 * np.abs(eye), len(truth), axis=0).astype(np.float32)

    return Cast(actor, actor.model, lambda _: truth, radiance, (latents, tables), 12345)


@pytest.fixture
def viewer(window: Any, tmp_path: Path) -> Iterator[Viewer]:
    sized(window)
    view = View("bend", brdf="phong")
    desk = Desk(["studio", "sky"], tmp_path, lambda _: None, ["matte", "gold"],
                lambda *_: cast(), Path("a.safetensors"), Path("a.glb"))  # fmt: skip
    found = Viewer(window, Show(window.ctx, cast(), Studio(environment)), view, desk)
    found.view.playing = False
    found.first.playing = False
    yield found
    found.release()


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
    viewer.view.advance(viewer.show.actor, clip.end - clip.start)  # around
    assert viewer.view.time == pytest.approx(0.3 + 1 / 30)


def test_the_window_shows_what_is_drawn_without_one(viewer, tmp_path):
    show, view = viewer.show, viewer.view
    show.screen.samples = 0  # one, in the middle of a pixel
    show.operator(view, wait=True)
    viewer.step(0.0)
    seen = read(viewer)
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
    pictures = [read(viewer)]
    view = viewer.view
    before = view.azimuth, view.light_turn, view.distance
    drag(viewer, "RIGHT", 120, 0)
    assert view.light_turn == pytest.approx(60.0)
    pictures.append(read(viewer))
    drag(viewer, "LEFT", 100, 40)
    assert view.azimuth != before[0]
    pictures.append(read(viewer))
    viewer.change("brdf", "gold")
    viewer.show.operator(view, wait=True)
    pictures.append(read(viewer))
    send(viewer, "on_mouse_scroll", 150, 10, 0, 3)
    assert view.distance < before[2]
    pictures.append(read(viewer))
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
        pictures.append(read(viewer))
    for a in range(len(MODES)):
        for b in range(a):
            # The truth here is open everywhere.
            same = {MODES[a], MODES[b]} == {"visibility", "open"}
            assert np.array_equal(pictures[a], pictures[b]) == same
    press(viewer, "_1", "C")
    viewer.view.right = "error"
    split = read(viewer)
    half = SIZE[0] // 2
    assert np.array_equal(split[:, :half], pictures[0][:, :half])
    assert np.array_equal(split[:, half:], pictures[5][:, half:])


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


def test_sliders_of_the_panel_are_moved_by_the_mouse(viewer, monkeypatch):
    """Split, share of the blend, turn and lobes of light, factors, a parameter of the BRDF."""
    view, imgui, size = viewer.view, viewer.imgui, (900, 1000)
    viewer.window._window.set_size(*size)
    send(viewer, "on_resize", *size)
    view.blend_clip, view.blend = "bend", 0.5
    places = noted(viewer, monkeypatch, "slider_float", "slider_int")

    def slide(label: str, share: float) -> None:
        left, right, y = places[label]
        width = 330 - 2 * imgui.get_style().window_padding.x  # of the slider without its label
        right = min(right, left + 0.65 * width)
        click(viewer, left + share * (right - left), y)

    before = dataclasses.asdict(view)
    slide("split (C)", 0.5)
    assert 0.3 < view.split < 0.7
    slide("share", 0.8)
    assert 0.7 < view.blend < 0.9
    slide("turn", 0.25)
    assert 60.0 < view.light_turn < 120.0
    slide("factors", 0.9)
    assert view.factors > 12
    slide("exposure", 0.2)
    assert -3.0 < view.exposure < -1.8
    slide("exponent", 0.9)
    exponent = viewer.show.brdf(view).exponent
    assert view.brdf.startswith("phong:")
    assert 80.0 < exponent < 200.0  # the slider is logarithmic
    slide("time", 0.5)
    assert 1.5 < view.time < 2.5
    changed = {key for key, value in dataclasses.asdict(view).items() if value != before[key]}
    assert changed == {
        "split", "blend", "light_turn", "factors", "exposure", "brdf", "time",
    }  # fmt: skip
    assert viewer.message == ""


def test_lists_of_the_panel_are_opened_and_chosen_from_by_the_mouse(viewer, monkeypatch):
    view, show = viewer.view, viewer.show
    bend = show.actor.scene.clip("bend")
    clips = bend, dataclasses.replace(bend, name="fold", start=1.5)
    object.__setattr__(show.actor.scene, "clips", clips)
    view.split, view.right = 0.5, "open"
    choices = (
        ("clip", 1, {"clip": "fold", "time": 1.5}),
        ("blend with", 1, {"blend_clip": "bend", "blend_time": 0.0, "blend": 0.5}),
        ("order", 2, {"order": 2}),
        ("light", 1, {"light": "sky"}),
        ("lobes", 2, {"lobes": 1}),
        ("BRDF", 1, {"brdf": "gold"}),
        ("beside", 4, {"right": "ambient"}),
        ("shown", 5, {"left": "error"}),
        ("blend with", 0, {"blend_clip": ""}),
    )

    def settle() -> None:
        show.truth(view, wait=True)
        show.operator(view, wait=True)

    choose_from_lists(viewer, monkeypatch, choices, settle)
    assert viewer.message == ""


def whole_window(viewer: Viewer) -> np.ndarray:
    """A frame with the panel, in a framebuffer that no other window can lie over."""
    size = viewer.window.buffer_size
    target = viewer.window.ctx.simple_framebuffer(size)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(type(viewer.window), "fbo", property(lambda _: target))
        viewer.render(0.0, 0.02)
    data = np.frombuffer(target.read(alignment=1), dtype=np.uint8)
    target.release()
    return data.reshape(size[1], size[0], 3)[::-1].astype(int)


def test_help_lies_over_the_picture_until_it_is_asked_away(viewer):
    size = (900, 400)
    viewer.window._window.set_size(*size)
    send(viewer, "on_resize", *size)
    for _ in range(3):
        viewer.step(0.02)
    without = whole_window(viewer)
    press(viewer, "H")
    for _ in range(3):  # imgui measures a window before it is seen
        viewer.step(0.02)
    shown = np.abs(whole_window(viewer) - without).max(axis=-1)[:, 360:] > 20  # beside the panel
    rows, columns = np.nonzero(shown)
    assert np.ptp(rows) > 14 * len(viewer.help)  # a line of text each
    assert abs(rows.mean() - 0.5 * size[1]) < 0.1 * size[1]
    assert abs(columns.mean() + 360 - 0.5 * size[0]) < 0.1 * size[0]
    press(viewer, "H")
    viewer.step(0.02)
    away = np.abs(whole_window(viewer) - without)
    assert away[:, 360:].max() <= 1


@pytest.mark.parametrize("size", [(90, 200), (321, 123)])
def test_a_window_of_another_size_shows_what_is_drawn_at_that_size(viewer, size):
    show, view = viewer.show, viewer.view
    show.screen.samples = 0
    read(viewer)
    for step in (size, (250, 250), size):
        viewer.window._window.set_size(*step)
        send(viewer, "on_resize", *step)
        viewer.step(0.02)
    assert viewer.window.buffer_size == size
    seen = read(viewer)
    assert seen.shape == (size[1], size[0], 3)
    subject = posed_subject(show.actor, show.pose(view), show.predicted(view))
    with opened("cpu") as renderer:
        linear = render_material(
            renderer, subject, show.lit(view), show.operator(view), show.camera(view), size,
            samples=1,
        )  # fmt: skip
    expected = develop(linear, show.exposures["studio"]).astype(int)
    assert np.mean(np.abs(seen - expected).max(axis=-1) <= 2) >= 0.999


def test_what_cannot_be_shown_is_said_and_left_as_it_was(viewer, tmp_path):
    viewer.dropped(0, 0, [tmp_path / "none.binary"])
    assert "does not exist" in viewer.message
    assert viewer.view.brdf == "phong"
    (tmp_path / "dark.hdr").write_bytes(b"#?RADIANCE\n")
    viewer.dropped(0, 0, [tmp_path / "dark.hdr"])
    assert "dark.hdr" in viewer.message
    viewer.change("light", "moon")
    assert viewer.view.light == "studio"
    viewer.step(0.0)


def test_a_frame_that_cannot_be_drawn_is_told_and_taken_back(viewer, tmp_path):
    viewer.step(0.0)
    changes = {"brdf": "gild", "light": "moon", "factors": 0, "lobes": 12, "time": 99.0}
    for name, value in changes.items():
        before = vars(viewer.view).copy()
        setattr(viewer.view, name, value)
        viewer.message = ""
        for _ in range(1200):  # what is made in the background fails there: a busy machine is slow
            viewer.step(0.0)
            if viewer.message:
                break
            time.sleep(0.05)
        assert viewer.message
        assert vars(viewer.view) == before

    def broken(_pose: np.ndarray) -> np.ndarray:
        raise RuntimeError("no rays today")

    viewer.show.cast = dataclasses.replace(viewer.show.cast, trace=broken)
    viewer.message = ""
    viewer.view.left = "visibility"
    for _ in range(1200):
        viewer.step(0.0)
        if viewer.message:
            break
        time.sleep(0.05)
    assert "no rays today" in viewer.message
    assert viewer.view.left == "prediction"


def test_what_fails_while_a_picture_is_drawn_is_told_by_the_next(viewer, monkeypatch):
    """The material is asked for in a picture, and has failed by its end."""
    viewer.show.settle(viewer.view)
    viewer.step(0.0)
    viewer.view.factors = 0
    draw = viewer.show.draw

    def slow(*given: Any) -> None:
        draw(*given)
        if (making := viewer.show.studio._making.future) is not None:
            making.exception()

    monkeypatch.setattr(viewer.show, "draw", slow)
    viewer.picture()
    assert viewer.message == ""
    viewer.picture()
    assert "at least one factor" in viewer.message
    assert viewer.view.factors == 8


def test_pictures_that_cannot_be_saved_are_told(viewer, tmp_path):
    viewer.step(0.0)
    viewer.desk.out = tmp_path / "none"
    for name in "STMP":
        viewer.message = ""
        save(viewer, name)
        assert "none" in viewer.message
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("mode", ["visibility", "truth"])
def test_truth_is_not_shown_before_it_is_known(viewer, mode):
    viewer.step(0.0)
    viewer.view.playing, viewer.view.left = True, mode
    viewer.step(0.0)
    viewer.show.screen.clear(SIZE)
    viewer.picture()
    assert not viewer.show.screen.linear()[..., 3].any()  # nothing rather than the prediction
    save(viewer, "S")
    assert viewer.show.screen.linear()[..., 3].any()
    assert not viewer.view.playing


def test_the_truth_has_the_material_the_light_and_the_eye(viewer):
    view, show = viewer.view, viewer.show
    asked = []

    def radiance(pose, eye, light, brdf) -> np.ndarray:
        asked.append((tuple(eye), light.radiance(np.eye(3)).tobytes(), brdf))
        return np.full((len(show.actor.receivers), 3), 0.1 * len(asked), dtype=np.float32)

    show.cast = dataclasses.replace(show.cast, radiance=radiance)
    view.left = "truth"
    pictures = [read(viewer)]
    for change in ({"azimuth": 1.0}, {"light_turn": 90.0}, {"brdf": "gold"}, {"light": "sky"}):
        vars(view).update(change)
        pictures.append(read(viewer))
    assert len(set(asked)) == len(pictures)
    view.light = "studio"
    read(viewer)
    view.brdf = "matte"
    before = read(viewer), len(asked)
    view.azimuth = 2.0
    viewer.step(0.0)
    assert len(asked) == before[1]  # a diffuse surface looks alike from everywhere


def test_a_camera_that_moves_sees_the_last_truth_until_it_has_its_own(viewer):
    show, view, gate = viewer.show, viewer.view, threading.Event()
    gate.set()

    def radiance(*_: Any) -> np.ndarray:
        gate.wait()
        return np.ones((len(show.actor.receivers), 3), dtype=np.float32)

    show.cast = dataclasses.replace(show.cast, radiance=radiance)
    view.left = "truth"
    read(viewer)
    gate.clear()
    try:
        view.azimuth += 0.1
        viewer.step(0.0)
        assert show.waiting == "tracing the truth"
        assert show.screen.linear()[..., 3].any()
        view.light_turn = 50.0  # that is not what was traced
        viewer.step(0.0)
        assert not show.screen.linear()[..., 3].any()
    finally:
        gate.set()


def test_fewer_bands_are_those_of_a_smaller_model(viewer):
    """Cut where they are drawn: on the GPU, and nothing else is evaluated for it."""
    view, show = viewer.view, viewer.show
    show.screen.samples = 0
    view.left = "prediction"
    whole = read(viewer)
    program = show.rebuilt.program
    view.order = 2
    few = read(viewer)
    assert np.abs(whole - few).max() > 10
    assert show.rebuilt.program is program
    assert show._predicted is None
    subject = posed_subject(show.actor, show.pose(view), show.predicted(view))
    with opened("cpu") as renderer:
        linear = render_material(
            renderer, subject, show.lit(view), show.operator(view), show.camera(view), SIZE,
            samples=1, order=2,
        )  # fmt: skip
    expected = develop(linear, show.exposures["studio"]).astype(int)
    assert np.mean(np.abs(few - expected).max(axis=-1) <= 2) >= 0.999
    view.order = show.order
    assert np.abs(whole - read(viewer)).max() == 0


def test_poses_are_blended_and_both_clips_go_on(viewer):
    view, show = viewer.view, viewer.show
    alone = show.pose(view)
    view.blend_clip, view.blend_time, view.blend = "bend", 2.0, 0.5
    assert np.array_equal(
        show.pose(view), show.actor.blended(Moment("bend", 0.0), Moment("bend", 2.0), 0.5)
    )
    assert not np.array_equal(show.pose(view), alone)
    view.playing = True
    viewer.step(0.5)
    assert (view.time, view.blend_time) == (pytest.approx(0.5), pytest.approx(2.5))
    view.blend = 0.0
    assert np.array_equal(show.pose(view), show.actor.poses("bend", np.array([view.time])))


def test_the_vertex_under_the_mouse_shows_what_it_sees(viewer, monkeypatch):
    """As laid over the picture in NumPy; with the traced visibility beside it once it is known."""
    show, view, size = viewer.show, viewer.view, (900, 300)
    viewer.window._window.set_size(*size)  # the panel covers all of a small one
    send(viewer, "on_resize", *size)
    plain = read(viewer).astype(np.uint8)
    subject, matrix = show.subject(view), show.camera(view).matrix(size[0] / size[1])
    places = projected(subject.positions, matrix, size)
    nearest = places[:, 2].argmin()
    x, y = places[nearest, :2].astype(int)
    send(viewer, "on_mouse_motion", x, size[1] - y, 0, 0)
    for _ in range(3):  # imgui knows a frame later where the mouse is
        viewer.step(0.0)
    assert view.vertex is not None
    assert np.hypot(*(places[view.vertex[0], :2] - places[nearest, :2])) < 12
    assert show._predicted is None  # of no other vertex
    inset = []
    with monkeypatch.context() as patched:
        patched.setattr("runtime.show.inset_of", lambda *given: inset.append(given))
        show._inset = None
        show.insets(view, size)
    assert view.vertex == inset[0][1]
    (_, visibility), *others = inset[0][2]
    assert not others
    receiver = show.actor.receivers.of_vertex[view.vertex[0]]
    np.testing.assert_allclose(
        visibility, show.cast.predict(show.pose(view))[0, receiver], atol=1e-5
    )
    show._inset = None
    shown = show.insets(view, size)
    expected = plain
    for inset, place in shown:
        expected = laid_over(expected, inset, place)
    seen = read(viewer)
    assert np.abs(seen - expected.astype(int)).max() <= 1
    assert np.abs(seen - plain).max() > 50
    width = shown[1][0].shape[1]
    show.truth(view, wait=True)
    assert show.insets(view, size)[1][0].shape[1] > 1.5 * width
    press(viewer, "V")
    kept = view.vertex
    send(viewer, "on_mouse_motion", 890, 10, 0, 0)
    viewer.step(0.0)
    assert view.vertex == kept
    press(viewer, "V")
    viewer.step(0.0)
    assert view.vertex is None


def test_pixels_of_a_fine_screen_are_counted_where_the_mouse_is(viewer, monkeypatch):
    """Its framebuffer has four pixels where the mouse knows one."""
    viewer.step(0.0)
    fine = 2 * SIZE[0], 2 * SIZE[1]
    monkeypatch.setattr(type(viewer.window), "pixel_ratio", property(lambda _: 2.0))
    viewer.imgui.get_io().want_capture_mouse = False
    found = set()
    for x, y in np.ndindex(SIZE[0] // 4, SIZE[1] // 4):
        viewer.mouse = 4 * x, 4 * y
        place = 2.0 * (viewer.mouse[0] + 0.5), 2.0 * (viewer.mouse[1] + 0.5)
        found.add(viewer.pointed_at(fine))
        assert viewer.pointed_at(fine) == viewer.show.pick(viewer.view, fine, place)
    assert len(found) > 5


def test_a_minimised_window_draws_nothing(viewer, monkeypatch):
    monkeypatch.setattr(type(viewer.window), "buffer_size", property(lambda _: (0, 0)))
    viewer.picture()
    assert viewer.message == ""


@pytest.mark.parametrize("order", [0, 2])
def test_many_characters_are_each_drawn_in_their_own_pose_and_place(viewer, order):
    """As one after the other is drawn alone, by NumPy."""
    show, view = viewer.show, viewer.view
    show.screen.samples = 0
    view.order, view.time, view.distance, view.copies = order, 0.7, 2.0, 3
    seen = read(viewer)
    camera, size = show.camera(view), SIZE
    places = crowd_places(3, elbow_room(show.actor))
    poses = crowd_poses(show.actor, view, 3)
    assert np.array_equal(poses[:1], show.pose(view))
    assert len(np.unique(poses, axis=0)) == 3
    shown = show.cast.predict(poses)
    subjects = [posed_subject(show.actor, poses[k : k + 1], shown[k]) for k in range(3)]
    vertices = len(subjects[0].positions)
    side = [Side(*(np.concatenate([getattr(s.front, name) for s in subjects])
                   for name in ("visibility", "frames")))]  # fmt: skip
    crowd = Subject(
        np.concatenate([s.positions + place for s, place in zip(subjects, places, strict=True)]),
        np.concatenate([s.faces + k * vertices for k, s in enumerate(subjects)]),
        *side,
    )
    with opened("cpu") as renderer:
        linear = render_material(
            renderer, crowd, show.lit(view), show.operator(view), camera, size, samples=1,
            order=order,
        )  # fmt: skip
    expected = develop(linear, show.exposures["studio"]).astype(int)
    assert np.mean(np.abs(seen - expected).max(axis=-1) <= 2) >= 0.999
    view.copies = 1
    assert np.mean(np.abs(seen - read(viewer)).max(axis=-1) > 20) > 0.01


def test_a_crowd_is_posed_once_for_both_sides_of_the_split(viewer, monkeypatch):
    """One side shows what latents give, the other vertices alone: two evaluators, one crowd."""
    asked = []
    monkeypatch.setattr(
        "runtime.show.crowd_poses", lambda *given: (asked.append(given), crowd_poses(*given))[1]
    )
    view = viewer.view
    view.playing = False
    view.left, view.right, view.split, view.copies = "prediction", "ambient", 0.5, 3
    for _ in range(3):
        viewer.picture()
    assert len(asked) == 1
    view.time += 0.3
    viewer.picture()
    assert len(asked) == 2


def test_memory_is_told_by_what_takes_it(viewer):
    viewer.view.left = "visibility"
    viewer.show.truth(viewer.view, wait=True)
    viewer.step(0.0)
    memory = viewer.show.memory()
    assert memory["model file"] == 12345
    assert memory["process"] > 20e6
    vertices = len(viewer.show.subject(viewer.view).positions)
    assert memory["GPU visibility"] >= 4 * vertices * (3 + 6 + viewer.show.order**2)
    samples = max(1, viewer.show.screen.samples)
    assert memory["GPU picture"] == SIZE[0] * SIZE[1] * (samples * (8 + 4) + 8)


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
    monkeypatch.setattr("runtime.base_viewer.open_window", lambda *_: window)
    window.use()
    options = ViewOptions(*files, out=tmp_path, rays=16, threads=1, brdf="phong")
    found = opened_viewer(options, 1, lambda _: None)
    found.step(0.01)
    assert (found.show.cast.latents is None) == (kind == "constant")
    assert (found.show.cast.occluders is None) == (kind != "hybrid")
    found.view.playing = False
    found.view.left, found.view.right, found.view.split = "prediction", "truth", 0.5
    picture = read(found)
    assert np.ptp(picture) > 60
    found.view.copies, found.view.split, found.view.distance = 2, 1.0, 3.0
    pair = read(found)
    found.view.copies = 1
    assert np.abs(pair - read(found)).max() > 20
    found.release()
    with pytest.raises(PrtnetError, match="is no folder"):
        opened_viewer(dataclasses.replace(options, out=tmp_path / "none"), 1, lambda _: None)
    with pytest.raises(PrtnetError, match="has no clip"):
        opened_viewer(dataclasses.replace(options, clip="bnd"), 1, lambda _: None)


def test_the_exponent_of_lobes_is_live(window, tmp_path, monkeypatch):
    """A slider's next value is a uniform; fewer bands, the truth and a crowd go along."""
    actor = modelled(arm(segments=6), two_sided=True, lobes=2)
    window.use()
    view = View("bend", brdf="lobe:exponent=4,transmitted=0.2")
    desk = Desk(["studio"], tmp_path, lambda _: None, ["matte"], lambda *_: cast(),
                Path("a.safetensors"), Path("a.glb"))  # fmt: skip
    found = Viewer(window, Show(window.ctx, cast(actor), Studio(environment)), view, desk)
    found.view.playing = False
    found.step(0.0)
    first = read(found)
    monkeypatch.setattr(type(window.ctx), "program", None)
    found.change("brdf", "lobe:exponent=40,transmitted=0.2")
    assert np.abs(read(found) - first).max() > 10
    found.view.order = 2
    few = read(found)
    assert np.abs(few - first).max() > 3
    found.view.order, found.view.copies, found.view.distance = 0, 3, 3.0
    crowd = read(found)
    found.view.copies = 1
    assert np.abs(crowd - read(found)).max() > 20
    assert found.show.memory()["GPU lobes"] > 0
    found.step(0.02)
    assert "upload" in found.show.milliseconds
    found.release()


def test_models_without_lobes_have_no_such_material(viewer):
    viewer.change("brdf", "lobe")
    assert "of models that --kind lobes trained" in viewer.message
    assert viewer.view.brdf == "phong"


def test_a_turntable_is_a_row_of_pictures(viewer, tmp_path, monkeypatch):
    monkeypatch.setattr(recording, "TURNTABLE", 3)
    viewer.step(0.0)
    start = viewer.view.azimuth
    save(viewer, "T")
    save(viewer, "T")  # beside the first, not over it
    files = sorted(path.name for path in tmp_path.glob("turn_*.png"))
    assert files == [f"turn_{k:03d}_{number:02d}.png" for k in range(2) for number in range(3)]
    assert viewer.view.azimuth == start
    pictures = [np.asarray(Image.open(tmp_path / name)).astype(int) for name in files[:2]]
    assert np.abs(pictures[0] - read(viewer)).max() == 0
    assert np.abs(pictures[1] - pictures[0]).max() > 20


def test_movies_of_a_turntable_and_of_the_clip(viewer, tmp_path, monkeypatch):
    av = pytest.importorskip("av")
    monkeypatch.setattr(recording, "MOVIE_TURN", 4)
    monkeypatch.setattr(recording, "FPS", 2)
    viewer.step(0.0)
    viewer.view.time = 1.25
    save(viewer, "M")
    save(viewer, "P")
    assert viewer.view.time == 1.25
    counts = {}
    for name in ("turn_000.mp4", "clip_000.mp4"):
        with av.open(str(tmp_path / name)) as file:
            frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        counts[name] = len(frames)
        assert frames[0].shape == (SIZE[1], SIZE[0], 3)
        assert np.abs(frames[1].astype(int) - frames[0]).max() > 20
    assert counts == {"turn_000.mp4": 4, "clip_000.mp4": 9}  # four seconds, both ends


def test_escape_stops_what_is_saved_and_then_leaves(viewer, tmp_path):
    viewer.step(0.0)
    start = viewer.view.azimuth
    press(viewer, "M")
    for _ in range(3):
        viewer.step(0.0)
    assert viewer.saving is not None
    press(viewer, "ESCAPE")
    assert viewer.saving is None
    assert viewer.view.azimuth == start
    assert not viewer.window.is_closing
    assert not list(tmp_path.iterdir())  # no half of a movie
    closed = []
    viewer.window.close = lambda: closed.append(True)
    try:
        press(viewer, "ESCAPE")
    finally:
        del viewer.window.close
    assert closed


def test_files_that_fall_on_the_window_are_shown(viewer, window, tmp_path):
    actor = modelled(arm(segments=6), False)
    actor.model.save(tmp_path / "arm.safetensors")
    write_glb(arm(segments=6), tmp_path / "arm.glb")
    other = modelled(arm(segments=9), False)
    other.model.save(tmp_path / "long.safetensors")
    write_glb(arm(segments=9), tmp_path / "long.glb")
    viewer.desk.model, viewer.desk.scene = tmp_path / "arm.safetensors", tmp_path / "arm.glb"
    viewer.desk.open_files = functools.partial(cast_of, rays=16, threads=1)
    viewer.view.light_turn = 33.0
    viewer.step(0.0)
    shown = viewer.show

    def drop(*names: str) -> None:
        send(viewer, "on_file_drop", 10, 10, [str(tmp_path / name) for name in names])
        viewer.opened()
        viewer.step(0.0)

    (tmp_path / "bad.safetensors").write_bytes(b"no model")
    (tmp_path / "bad.glb").write_bytes(b"no scene")
    (tmp_path / "notes.txt").write_text("no picture")
    for name in ("bad.safetensors", "bad.glb", "none.glb", "notes.txt", "none.hdr"):
        drop(name)
        assert name in viewer.message
        assert viewer.show is shown
    drop("long.safetensors")  # its scene is missing yet
    assert "drop its scene" in viewer.message
    assert viewer.show is shown
    drop("long.glb")
    assert viewer.message == "long.safetensors on long.glb"
    assert viewer.show.actor.model.receiver_count == other.model.receiver_count
    assert viewer.view.light_turn == 33.0
    drop("arm.glb", "arm.safetensors")
    assert viewer.show.actor.model.receiver_count == actor.model.receiver_count
    assert np.ptp(read(viewer)) > 60


def test_what_is_there_is_shown_until_another_is_opened(viewer, tmp_path):
    gate, asked, shown = threading.Event(), [], viewer.show

    def slowly(*files: Path) -> Cast:
        gate.wait(5.0)
        asked.append([file.name for file in files])
        if files[0].name == "bad.safetensors":
            raise PrtnetError(files[0], "is no model")
        return cast()

    viewer.desk.open_files = slowly
    viewer.dropped(0, 0, ["one.safetensors"])
    try:
        for _ in range(3):
            viewer.step(0.0)
            assert viewer.opens == "one.safetensors"
            assert viewer.show is shown
    finally:
        threading.Timer(0.2, gate.set).start()
    viewer.dropped(0, 0, ["two.glb"])  # only goes on when the first is there
    assert viewer.desk.model == Path("one.safetensors")
    assert viewer.opens == "two.glb"
    while viewer.finish is not None:
        viewer.step(0.0)
    assert viewer.message == "one.safetensors on two.glb"
    assert viewer.opening.future is None  # what is shown no more is not held by it
    assert asked == [["one.safetensors", "a.glb"], ["one.safetensors", "two.glb"]]
    shown = viewer.show
    viewer.dropped(0, 0, ["bad.safetensors"])
    while viewer.finish is not None:
        viewer.step(0.0)
    assert viewer.message == "bad.safetensors: is no model"
    assert viewer.show is shown


def test_another_is_shown_in_steps(viewer, monkeypatch):
    """Made, drawn, the other one given back: a frame each, and none is drawn twice in one."""
    made, drawn, gone, shown = [], [], [], viewer.show
    init, draw, leave = Show.__init__, Show.draw, Show.leave
    monkeypatch.setattr(Show, "__init__", lambda *given: (made.append(given[0]), init(*given))[1])
    monkeypatch.setattr(Show, "draw", lambda *given: (drawn.append(given[0]), draw(*given))[1])
    monkeypatch.setattr(Show, "leave", lambda *given: (gone.append(given[0]), leave(*given))[1])
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    viewer.step(0.0)
    assert len(made) == 1
    assert drawn == [shown]
    viewer.view.azimuth = 1.0  # what is changed meanwhile stays changed
    viewer.step(0.0)
    assert drawn == [shown, made[0]]
    assert (viewer.show, gone) == (made[0], [])
    assert (viewer.view.azimuth, viewer.first.azimuth) == (1.0, 1.0)
    viewer.view.azimuth = 2.0
    viewer.step(0.0)
    assert (drawn[2:], gone) == ([made[0]], [shown])
    assert viewer.view.azimuth == 2.0
    assert viewer.message == "one.safetensors on a.glb"
    assert viewer.opens == ""
    viewer.step(0.0)
    assert viewer.finish is None
    assert len(made) == 1


@pytest.mark.parametrize("frames", [1, 2])
def test_a_viewer_that_is_closed_while_another_is_made_gives_both_back(
    window, viewer, monkeypatch, frames
):
    released = []
    real = Show.leave
    monkeypatch.setattr(Show, "leave", lambda self: (released.append(self), real(self))[1])
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    for _ in range(frames):
        viewer.step(0.0)
    shown = viewer.show
    viewer.release()
    assert len(released) == 2
    assert released[1] is shown
    assert released[0] is not shown


def test_what_was_there_is_given_back_before_a_movie_is_saved(viewer, monkeypatch):
    gone, leave, shown = [], Show.leave, viewer.show
    monkeypatch.setattr(Show, "leave", lambda *given: (gone.append(given[0]), leave(*given))[1])
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    viewer.step(0.0)
    viewer.step(0.0)
    assert gone == []
    press(viewer, "T")
    viewer.step(0.0)
    assert gone == [shown]
    assert viewer.saving is not None
    viewer.stop_saving()
    viewer.opened()


def test_a_movie_that_is_asked_for_as_another_is_drawn_first_does_not_hold_what_was_there(
    viewer, monkeypatch
):
    gone, leave, shown = [], Show.leave, viewer.show
    monkeypatch.setattr(Show, "leave", lambda *given: (gone.append(given[0]), leave(*given))[1])
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    viewer.step(0.0)
    while not viewer.trial:
        viewer.open_on()
    press(viewer, "T")
    assert viewer.saving is not None
    viewer.step(0.0)
    viewer.step(0.0)
    assert gone == [shown]
    assert viewer.saving is not None
    viewer.stop_saving()
    viewer.opened()


def test_a_minimised_window_shows_another_when_it_can_be_drawn(viewer, monkeypatch):
    shown, draw, drawn = viewer.show, Show.draw, []
    monkeypatch.setattr(Show, "draw", lambda *given: (drawn.append(given[0]), draw(*given))[1])
    with monkeypatch.context() as patch:
        patch.setattr(type(viewer.window), "buffer_size", (0, 0))
        viewer.dropped(0, 0, ["one.safetensors"])
        viewer.opened()
        viewer.step(0.0)
        assert viewer.trial
        assert drawn == []
    viewer.step(0.0)
    assert not viewer.trial
    assert drawn == [viewer.show]
    assert viewer.show is not shown
    viewer.opened()
    assert viewer.finish is None


def test_light_and_material_of_another_order_are_made_beside_the_frames(viewer, monkeypatch):
    made, main = [], threading.current_thread()

    def beside(real: Any, name: str) -> Any:
        def make(*given: Any, **named: Any) -> Any:
            made.append((name, threading.current_thread() is main))
            return real(*given, **named)

        return make

    viewer.step(0.0)
    monkeypatch.setattr("runtime.studio.lobes_of", beside(lobes_of, "light"))
    monkeypatch.setattr("runtime.studio.material", beside(material, "material"))
    other = cast(modelled(arm(segments=6), False, order=5))
    viewer.desk.open_files = lambda *_: other
    viewer.dropped(0, 0, ["one.safetensors"])
    while viewer.finish is not None:
        viewer.step(0.0)
    assert viewer.show.order == 5
    assert sorted(made) == [("light", False), ("material", False)]
    assert np.ptp(read(viewer)) > 60


@pytest.mark.parametrize("waited", [False, True])
def test_another_that_cannot_be_drawn_is_not_shown(viewer, monkeypatch, waited):
    shown, released, draw, leave = viewer.show, [], Show.draw, Show.leave

    def drawn(show: Show, *given: Any) -> None:
        if show is not shown:
            raise PrtnetError("--renderer gl", "cannot draw it")
        draw(show, *given)

    monkeypatch.setattr(Show, "draw", drawn)
    monkeypatch.setattr(Show, "leave", lambda show: (released.append(show), leave(show))[1])
    viewer.view.azimuth = 1.0
    viewer.step(0.0)
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    if waited:
        viewer.opened()
    for _ in range(3):
        viewer.step(0.0)
        assert viewer.show is shown
    assert viewer.finish is None
    assert viewer.message == "--renderer gl: cannot draw it"
    assert [show is shown for show in released] == [False]
    assert (viewer.view.azimuth, viewer.good.azimuth, viewer.first.azimuth) == (
        1.0,
        1.0,
        View("bend").azimuth,
    )
    assert viewer.desk.model == Path("a.safetensors")


def test_a_change_that_the_next_cannot_show_keeps_what_is_there(viewer):
    """Made in the very frame in which the next one is made."""
    shown, before = viewer.show, viewer.view.brdf
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    viewer.step(0.0)
    viewer.view.brdf = "no such material"
    viewer.step(0.0)
    assert viewer.show is shown
    assert viewer.view.brdf == before
    assert "no such material" in viewer.message


def test_nobody_waits_for_what_is_traced_for_a_character_that_is_gone(viewer, monkeypatch):
    gate, shown = threading.Event(), viewer.show
    shown.cast = dataclasses.replace(shown.cast, trace=lambda _: gate.wait(60.0))
    viewer.view.left = "visibility"
    viewer.step(0.0)
    assert shown.waiting == "tracing visibility"
    viewer.view.left = "prediction"
    try:
        viewer.dropped(0, 0, ["one.safetensors"])
        viewer.opened()
        assert viewer.show is not shown
        assert viewer.show.waiting == ""
        assert [task.busy for task in viewer.leaving] == [True]
    finally:
        threading.Timer(0.2, gate.set).start()
    viewer.release()  # but before the window is closed
    assert not any(task.busy for task in viewer.leaving)


def test_a_window_that_cannot_be_drawn_on_opens_nothing_yet(viewer, tmp_path, monkeypatch):
    """Minimised, or saved from: then what is opened waits, whatever has come of it."""
    shown = viewer.show
    viewer.dropped(0, 0, ["one.safetensors"])
    viewer.opening.future.exception()
    with monkeypatch.context() as patch:
        patch.setattr(type(viewer.window), "buffer_size", (0, 0))
        viewer.step(0.0)
    assert viewer.show is shown
    before = viewer.view.azimuth
    press(viewer, "T")
    for _ in range(3):
        viewer.step(0.0)
    assert viewer.show is shown
    assert viewer.view.azimuth != before
    viewer.opened()
    assert viewer.saving is None
    assert viewer.show is not shown
    assert viewer.view.azimuth == viewer.first.azimuth == before


def test_a_complaint_stays_until_there_is_another_result(viewer):
    def fails(*files: Path) -> Cast:
        raise PrtnetError(files[0], "is no model")

    viewer.desk.open_files = fails
    viewer.dropped(0, 0, ["bad.safetensors"])
    viewer.desk.open_files = lambda *_: cast()
    viewer.dropped(0, 0, ["good.safetensors"])
    assert viewer.message == "bad.safetensors: is no model"
    viewer.opened()
    assert viewer.message == "good.safetensors on a.glb"


def test_what_fails_when_nobody_wants_it_any_more_is_forgotten(viewer, monkeypatch):
    gate = threading.Event()

    def fails(*_: Any) -> None:
        gate.wait(5.0)
        raise PrtnetError("light", "is too bright")

    viewer.step(0.0)
    monkeypatch.setattr("runtime.studio.lobes_of", fails)
    viewer.change("light", "sky")
    viewer.step(0.0)
    viewer.change("light", "studio")
    gate.set()
    viewer.show.studio._fitting.future.exception()
    assert viewer.show.failing
    viewer.view.azimuth = 2.0
    viewer.step(0.0)
    assert not viewer.show.failing
    assert viewer.good.azimuth == 2.0
    assert viewer.message == ""


def test_the_last_light_shines_until_another_is_fitted(viewer, monkeypatch):
    gate, fitted = threading.Event(), []

    def slowly(light: np.ndarray, count: int | None) -> Any:
        gate.wait(5.0)
        fitted.append(count)
        return lobes_of(light, count)

    before = read(viewer)
    monkeypatch.setattr("runtime.studio.lobes_of", slowly)
    viewer.change("light", "sky")
    try:
        viewer.step(0.0)
        assert viewer.show.waiting == "fitting the light"
        assert "sky" not in viewer.show.exposures  # which is chosen by what it lights
        drawn = viewer.show.screen.linear()
        shown = develop(drawn, viewer.show.exposures["studio"]).astype(int)
        assert np.abs(shown - before).max() <= 2
    finally:
        gate.set()
    after = read(viewer)
    assert np.abs(after - before).max() > 5
    gate.clear()
    viewer.change("light", "top")
    viewer.step(0.0)
    shown = viewer.show
    list(viewer.take(cast()))  # while it is being fitted
    assert viewer.show is not shown
    assert viewer.show.waiting == "fitting the light"
    assert "top" not in viewer.show.exposures
    gate.set()
    viewer.show.settle(viewer.view)
    viewer.change("light", "sky")
    assert np.abs(read(viewer) - after).max() <= 1
    viewer.change("light", "studio")
    viewer.step(0.0)
    assert viewer.show.waiting == ""
    assert len(fitted) == 2  # each once for all characters


def test_a_character_that_cannot_be_drawn_gives_back_what_it_took(viewer, monkeypatch):
    released, shown = [], viewer.show

    def broken(*_: Any) -> None:
        raise PrtnetError("model", "is too large for a texture here")

    monkeypatch.setattr("runtime.show.Painted", broken)
    real = Stage.release
    monkeypatch.setattr(Stage, "release", lambda self: (released.append(self), real(self)))
    viewer.dropped(0, 0, ["any.safetensors"])
    viewer.opened()
    assert "too large" in viewer.message
    assert viewer.show is shown
    assert len(released) == 1


def test_a_window_is_closed_where_nothing_can_be_shown(window, tmp_path, monkeypatch):
    actor = modelled(arm(segments=6), False)
    actor.model.save(tmp_path / "arm.safetensors")
    write_glb(arm(segments=6), tmp_path / "arm.glb")
    closed = []

    class Fake:
        ctx = window.ctx

        def close(self) -> None:
            closed.append("closed")

        def destroy(self) -> None:
            closed.append("destroyed")

    def broken(*_: Any) -> None:
        raise PrtnetError("model", "is too large for a texture here")

    window.use()
    monkeypatch.setattr("runtime.base_viewer.open_window", lambda *_: Fake())
    monkeypatch.setattr("runtime.sight.Screen", broken)
    options = ViewOptions(tmp_path / "arm.safetensors", tmp_path / "arm.glb", out=tmp_path)
    with pytest.raises(PrtnetError, match="too large"):
        opened_viewer(options, 1, lambda _: None)
    assert closed == ["closed", "destroyed"]


def test_no_display_is_told(monkeypatch):
    import moderngl_window

    def broken(_name: str) -> None:
        raise RuntimeError('Cannot connect to "None"')

    monkeypatch.setattr(moderngl_window, "get_local_window_cls", broken)
    with pytest.raises(PrtnetError, match=r"cannot open a window .*which needs neither"):
        open_window("test", SIZE)


def test_without_the_extra_it_is_told_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "imgui_bundle", None)
    with pytest.raises(PrtnetError, match=r"pip install 'prtnet\[viewer\]'"):
        open_window("test", SIZE)
