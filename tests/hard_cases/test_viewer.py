"""The viewer and its windowless twin where there is no display, no OpenGL, or not for long."""

from __future__ import annotations

import os
import subprocess
import sys

import moderngl
import numpy as np
import pytest
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet.cli import run
from prtnet.cli_render import tracers
from prtnet.environment import environment
from runtime.cast import Cast
from runtime.gl import create_context
from runtime.show import Show
from runtime.studio import Studio
from runtime.view import View
from tests.hard_cases.measured import above, says
from tests.prtnet.test_exr import write
from tests.runtime.test_posed_surface import modelled
from tests.virtual_screen import started_screen

START = 60.0  # seconds that a window may take to open on a busy machine


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    folder = tmp_path_factory.mktemp("viewer")
    modelled(arm(segments=6), False).model.save(folder / "arm.safetensors")
    write_glb(arm(segments=6), folder / "arm.glb")
    return [str(folder / "arm.safetensors"), str(folder / "arm.glb")]


def prtnet(*words: str, **changes: str | None) -> subprocess.CompletedProcess[str]:
    """A process of its own, with other variables in its environment; None takes one out."""
    environment = {**os.environ, **changes}
    kept = {name: value for name, value in environment.items() if value is not None}
    command = [sys.executable, "-m", "prtnet", *words]
    return subprocess.run(command, env=kept, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("display", [None, "", ":987"])
def test_without_a_display_it_is_one_line(files, display):
    pytest.importorskip("moderngl_window")
    done = prtnet("view", *files, DISPLAY=display, WAYLAND_DISPLAY=None)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("prtnet: error: prtnet view: cannot open a window with OpenGL (")
    says(done.stderr, "prtnet render")


@pytest.mark.gl
def test_opengl_that_is_too_old_is_one_line(files, display):
    done = prtnet("view", *files, DISPLAY=display, MESA_GL_VERSION_OVERRIDE="2.1")
    assert done.returncode == 2
    says(done.stderr, "cannot open a window with OpenGL")


def test_without_opengl_pictures_are_drawn_by_numpy_and_it_is_said(files, tmp_path):
    out = tmp_path / "frame.png"
    nowhere = {
        "__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path),
        "LIBGL_DRIVERS_PATH": str(tmp_path),
        "MESA_LOADER_DRIVER_OVERRIDE": "none",
    }
    words = ("--out", str(out), "--size", "64x48", "--vertex", "3", "--beside", "ambient")
    done = prtnet("render", *files, *words, **nowhere)
    assert done.returncode == 0
    assert "OpenGL is not available: drawing with NumPy" in done.stdout + done.stderr
    with Image.open(out) as picture:
        assert picture.size == (64, 48)
    done = prtnet("render", *files, *words, "--renderer", "gl", **nowhere)
    assert done.returncode == 2
    says(done.stderr, "use --renderer cpu")


@pytest.mark.parametrize("command", ["render", "view"])
def test_a_model_for_another_mesh_is_one_line(files, tmp_path, capsys, command):
    """Told before a window is opened or a file is begun."""
    write_glb(arm(segments=7), tmp_path / "other.glb")
    out = ("--out", str(tmp_path / "frame.png")) if command == "render" else ()
    assert run([command, files[0], str(tmp_path / "other.glb"), *out]) == 2
    errors = capsys.readouterr().err
    says(errors, "other.glb: is not the mesh this model was fitted to (")
    assert [path.name for path in tmp_path.iterdir()] == ["other.glb"]


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def test_under_a_black_light_the_character_is_black(files, tmp_path, renderer):
    """Also beside its truth, and with nothing to choose an exposure by."""
    write(tmp_path / "night.exr", {"RGB": np.zeros((8, 16, 3), np.float32)})
    out = tmp_path / "frame.png"
    words = ("--light", str(tmp_path / "night.exr"), "--size", "64x48", "--renderer", renderer,
             "--quiet")  # fmt: skip
    rays = "--rays", "16"
    looks = (), ("--beside", "truth", *rays), ("--compare", "truth", *rays), ("--brdf", "gold")
    for more in looks:
        assert run(["render", *files, "--out", str(out), *words, *more]) == 0
        picture = np.asarray(Image.open(out)).astype(int)
        above((picture[:48, :64].max(axis=-1) == 0).mean(), 0.02)


@pytest.mark.parametrize(("bad", "name"), [(np.nan, "nan"), (np.inf, "inf")])
def test_lights_of_no_numbers_are_one_line(files, tmp_path, capsys, bad, name):
    write(tmp_path / "bad.exr", {"RGB": np.full((8, 16, 3), bad, np.float32)})
    for command, out in (("render", ("--out", str(tmp_path / "frame.png"))), ("view", ())):
        assert run([command, *files, "--light", str(tmp_path / "bad.exr"), *out]) == 2
        errors = capsys.readouterr().err
        says(errors, f"bad.exr: holds {name} in row 0, column 0")
    assert [path.name for path in tmp_path.iterdir()] == ["bad.exr"]


@pytest.mark.gl
def test_opengl_without_timers_tells_no_milliseconds_of_it_and_draws_the_same(monkeypatch):
    """A whole frame of a viewer: the stages that the CPU times are told all the same."""
    actor = modelled(arm(segments=6), False)
    cast = Cast(actor, actor.model, *tracers(actor, 16, 1))
    pictures, told = [], []
    for timers in (True, False):
        if not timers:
            monkeypatch.setattr(moderngl.Context, "query", no_queries)
        context = create_context()
        with context:
            show = Show(context, cast, Studio(environment))
            target = context.simple_framebuffer((96, 72))
            for _ in range(3):
                show.draw(View("bend", 1.0, brdf="gold"), (96, 72), target)
            pictures.append(target.read())
            told.append(set(show.milliseconds))
            show.release()
        context.release()
    assert pictures[0] == pictures[1]
    above(np.ptp(np.frombuffer(pictures[0], np.uint8)), 60)
    assert told[0] - told[1] == {"draw"}
    assert {"frame", "upload"} <= told[1]


def no_queries(*_args: object, **_kwargs: object) -> None:
    """As drivers that have none."""
    raise RuntimeError("no timer queries")


@pytest.mark.gl
def test_a_display_that_goes_away_is_one_line(files, tmp_path):
    server, display = started_screen("640x480")
    # A process that says when its first picture is there.
    code = (
        "import sys, runtime.viewer as v; step = v.Viewer.step\n"
        "def told(self, *a): step(self, *a); print('shown', flush=True)\n"
        "v.Viewer.step = told\n"
        "from prtnet.cli import run; sys.exit(run(sys.argv[1:]))"
    )
    words = ["view", *files, "--size", "200x150", "--out", str(tmp_path), "--quiet"]
    viewer = subprocess.Popen(
        [sys.executable, "-c", code, *words], text=True, env={**os.environ, "DISPLAY": display},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert viewer.stdout is not None
        assert viewer.stdout.readline() == "shown\n"
        server.terminate()
        server.wait()
        _, errors = viewer.communicate(timeout=START)
    finally:
        viewer.kill()
        server.kill()
    assert viewer.returncode == 2
    assert errors == (
        "prtnet: error: display: was closed under the window; start again on one that lasts\n"
    )
