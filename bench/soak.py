"""Long runs of the viewer and the ONNX loop: is memory flat, every pixel finite, no frame late.

    python bench/soak.py [FRAMES] [--write]

Every frame has another pose and camera; now and then light, material, mode, crowd, size of the
window or the whole character change, as the rates below say. Small windows on a virtual screen,
small characters: what leaks or stalls does so whatever the size. All frames are run twice, with the
same random numbers. A frame is *late* if it took more than five times the median of its character
(one beside a prior costs four times another); it is *ours* if it is late both times while the
process computed for as long; else others had the machine, or work beside the frames fell
elsewhere.
"""

from __future__ import annotations

import dataclasses
import functools
import gc
import itertools
import math
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from bench.tables import ROOT, publish
from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from data_gen.readers import read_scene
from prtnet.arrays import BoolArray, FloatArray
from prtnet.cli_options import ViewOptions
from prtnet.cli_view import opened_viewer
from prtnet.frames import rest_tangents
from prtnet.materials import BRDFS
from prtnet.materials import PRESETS as MATERIALS
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.presets import PRESETS as LIGHTS
from runtime.memory import hand_back, own_bytes, resident_bytes
from runtime.onnx_model import OnnxModel
from runtime.view import MODES
from tests.models import random_model
from tests.priors import beside_prior, random_prior
from tests.virtual_screen import started_screen
from training.onnx_export import build_onnx

PAGE = ROOT / "docs" / "reliability.md"
FRAMES = 100_000
LATE = 5.0  # medians
WARM_UP = 0.1  # of the frames: everything has been shown once
SAMPLES = 100  # of the memory
OPENS = 100  # frames from asking for a character until it begins to be shown, in both runs alike
SELDOM = 25  # frames between two at least: garbage is collected, which takes its time
SIZE = (96, 72)
KINDS = ("neural", "prior", "lobes")
RATES = {
    "light": 0.02, "material": 0.02, "mode": 0.05, "split": 0.05, "crowd": 0.02, "blend": 0.05,
    "vertex": 0.02, "bands": 0.02, "help": 0.01, "resize": 0.01, "another character": 0.002,
}  # fmt: skip
"""How often each is changed, a frame."""


@dataclass
class Soak:
    """What two equal runs saw."""

    frames: int  # of each
    seconds: float = 0.0
    memory: list[int] = field(default_factory=list)  # bytes, at rest, after the warm-up
    most: list[int] = field(default_factory=lambda: [0, 0])  # bytes, in either run
    bad: int = 0  # frames with a pixel or number that is not finite

    def __post_init__(self) -> None:
        """Room for everything that is noted, so that it does not count as growth."""
        self.wall = np.full((2, self.frames), np.nan)  # seconds
        self.busy = np.full((2, self.frames), np.nan)  # of this process, all threads
        self.did = [""] * self.frames  # what a frame changed
        self.shown = np.zeros(self.frames, int)  # which character

    def late(self) -> tuple[Counter[str], int]:
        """Frames that are ours by what they changed, and how many times others held one up."""
        late, busy = self.above_median(self.wall), self.above_median(self.busy)
        ours = (late & busy).all(0)
        return Counter(self.did[k] for k in np.flatnonzero(ours)), int((late & ~ours).sum())

    def above_median(self, seconds: FloatArray) -> BoolArray:
        """Which are more than so many medians of the character's, in each run."""
        found = np.zeros(seconds.shape, bool)
        for character in np.unique(self.shown):
            own = self.shown == character
            median = np.median(seconds[:, own], axis=1, keepdims=True)
            found[:, own] = seconds[:, own] > LATE * median
        return found

    def spread(self) -> float:
        """Of the memory after the warm-up, a fraction of where it was then."""
        return (max(self.memory) - min(self.memory)) / self.memory[0]

    def strayed(self) -> float:
        """How far memory came from where it was after the warm-up, up or down; likewise."""
        return max(abs(one - self.memory[0]) for one in self.memory) / self.memory[0]

    def row(self, name: str) -> list[object]:
        """Of the table."""
        ours, held_up = self.late()
        still = ours.pop("", 0)
        most = ours.most_common(4)
        others = ours.total() - sum(count for _, count in most)
        names = ", ".join(f"{what} {count}" for what, count in (*most, ("others", others)) if count)
        counts = (self.memory[0], self.memory[-1], *self.most)
        megabytes = [f"{count / 1e6:.1f}" for count in counts]
        return [
            name, f"2 × {self.frames:,}", f"{self.seconds / 3600:.2f}", *megabytes[:2],
            f"{100 * self.spread():.2f} %", *megabytes[2:], self.bad, still, names or "none",
            held_up,
        ]  # fmt: skip


