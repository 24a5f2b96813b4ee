"""The window of fields, driven by the events it would get from a person."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh.creation as shapes

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet.canvas import Canvas, boxed, vase
from prtnet.cli_view_field import ViewFieldOptions, opened_field_viewer
from prtnet.environment import environment
from prtnet.errors import PrtnetError
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.transfer import Surface, TransferField
from runtime import recording
from runtime.field_cast import FieldCast
from runtime.field_shot import FieldShot
from runtime.field_show import FieldShow
from runtime.field_view import FieldView
from runtime.field_viewer import FieldDesk, FieldViewer
from runtime.picture import develop
from runtime.worn import PERIOD, Worn
from tests.runtime.test_lobe_stage import bumpy
from tests.runtime.windows import (
    SIZE,
    choose,
    choose_from_lists,
    drag,
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


def on_vase(transfer: TransferField | None = None) -> FieldCast:
    transfer = bumpy(1, 4) if transfer is None else transfer
    return FieldCast(Worn("vase", vase(5, 0.8)), None, transfer, file_bytes=12345)


def on_arm() -> FieldCast:
    """A patch on a character that moves."""
    scene = arm(segments=4)
    rest = scene.rest()
    canvas, source = boxed(rest.positions[0], rest.normals[0], scene.faces, (0.2, 0.2))
    return FieldCast(Worn("arm", canvas, scene, source), None, bumpy(1, 4))


def of_mesh() -> FieldCast:
    """A ball whose vertices have transfer, and rays that say it is twice as bright."""
    ball, few = shapes.icosphere(2), bumpy(1, 4)
    normals = np.asarray(ball.vertex_normals)
    tangents = np.cross(normals, [0.3, 0.5, 0.8])
    canvas = Canvas(np.asarray(ball.vertices), tangents, normals, np.asarray(ball.faces, np.int32))
    vectors = few.transfer[np.arange(len(normals)) % len(few)]
    parts = (canvas.positions, normals, canvas.frames[..., 0])
    layout = Surface(*(part.astype(np.float32) for part in parts), canvas.faces)
    transfer = TransferField(vectors, layout)

    def retrace(posed: Canvas) -> TransferField:
        assert len(posed.positions) == len(vectors)
        return dataclasses.replace(transfer, transfer=2.0 * vectors)

    return FieldCast(
        Worn("field", dataclasses.replace(canvas, places=None)), None, transfer, retrace
    )


CASTS = {"vase": on_vase, "arm": on_arm, "mesh": of_mesh,
         "glossy": lambda: on_vase(bumpy(3, 4))}  # fmt: skip


def viewer_of(window: Any, folder: Path, cast: FieldCast, **view: Any) -> FieldViewer:
    sized(window)
    clip = cast.worn.clip(None)
    seen = FieldView("" if clip is None else clip.name, twist=40.0, count=3, **view)
    desk = FieldDesk(["studio", "sky"], folder, lambda _: None, ("vase", "plane"),
                     lambda *_: cast, Path("a.safetensors"))  # fmt: skip
    found = FieldViewer(window, FieldShow(window.ctx, cast, environment), seen, desk)
    found.view.playing = found.first.playing = False
    return found


@pytest.fixture
def viewer(window: Any, tmp_path: Path) -> Iterator[FieldViewer]:
    found = viewer_of(window, tmp_path, on_vase())
    found.show.settle(found.view)
    yield found
    found.release()


@pytest.mark.parametrize("name", CASTS)
def test_the_window_shows_what_is_drawn_without_one(window, tmp_path, name):
    """As NumPy draws it: lobes by the table and not, harmonics turned exactly, the truth."""
    cast = CASTS[name]()
    found = viewer_of(window, tmp_path, cast, light_turn=70.0)
    show, view = found.show, found.view
    show.screen.samples = 0  # one, in the middle of a pixel
    view.swing, view.time = 0.4, 1.5 if cast.worn.scene else 0.0
    light = environment("studio").turned(70.0).harmonics(4)
    shot = FieldShot(view.canvas(cast.worn), light, show.camera(view), SIZE)
    wanted = {"lobes": lobe_field(cast.transfer, 3), "one lobe": lobe_field(cast.transfer, 1),
              "harmonics": cast.transfer}  # fmt: skip
    if cast.retrace is not None:
        wanted["truth"] = cast.retrace(shot.canvas)
    pictures = {}
    for (mode, field), by_table in itertools.product(wanted.items(), (True, False)):
        view.left, view.by_table = mode, by_table
        pictures[mode] = seen = read(found)
        linear = shot.draw(field, "cpu", by_table, samples=1)
        assert linear[..., 3].mean() > 0.03
        expected = develop(linear, show.exposures["studio"]).astype(int)
        assert np.mean(np.abs(seen - expected).max(axis=-1) <= 2) >= 0.999
    for one, other in itertools.combinations(pictures.values(), 2):
        assert not np.array_equal(one, other)
    found.release()


def test_a_split_shows_one_beside_the_other(viewer):
    view = viewer.view
    alone = {}
    for mode in ("lobes", "harmonics"):
        view.left = mode
        alone[mode] = read(viewer)
    press(viewer, "_1", "C")
    assert (view.left, view.right, view.split) == ("lobes", "harmonics", 0.5)
    split, half = read(viewer), SIZE[0] // 2
    assert np.array_equal(split[:, :half], alone["lobes"][:, :half])
    assert np.array_equal(split[:, half:], alone["harmonics"][:, half:])
    press(viewer, "_6")  # there is no sixth
    assert view.left == "lobes"


def test_it_plays_until_it_is_told_to_stop(window, tmp_path):
    found = viewer_of(window, tmp_path, on_arm())
    view = found.view
    pictures = [read(found)]
    press(found, "SPACE")
    for _ in range(3):
        found.step(0.1)
    assert (view.time, view.swing) == (pytest.approx(0.3), pytest.approx(0.3))
    pictures.append(read(found))
    press(found, "SPACE", "RIGHT")
    assert view.time == pytest.approx(0.3 + 1 / 30)
    found.show.advance(view, 4.0)  # around, both
    assert (view.time, view.swing) == (pytest.approx(0.3 + 1 / 30), pytest.approx(0.3 + 1 / 30))
    assert np.abs(pictures[0] - pictures[1]).max() > 20
    assert {"upload", "frame"} <= set(found.show.milliseconds)
    found.release()


def test_light_and_camera_change_the_picture_and_no_shader(viewer, monkeypatch):
    view = viewer.view
    view.split = 0.5
    pictures = [read(viewer)]
    monkeypatch.setattr(type(viewer.window.ctx), "program", None)
    drag(viewer, "RIGHT", 120, 0)
    assert view.light_turn == pytest.approx(60.0)
    pictures.append(read(viewer))
    drag(viewer, "LEFT", 100, 40)
    pictures.append(read(viewer))
    view.twist = 90.0
    pictures.append(read(viewer))
    viewer.change("light", "sky")
    pictures.append(read(viewer))
    for one, other in itertools.pairwise(pictures):
        assert np.abs(one - other).max() > 20
    press(viewer, "R")
    assert (view.light, view.light_turn, view.twist, view.split) == ("studio", 0.0, 40.0, 1.0)


def test_the_panel_draws_and_moves_nothing(viewer):
    press(viewer, "H")
    viewer.view.split = 0.4
    before = dataclasses.asdict(viewer.view)
    viewer.step(0.02)
    assert dataclasses.asdict(viewer.view) == before
    assert viewer.show.memory()["field file"] == 12345
    assert viewer.show.memory()["GPU field"] > 12 * 10 * 8
    arm_viewer = viewer_of(viewer.window, viewer.desk.out, on_arm())
    arm_viewer.step(0.02)
    assert arm_viewer.view.time == 0.0
    arm_viewer.release()


def test_lists_of_the_panel_are_opened_and_chosen_from_by_the_mouse(viewer, monkeypatch):
    viewer.view.split, viewer.view.right = 0.5, "one lobe"
    choices = (
        ("light", 1, {"light": "sky"}),
        ("shown", 2, {"left": "harmonics"}),
        ("beside", 0, {"right": "lobes"}),
    )
    places, asked = choose_from_lists(viewer, monkeypatch, choices), []

    def opened(field: Path, on: str | None) -> FieldCast:
        asked.append((field, on))
        return on_arm()

    viewer.desk.open_files = opened
    choose(viewer, places["on"], 1)
    viewer.opened()
    assert asked == [(Path("a.safetensors"), "plane")]
    assert viewer.show.cast.worn.name == "arm"


def test_what_cannot_be_shown_is_told_and_taken_back(viewer):
    viewer.step(0.0)
    press(viewer, "_4")
    viewer.step(0.0)
    assert "of a patch compare with harmonics" in viewer.message
    assert viewer.view.left == "lobes"
    viewer.change("light", "moon")
    assert viewer.view.light == "studio"
    lobes = dataclasses.replace(viewer.show.cast, lobes=lobe_field(bumpy(1, 4), 2), transfer=None)
    list(viewer.take(lobes))
    assert viewer.show.cast is lobes
    for key in ("_2", "_3"):
        viewer.message = ""
        press(viewer, key)
        viewer.step(0.0)
        assert "needs transfer" in viewer.message
        assert viewer.view.left == "lobes"


def test_the_truth_is_traced_for_a_pose_that_stays(window, tmp_path):
    asked = []
    cast = of_mesh()
    traced = cast.retrace

    def retrace(posed: Canvas) -> TransferField:
        asked.append(posed)
        return traced(posed)

    found = viewer_of(window, tmp_path, dataclasses.replace(cast, retrace=retrace), left="truth")
    found.view.playing = True
    found.step(0.1)
    assert not asked
    assert not found.show.screen.linear()[..., 3].any()  # nothing rather than something else
    found.view.playing = False
    read(found)
    read(found)
    assert len(asked) == 1
    found.view.twist = 10.0
    read(found)
    assert len(asked) == 2
    assert np.array_equal(asked[1].positions, found.show.canvas(found.view).positions)
    found.release()


def test_what_is_saved(viewer, tmp_path, monkeypatch):
    av = pytest.importorskip("av")
    monkeypatch.setattr(recording, "TURNTABLE", 2)
    monkeypatch.setattr(recording, "FPS", 2)
    for name in "STP":
        save(viewer, name)
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "clip_000.mp4", "picture_000.png", "turn_000_00.png", "turn_000_01.png",
    ]  # fmt: skip
    assert viewer.view.swing == 0.0
    with av.open(str(tmp_path / "clip_000.mp4")) as file:
        frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0)]
    assert len(frames) == 2 * PERIOD
    assert np.abs(frames[4] - frames[0]).max() > 20
    viewer.view.twist = 0.0
    save(viewer, "P")
    assert "vase: does not move" in viewer.message
    assert len(list(tmp_path.iterdir())) == 4


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fields")
    bumpy(1, 4).save(folder / "raw.safetensors")
    lobe_field(bumpy(1, 4), 2).save(folder / "lobes.safetensors")
    write_glb(arm(segments=4), folder / "arm.glb")
    return folder


@pytest.fixture
def opened(window: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """What the command opens, in the window there is."""
    monkeypatch.setattr("runtime.base_viewer.open_window", lambda *_: window)
    sized(window)
    return lambda options: opened_field_viewer(options, 1, lambda _: None)


def test_the_command_opens_what_it_is_given(opened, files, tmp_path):
    options = ViewFieldOptions(files / "raw.safetensors", on=str(files / "arm.glb"), out=tmp_path,
                               lobes=2, twist=30.0)  # fmt: skip
    found = opened(options)
    found.view.playing = False
    moving = read(found)
    assert np.ptp(moving) > 60
    found.release()
    lobes = ViewFieldOptions(files / "lobes.safetensors", out=tmp_path,
                             compare=str(files / "raw.safetensors"))  # fmt: skip
    found = opened(lobes)
    assert isinstance(found.show.cast.lobes, LobeField)
    found.view.left = "harmonics"
    assert np.ptp(read(found)) > 60
    found.release()


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"out": Path("none")}, "is no folder"),
        ({"clip": "bend"}, "of a scene that moves"),
        ({"light": "moon"}, "neither a file nor a preset"),
        ({"on": "cup"}, "does not exist"),
        ({"compare": "raw"}, "is of lobes"),
    ],
)
def test_what_the_command_refuses(opened, files, tmp_path, changes, told):
    options = ViewFieldOptions(files / "raw.safetensors", out=tmp_path)
    with pytest.raises(PrtnetError, match=told):
        opened(dataclasses.replace(options, **changes))


def test_files_that_fall_on_the_window_are_shown(opened, files, tmp_path):
    found = opened(ViewFieldOptions(files / "raw.safetensors", out=tmp_path))
    found.view.playing = False
    found.view.light_turn = 33.0
    found.step(0.0)
    shown = found.show

    def drop(*names: Path) -> None:
        send(found, "on_file_drop", 10, 10, [str(name) for name in names])
        found.opened()
        found.step(0.0)

    (tmp_path / "bad.safetensors").write_bytes(b"no field")
    (tmp_path / "notes.txt").write_text("no picture")
    for name in ("bad.safetensors", "notes.txt", "none.glb", "none.hdr"):
        drop(tmp_path / name)
        assert name in found.message
        assert found.show is shown
    drop(files / "arm.glb")
    assert found.message == "raw.safetensors on arm.glb"
    assert (found.view.clip, found.view.light_turn) == ("bend", 33.0)
    assert np.ptp(read(found)) > 60
    drop(files / "lobes.safetensors")
    assert found.message == "lobes.safetensors on arm.glb"
    assert found.show.cast.transfer is None
    found.reopen(files / "raw.safetensors", "plane", "plane")
    found.opened()
    assert found.message == "raw.safetensors on plane"
    assert found.view.clip == ""
    found.release()


def test_what_cannot_be_drawn_gives_back_what_it_took(viewer, monkeypatch):
    released, shown = [], viewer.show

    def broken(*_: Any, **__: Any) -> None:
        raise PrtnetError("field", "is too large for a texture here")

    viewer.step(0.0)
    real = FieldShow.leave
    monkeypatch.setattr("runtime.field_show.LobeStage", broken)
    monkeypatch.setattr(FieldShow, "leave", lambda self: (released.append(self), real(self))[1])
    viewer.desk.open_files = lambda *_: dataclasses.replace(
        viewer.show.cast, lobes=lobe_field(bumpy(1, 4), 1)
    )
    viewer.dropped(0, 0, ["any.safetensors"])
    viewer.opened()
    assert "too large" in viewer.message
    assert viewer.show is shown
    assert len(released) == 1


def test_a_field_of_nothing_is_none():
    with pytest.raises(ValueError, match="lobes or transfer"):
        FieldCast(Worn("vase", vase(3)))
