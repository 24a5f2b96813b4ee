"""How a character is looked at: everything that an interactive view, or an option, changes."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from prtnet.modelled_scene import ModelledScene, Moment
from runtime.camera import Camera

__all__ = ["MODES", "UNLIT", "Mode", "View", "framing", "later"]

Mode = Literal["prediction", "truth", "visibility", "open", "ambient", "error"]
MODES: tuple[Mode, ...] = get_args(Mode)
UNLIT = ("ambient", "error")  # shown at an exposure of their own, whatever the light
FRAMED = 9  # poses of a clip that must be in the picture
TURN_STEP = math.radians(0.25)  # a drag's pixel
STEEPEST = math.radians(89.0)


@dataclass
class View:
    """What is looked at, and how.

    Attributes:
        clip: the animation.
        time: seconds into it.
        blend_clip: another animation on the way to which the pose is; empty for none.
        blend_time: seconds into that.
        blend: how far on the way, 0 to 1.
        copies: of the character, each at a moment of its own; only the first is traced.
        light: its name, as in ``prtnet render``.
        light_turn: about the vertical, degrees.
        lobes: of the light, a colour; 0 for as many as hold it exactly, None for few if they do.
        order: bands of visibility and light that are shown; 0 for all that the model has.
        brdf: its name, as in ``prtnet render``.
        factors: of the BRDF.
        left: what is shown left of the split.
        right: and right of it.
        split: where that is, a fraction of the width; 1 for the left side alone.
        azimuth: of the camera, radians.
        elevation: likewise.
        distance: of the camera, times the one that frames the character.
        pan: of the target, metres along the picture's axes.
        vertex: whose visibility is shown on a sphere, and whether of its back; None for none.
        exposure: stops beside the one chosen under this light.
        playing: whether time goes on; the truth is traced when it does not.
    """

    clip: str
    time: float = 0.0
    blend_clip: str = ""
    blend_time: float = 0.0
    blend: float = 0.0
    copies: int = 1
    light: str = "studio"
    light_turn: float = 0.0
    lobes: int | None = 3
    order: int = 0
    brdf: str = "matte"
    factors: int = 8
    left: Mode = "prediction"
    right: Mode = "truth"
    split: float = 1.0
    azimuth: float = math.radians(30.0)
    elevation: float = math.radians(12.0)
    distance: float = 1.0
    pan: tuple[float, float] = (0.0, 0.0)
    vertex: tuple[int, bool] | None = None
    exposure: float = 0.0
    playing: bool = False

    @property
    def moments(self) -> tuple[Any, ...]:
        """What the pose depends on: equal where it is the same."""
        alone = not self.blend_clip or self.blend == 0.0
        first = (self.clip, self.time)
        return first if alone else (*first, self.blend_clip, self.blend_time, self.blend)

    @property
    def modes(self) -> tuple[Mode, ...]:
        """What is shown, on one side or both."""
        left, right = self.split > 0.0, self.split < 1.0
        return (*((self.left,) if left else ()), *((self.right,) if right else ()))

    def pose(self, actor: ModelledScene) -> Any:
        """The flattened pose (1, D).

        Raises:
            PrtnetError: there is no such clip, or a time is outside it.
        """
        if len(self.moments) == 2:
            return actor.poses(self.clip, np.array([self.time]))
        ends = Moment(self.clip, self.time), Moment(self.blend_clip, self.blend_time)
        return actor.blended(*ends, self.blend)

    def advance(self, actor: ModelledScene, seconds: float) -> None:
        """Go on in both clips, and around."""
        self.time = later(actor, self.clip, self.time, seconds)
        self.advance_blend(actor, seconds)

    def advance_blend(self, actor: ModelledScene, seconds: float) -> None:
        """Go on in the clip that is blended with, and around."""
        if self.blend_clip:
            self.blend_time = later(actor, self.blend_clip, self.blend_time, seconds)

    def orbit(self, right: float, down: float) -> None:
        """Walk the camera around the character by so many pixels of a drag."""
        self.azimuth = (self.azimuth - TURN_STEP * right) % (2.0 * math.pi)
        self.elevation = min(max(self.elevation + TURN_STEP * down, -STEEPEST), STEEPEST)

    def zoom(self, steps: float) -> None:
        """Step towards the character."""
        self.distance = min(max(self.distance * 0.9**steps, 0.05), 20.0)

    def camera(self, base: Camera) -> Camera:
        """Where from: a camera that frames the character, walked around it."""
        target, eye = np.asarray(base.target), np.asarray(base.eye)
        reach = float(np.linalg.norm(eye - target))
        flat = math.cos(self.elevation)
        towards = np.array(
            [math.sin(self.azimuth) * flat, math.sin(self.elevation), math.cos(self.azimuth) * flat]
        )
        right = np.array([math.cos(self.azimuth), 0.0, -math.sin(self.azimuth)])
        target = target + self.pan[0] * right + self.pan[1] * np.cross(towards, right)
        eye = target + reach * self.distance * towards
        return dataclasses.replace(
            base,
            eye=tuple(eye.tolist()),
            target=tuple(target.tolist()),
            near=0.02 * reach * self.distance,
            far=reach * self.distance + base.far,
        )


def later(actor: ModelledScene, name: str, time: float, seconds: float) -> float:
    """A time in a clip, so many seconds on, around where it ends."""
    clip = actor.scene.clip(name)
    length = clip.end - clip.start
    return clip.start + (time - clip.start + seconds) % length if length > 0 else time


def framing(actor: ModelledScene, clip: str, aspect: float = 1.0, **angles: float) -> Camera:
    """Sees the character all through a clip; angles are those of ``Camera.framing``."""
    found = actor.scene.clip(clip)
    poses = actor.poses(found.name, np.linspace(found.start, found.end, FRAMED))
    return Camera.framing(actor.scene.geometry(poses).positions, aspect, **angles)
