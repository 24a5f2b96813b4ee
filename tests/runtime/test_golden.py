"""Pictures that are looked at once and must then stay as they are, in ``tests/runtime/golden``.

Other drivers round and place samples otherwise, so these are compared on llvmpipe alone: the
software rasteriser that is the same everywhere. After a change that is meant to show, draw them
anew, look at them, and commit them:

    PRTNET_GOLDEN=write python -m pytest tests/runtime/test_golden.py

Where one differs, what was drawn and the difference lie in the test's temporary folder.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from data_gen.procedural import mannequin
from data_gen.truth import true_visibility
from prtnet.environment import environment
from runtime import screen
from runtime.cast import Cast
from runtime.gl import create_context
from runtime.looks import cut_visibility
from runtime.picture import save_png
from runtime.show import Show
from runtime.studio import Studio
from runtime.view import View
from tests.runtime.test_posed_surface import modelled

pytestmark = pytest.mark.gl

FOLDER = Path(__file__).parent / "golden"
SIZE = (200, 150)
RAYS = 128
# Versions of Mesa and instruction sets differ in the last bits, and so may a ray that grazes.
STEPS = 2  # of eight bits
SHARE = 0.997  # of the pixels, within STEPS; an eighth of them show the character
MEAN = 0.1  # steps

VIEWS: dict[str, dict[str, Any]] = {
    "matte": {},
    "gold": {"brdf": "gold", "light": "window", "light_turn": 40.0, "lobes": 0},
    "satin": {"brdf": "satin", "light": "sunset", "azimuth": -0.8, "distance": 0.5},
    "ambient": {"left": "ambient", "right": "open", "split": 0.5},
    "heat": {"left": "error"},
    "dark": {"exposure": -8.0},
}


@pytest.fixture(scope="module")
def show() -> Iterator[Show]:
    """The mannequin in a dance; the prediction is what two of four bands leave of the truth."""
    context = create_context()
    driver = context.info["GL_RENDERER"]
    if "llvmpipe" not in driver:
        context.release()
        pytest.skip(f"golden images are of llvmpipe, not of {driver}")
    actor = modelled(mannequin(), False)

    def trace(pose: np.ndarray) -> np.ndarray:
        return true_visibility(actor, pose, RAYS, 1)

    def predict(pose: np.ndarray) -> np.ndarray:
        return cut_visibility(trace(pose), 2)[None]

    def radiance(*_: object) -> np.ndarray:
        raise AssertionError("no picture here is of traced light")

    with context:
        found = Show(context, Cast(actor, predict, trace, radiance), Studio(environment))
        yield found
        found.release()
    context.release()


def drawn(show: Show, name: str) -> np.ndarray:
    """One of ``VIEWS``, (H, W, 3) uint8."""
    clip = show.actor.scene.clips[-1]
    view = View(clip.name, 0.5 * (clip.start + clip.end), left="visibility", distance=0.65)
    vars(view).update(VIEWS[name])
    show.settle(view)
    target = show.context.framebuffer([show.context.texture(SIZE, 4)])
    show.draw(view, SIZE, target)
    data = np.frombuffer(target.read(components=3, alignment=1), dtype=np.uint8)
    return np.ascontiguousarray(data.reshape(SIZE[1], SIZE[0], 3)[::-1])


def golden_of(name: str) -> np.ndarray:
    with Image.open(FOLDER / f"{name}.png") as picture:
        return np.asarray(picture).astype(int)


@pytest.mark.parametrize("name", VIEWS)
def test_the_picture_is_the_one_that_was_looked_at(show, name, tmp_path):
    picture, path = drawn(show, name), FOLDER / f"{name}.png"
    if os.environ.get("PRTNET_GOLDEN") == "write":
        FOLDER.mkdir(exist_ok=True)
        save_png(path, picture)
        pytest.skip(f"{path.name} is drawn anew; look at it")
    golden = golden_of(name)
    assert golden.shape == picture.shape
    difference = np.abs(picture - golden)
    alike = float((difference.max(axis=-1) <= STEPS).mean())
    if alike < SHARE or difference.mean() > MEAN:
        save_png(tmp_path / f"{name}.png", picture)
        save_png(tmp_path / f"{name}_difference.png", np.minimum(20 * difference, 255))
    assert alike >= SHARE, tmp_path
    assert difference.mean() <= MEAN, tmp_path


CURVE = "mix(12.92 * lit, curve, step(vec3(0.0031308), lit))"


@pytest.mark.parametrize(
    "other", ["1.055 * pow(lit, vec3(1.0 / 2.4)) - 0.055", "pow(lit, vec3(1.0 / 2.2))", "curve"]
)
def test_a_curve_without_its_straight_toe_would_be_seen(show, monkeypatch, other):
    """In the dark picture: there the character is within the toe, to 0.04 of white."""
    golden, there = golden_of("dark"), golden_of("matte") != golden_of("dark")
    toe = there & (golden > 0) & (golden <= 10)
    assert toe.mean() > 0.05
    assert np.abs(drawn(show, "dark") - golden)[toe].mean() <= 0.1
    assert CURVE in screen.FRAGMENT_SHADER
    changed = screen.FRAGMENT_SHADER.replace(CURVE, other)
    monkeypatch.setattr(screen, "FRAGMENT_SHADER", changed)
    monkeypatch.setattr(show, "screen", screen.Screen(show.context))
    assert np.abs(drawn(show, "dark") - golden)[toe].mean() > 0.5
    show.screen.release()


def test_a_slightly_other_light_would_be_seen(show):
    golden = drawn(show, "matte").astype(int)
    clip = show.actor.scene.clips[-1]
    view = View(
        clip.name, 0.5 * (clip.start + clip.end), left="visibility", distance=0.65, light_turn=4.0
    )
    target = show.context.framebuffer([show.context.texture(SIZE, 4)])
    show.draw(view, SIZE, target)
    data = np.frombuffer(target.read(components=3, alignment=1), dtype=np.uint8)
    other = data.reshape(SIZE[1], SIZE[0], 3)[::-1].astype(int)
    assert math.isfinite(show.exposures["studio"])
    assert (np.abs(other - golden).max(axis=-1) <= STEPS).mean() < SHARE
