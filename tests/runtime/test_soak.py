"""A short soak: the same frames again leave nothing more behind, on the GPU or in Python."""

from __future__ import annotations

import gc
from collections import Counter
from typing import Any

import moderngl
import numpy as np
import pytest

from bench.soak import OnnxLoop, Soak, ViewerLoop, characters, soaked
from prtnet.cli_options import ViewOptions
from prtnet.cli_view import opened_viewer
from tests.runtime.test_release import MAKERS
from tests.runtime.windows import SIZE, sized

FRAMES = 100
OFTEN = {"another character": 0.04, "resize": 0.1}  # so few frames would not meet them


class Alive:
    """How many things of OpenGL there are; it holds none of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        for name in MAKERS:
            monkeypatch.setattr(moderngl.Context, name, self.more(getattr(moderngl.Context, name)))
        for kind in (moderngl.Buffer, moderngl.Texture, moderngl.Program, moderngl.VertexArray,
                     moderngl.Framebuffer, moderngl.Renderbuffer):  # fmt: skip
            monkeypatch.setattr(kind, "release", self.fewer(kind.release))

    def more(self, real: Any) -> Any:
        def make(*given: Any, **named: Any) -> Any:
            self.count += 1
            return real(*given, **named)

        return make

    def fewer(self, real: Any) -> Any:
        def release(held: Any) -> None:
            self.count -= not isinstance(held.mglo, moderngl.InvalidObject)
            real(held)

        return release


def objects() -> Counter[str]:
    """What Python holds, by type."""
    gc.collect()
    return Counter(type(held).__qualname__ for held in gc.get_objects())


def grown(before: Counter[str], after: Counter[str]) -> dict[str, int]:
    """Types of which there are more, by a number that only something kept every frame reaches."""
    return {name: count - before[name] for name, count in after.items()
            if count - before[name] >= FRAMES // 10}  # fmt: skip


@pytest.mark.gl
@pytest.mark.filterwarnings("ignore:Importing PyGLM:PendingDeprecationWarning")
def test_a_viewer_keeps_nothing(window, tmp_path, monkeypatch):
    sized(window)
    monkeypatch.setattr("runtime.base_viewer.open_window", lambda *_: window)
    files, alive = characters(tmp_path), Alive(monkeypatch)
    options = ViewOptions(*files[0], size=SIZE, out=tmp_path, rays=8, threads=1)
    viewer = opened_viewer(options, 1, lambda _: None)
    held = []
    for _ in range(3):
        loop = ViewerLoop(viewer, files, rates=OFTEN)
        found = soaked(FRAMES, loop)
        assert found.bad == 0
        assert {name for did in found.did for name in did.split(" and ")} >= {*OFTEN, "mode"}
        loop.rest()
        held.append((alive.count, objects()))
    assert held[1][0] == held[2][0]
    assert grown(held[1][1], held[2][1]) == {}
    viewer.release()


def test_the_loop_of_an_engine_keeps_nothing(tmp_path):
    files = characters(tmp_path)
    held = []
    for _ in range(3):
        assert soaked(FRAMES, OnnxLoop(files, rates=OFTEN)).bad == 0
        held.append(objects())
    assert grown(held[1], held[2]) == {}


def test_late_frames_are_ours_if_the_process_was_busy():
    found = Soak(10)
    found.wall[:], found.busy[:] = 1.0, 0.9
    found.wall[:, [2, 5, 7]], found.busy[:, [2, 7]] = 6.0, 5.5
    found.did[7] = "light"
    assert found.late() == (Counter({"": 1, "light": 1}), 2)
    found.wall[1, 2] = 1.0
    assert found.late() == (Counter({"light": 1}), 3)
    found.memory = [100, 102, 99]
    assert found.spread() == pytest.approx(0.03)
    assert found.strayed() == pytest.approx(0.02)
    found.memory.append(96)
    assert found.strayed() == pytest.approx(0.04)


def test_frames_are_late_beside_others_of_their_character():
    found = Soak(12)
    found.wall[:], found.busy[:] = 1.0, 1.0
    found.shown[6:] = 1
    found.wall[:, 6:] = found.busy[:, 6:] = 7.0
    assert found.late() == (Counter(), 0)
    found.wall[:, 8] = found.busy[:, 8] = 36.0
    assert found.late() == (Counter({"": 1}), 0)


def test_frames_that_are_not_finite_are_counted():
    class Three:
        shown = 2
        results = iter(2 * [("", True), ("light", False), ("", True)])
        runs = 0

        def prepare(self):
            pass

        def __call__(self):
            return next(self.results)

        def rest(self):
            pass

        def again(self):
            self.runs += 1

    loop = Three()
    found = soaked(3, loop)
    assert (found.bad, found.did, loop.runs) == (2, ["", "light", ""], 2)
    assert found.shown.tolist() == [2, 2, 2]
    assert np.isfinite(found.wall).all()
