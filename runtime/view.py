"""How a character is looked at: everything that an interactive view, or an option, changes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np

from prtnet.modelled_scene import ModelledScene, Moment
from runtime.camera import Camera
from runtime.outlook import Outlook

__all__ = ["MODES", "UNLIT", "Mode", "View", "framing", "later"]

Mode = Literal["prediction", "truth", "visibility", "open", "ambient", "error"]
MODES: tuple[Mode, ...] = get_args(Mode)
UNLIT = ("ambient", "error")  # shown at an exposure of their own, whatever the light
FRAMED = 9  # poses of a clip that must be in the picture


@dataclass
class View(Outlook):
    """What is looked at, and how.

    Attributes:
        clip: the animation.
        time: seconds into it.
        blend_clip: another animation on the way to which the pose is; empty for none.
        blend_time: seconds into that.
        blend: how far on the way, 0 to 1.
        copies: of the character, each at a moment of its own; only the first is traced.
        lobes: of the light, a colour; 0 for as many as hold it exactly, None for few if they do.
        order: bands of visibility and light that are shown; 0 for all that the model has.
        brdf: its name, as in ``prtnet render``.
        factors: of the BRDF.
        vertex: whose visibility is shown on a sphere, and whether of its back; None for none.
    """

    clip: str
    time: float = 0.0
    blend_clip: str = ""
    blend_time: float = 0.0
    blend: float = 0.0
    copies: int = 1
    lobes: int | None = 3
    order: int = 0
    brdf: str = "matte"
    factors: int = 8
    vertex: tuple[int, bool] | None = None
    left: str = field(default="prediction", kw_only=True)
    right: str = field(default="truth", kw_only=True)

    @property
    def moments(self) -> tuple[Any, ...]:
        """What the pose depends on: equal where it is the same."""
        alone = not self.blend_clip or self.blend == 0.0
        first = (self.clip, self.time)
        return first if alone else (*first, self.blend_clip, self.blend_time, self.blend)

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


def later(actor: ModelledScene, name: str, time: float, seconds: float) -> float:
    """A time in a clip, so many seconds on, around where it ends."""
    return actor.scene.clip(name).later(time, seconds)


def framing(actor: ModelledScene, clip: str, aspect: float = 1.0, **angles: float) -> Camera:
    """Sees the character all through a clip; angles are those of ``Camera.framing``."""
    found = actor.scene.clip(clip)
    poses = actor.poses(found.name, np.linspace(found.start, found.end, FRAMED))
    return Camera.framing(actor.scene.geometry(poses).positions, aspect, **angles)
