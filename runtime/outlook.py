"""How anything is looked at: the camera, the light, what is shown on either side of a split."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from runtime.camera import Camera

__all__ = ["Outlook"]

TURN_STEP = math.radians(0.25)  # a drag's pixel
STEEPEST = math.radians(89.0)


@dataclass(kw_only=True)
class Outlook:
    """What every viewer changes; what is shown, and how it moves, is its subclasses'.

    Attributes:
        light: its name, as in ``prtnet render``.
        light_turn: about the vertical, degrees.
        left: what is shown left of the split.
        right: and right of it.
        split: where that is, a fraction of the width; 1 for the left side alone.
        azimuth: of the camera, radians.
        elevation: likewise.
        distance: of the camera, times the one that frames what is shown.
        pan: of the target, metres along the picture's axes.
        exposure: stops beside the one chosen under this light.
        playing: whether time goes on; the truth is traced when it does not.
    """

    light: str = "studio"
    light_turn: float = 0.0
    left: str = ""
    right: str = ""
    split: float = 1.0
    azimuth: float = math.radians(30.0)
    elevation: float = math.radians(12.0)
    distance: float = 1.0
    pan: tuple[float, float] = (0.0, 0.0)
    exposure: float = 0.0
    playing: bool = False

    @property
    def modes(self) -> tuple[str, ...]:
        """What is shown, on one side or both."""
        left, right = self.split > 0.0, self.split < 1.0
        return (*((self.left,) if left else ()), *((self.right,) if right else ()))

    def orbit(self, right: float, down: float) -> None:
        """Walk the camera around by so many pixels of a drag."""
        self.azimuth = (self.azimuth - TURN_STEP * right) % (2.0 * math.pi)
        self.elevation = min(max(self.elevation + TURN_STEP * down, -STEEPEST), STEEPEST)

    def zoom(self, steps: float) -> None:
        """Step towards what is shown."""
        self.distance = min(max(self.distance * 0.9**steps, 0.05), 20.0)

    def camera(self, base: Camera) -> Camera:
        """Where from: a camera that frames what is shown, walked around it."""
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
