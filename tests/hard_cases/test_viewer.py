"""The viewer and its windowless twin where there is no display, no OpenGL, or not for long."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
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
    assert "prtnet render" in done.stderr


@pytest.mark.gl
def test_opengl_that_is_too_old_is_one_line(files, display):
    done = prtnet("view", *files, DISPLAY=display, MESA_GL_VERSION_OVERRIDE="2.1")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot open a window with OpenGL" in done.stderr


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
    assert "use --renderer cpu" in done.stderr


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