COLUMNS = ["", "frames", "hours", "MB after warm-up", "at the end", "spread",
           "most in the first run", "in the second", "not finite",
           "late, ours", "late, ours, that changed", "late, not in both runs"]  # fmt: skip


class Loop(Protocol):
    """What is run."""

    shown: int  # which character

    def prepare(self) -> None:
        """What an engine does between two frames."""
        ...

    def __call__(self) -> tuple[str, bool]:
        """A frame: what it changed, and whether everything that it made is finite."""
        ...

    def rest(self) -> None:
        """Show what was shown first."""
        ...

    def again(self) -> None:
        """Begin anew."""
        ...


def soaked(frames: int, loop: Loop) -> Soak:
    """So many frames, twice.

    Now and then memory is read, at rest, without what the C library hoards.
    """
    found, began = Soak(frames), time.perf_counter()
    every = max(SELDOM, frames // SAMPLES)
    for run, number in itertools.product(range(2), range(frames)):
        if number == 0:
            loop.again()
        loop.prepare()
        wall, busy = time.perf_counter(), time.process_time()
        changed, sound = loop()
        found.wall[run, number] = time.perf_counter() - wall
        found.busy[run, number] = time.process_time() - busy
        found.did[number] = found.did[number] or sys.intern(changed)
        assert run == 0 or found.shown[number] == loop.shown, "the runs are not equal"
        found.shown[number] = loop.shown
        found.bad += not sound
        found.most[run] = max(found.most[run], resident())
        if number % every == 0:
            loop.rest()
            gc.collect()
            hand_back()
            found.memory += [resident()] * bool(run or number >= WARM_UP * frames)
            told = f"{run * frames + number} of {2 * frames} frames, {resident() / 1e6:.0f} MB"
            print(f"\r{told}", end="", flush=True)
    print("\r", end="")
    found.seconds = time.perf_counter() - began
    return found


def resident() -> int:
    """Bytes of this process in memory; files' pages count as many as there were at first."""
    found = own_bytes()
    assert found is not None, "needs /proc"
    return found + pages_of_files()


@functools.cache
def pages_of_files() -> int:
    """Bytes of these now. Later the system takes them back when it likes."""
    found, own = resident_bytes(), own_bytes()
    assert found is not None
    assert own is not None
    return found - own


def characters(folder: Path) -> list[tuple[Path, Path]]:
    """Models of several kinds on two scenes; what they say is random, as fits take long."""
    found = []
    for segments in (5, 7):
        scene = arm(segments=segments)
        write_glb(scene, folder / f"{segments}.glb")
        for kind, two_sided in itertools.product(KINDS, (False, True)):
            receivers = scene.receivers(two_sided)
            model = random_model(
                "neural" if kind == "neural" else "linear", joints=scene.joint_count,
                receivers=len(receivers), lobes=2 * (kind == "lobes"),
            )  # fmt: skip
            if kind == "prior":
                prior = random_prior("maps", scene.joint_count, len(receivers), model.order)
                model = beside_prior(model, prior)
            model.rest_tangents[:] = rest_tangents(scene, receivers)
            model.metadata.update(mesh_sha256=scene.mesh_sha256, two_sided=two_sided)
            found.append((folder / f"{kind}{segments}{two_sided}.safetensors",
                          folder / f"{segments}.glb"))  # fmt: skip
            model.save(found[-1][0])
    return found


class OnnxLoop:
    """The loop of an engine: a pose in, visibility out; between some frames another model comes.

    Args:
        files: models and their scenes.
        rates: of changes, where others are wanted than ``RATES``.
    """

    def __init__(
        self, files: list[tuple[Path, Path]], rates: Mapping[str, float] = MappingProxyType({})
    ) -> None:
        self.files, self.rates = files, {**RATES, **rates}
        self.again()

    def take(self, files: tuple[Path, Path] | None = None) -> None:
        """Another model."""
        model, scene = files = files or self.rng.choice(self.files)
        self.shown = self.files.index(files)
        self.actor = ModelledScene(VisibilityModel.load(model), read_scene(scene))
        self.onnx = OnnxModel(build_onnx(self.actor.model).SerializeToString(), threads=1)

    def prepare(self) -> None:
        """Another model, if it is time."""
        self.changed = self.rng.random() < self.rates["another character"]
        if self.changed:
            self.take()

    def __call__(self) -> tuple[str, bool]:
        clip = self.rng.choice(self.actor.scene.clips)
        pose = self.actor.poses(clip.name, np.array([self.rng.uniform(clip.start, clip.end)]))
        return "another character" * self.changed, bool(np.isfinite(self.onnx(pose)).all())

    def rest(self) -> None:
        self.take(self.files[0])

    def again(self) -> None:
        self.rng = random.Random(0)
        self.take()


class ViewerLoop:
    """A window in the hands of somebody impatient.

    Args:
        viewer: a ``runtime.viewer.Viewer``.
        files: as for ``OnnxLoop``.
        rates: likewise.
    """

    def __init__(
        self,
        viewer: Any,
        files: list[tuple[Path, Path]],
        rates: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.viewer, self.files, self.rates = viewer, files, {**RATES, **rates}
        self.first = dataclasses.replace(viewer.view)
        self.shown, self.asked, self.due = 0, 0, -1

    def prepare(self) -> None:
        """Nothing but to wait for what both runs are to have in the next frame."""
        while self.due == 1 and self.viewer.opening.busy:
            time.sleep(1e-3)

    def __call__(self) -> tuple[str, bool]:
        viewer, rng = self.viewer, self.rng
        changed = [name for name, rate in self.rates.items() if rng.random() < rate]
        for name in changed:
            getattr(self, name.replace(" ", "_"))()
        self.due -= 1
        if self.due == 0:
            self.begin_to_show()
        if viewer.finish is not None:
            changed.append("another character is shown")
        view, show = viewer.view, viewer.show
        clip = viewer.show.actor.scene.clip(view.clip)
        view.playing, view.time = False, rng.uniform(clip.start, clip.end)
        view.azimuth, view.elevation = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(-1.5, 1.5)
        view.distance, view.light_turn = rng.uniform(0.1, 3.0), rng.uniform(0.0, 360.0)
        made = viewer.show.waiting or viewer.opening.busy
        viewer.step(1.0 / 60.0)
        if viewer.show is not show:
            self.shown = self.asked
        assert viewer.message == "" or " on " in viewer.message, viewer.message
        if not changed and (made or viewer.show.waiting or viewer.opening.busy):
            changed = ["what is made in the background"]
        return " and ".join(changed), bool(np.isfinite(viewer.show.screen.linear()).all())

    def rest(self) -> None:
        """The first character as it was first shown, in a window of the first size."""
        viewer = self.viewer
        vars(viewer.view).update(vars(self.first))  # of the other ones nothing is begun any more
        if self.due > 0:
            self.begin_to_show()
        self.drop(self.files[0])
        self.begin_to_show()
        viewer.opened()
        self.shown = 0
        viewer.view.order = self.first.order
        viewer.helping = False
        self.resize(SIZE)
        viewer.step(0.0)
        viewer.show.settle(viewer.view)
        while viewer.show.waiting or any(task.busy for task in viewer.leaving):
            time.sleep(1e-3)

    def again(self) -> None:
        self.rng = random.Random(0)
        self.rest()

    def drop(self, files: tuple[Path, Path]) -> None:
        """Open another character. It is shown when both runs can have it."""
        self.asked, self.due = self.files.index(files), OPENS
        self.viewer.dropped(0, 0, list(map(str, files)))
        self.finish, self.viewer.finish = self.viewer.finish, None

    def begin_to_show(self) -> None:
        """Let the next frames show it, in nothing that it has not."""
        if self.viewer.view.brdf.startswith("lobe"):
            self.viewer.change("brdf", "matte")
        self.due, self.viewer.finish = -1, self.finish

    def light(self) -> None:
        self.viewer.change("light", self.rng.choice(list(LIGHTS)))

    def material(self) -> None:
        lobes = bool(self.viewer.show.actor.model.lobes) and self.viewer.finish is None
        through = ",transmitted=0.2" * self.viewer.show.actor.model.metadata["two_sided"]
        known = [f"lobe:exponent=20{through}"] if lobes else []
        self.viewer.change("brdf", self.rng.choice([*MATERIALS, *BRDFS, *known]))

    def mode(self) -> None:
        self.viewer.view.left, self.viewer.view.right = self.rng.choices(MODES, k=2)

    def split(self) -> None:
        self.viewer.view.split = self.rng.choice([1.0, self.rng.random()])

    def crowd(self) -> None:
        self.viewer.view.copies = self.rng.randint(1, 3)

    def blend(self) -> None:
        clip = self.rng.choice(self.viewer.show.actor.scene.clips)
        self.viewer.view.blend_clip, self.viewer.view.blend_time = clip.name, clip.start
        self.viewer.view.blend = self.rng.choice([0.0, self.rng.random()])

    def vertex(self) -> None:
        count = len(self.viewer.show.actor.scene.rest().positions[0])
        vertex = self.rng.choice([None, self.rng.randrange(count)])
        self.viewer.following = False
        self.viewer.view.vertex = None if vertex is None else (vertex, False)

    def bands(self) -> None:
        self.viewer.view.order = self.rng.randrange(self.viewer.show.actor.model.order)

    def help(self) -> None:
        self.viewer.helping = not self.viewer.helping

    def resize(self, size: tuple[int, int] | None = None) -> None:
        size = size or (self.rng.randint(1, 160), self.rng.randint(1, 120))
        self.viewer.window._window.set_size(*size)
        self.viewer.window._window.dispatch_events()

    def another_character(self) -> None:
        files = self.rng.choice(self.files)
        if self.due < 0 and self.viewer.finish is None:
            self.drop(files)


@contextmanager
def window(files: list[tuple[Path, Path]], folder: Path) -> Iterator[Any]:
    """The viewer of the first character, small."""
    options = ViewOptions(*files[0], size=SIZE, out=folder, rays=8)
    viewer = opened_viewer(options, 1, lambda _: None)
    try:
        yield viewer
    finally:
        viewer.close()


def main() -> None:
    given = [int(word) for word in sys.argv[1:] if word.isdigit()]
    frames = given[0] if given else FRAMES
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = characters(folder)
        soaks = {"ONNX loop": soaked(frames, OnnxLoop(files))}
        print(*soaks["ONNX loop"].row("ONNX loop"))
        server, os.environ["DISPLAY"] = started_screen("640x480")
        try:
            with window(files, folder) as viewer:
                soaks["viewer"] = soaked(frames, ViewerLoop(viewer, files))
        finally:
            server.terminate()
    for name, found in soaks.items():
        print(f"{name}, MB at rest:", *(round(count / 1e6) for count in found.memory))
        print(f"furthest from the first: {100 * found.strayed():.2f} %")
    rows = [found.row(name) for name, found in soaks.items()]
    publish("soak", COLUMNS, rows, page=PAGE)
    wrong = any(
        s.bad or s.strayed() > 0.02 or s.most[1] > 1.02 * s.most[0] or s.late()[0]
        for s in soaks.values()
    )
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
