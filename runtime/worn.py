"""What a field is shown on, and how it moves: a clip of its scene, and a twist to and fro."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prtnet.animation import Clip
from prtnet.arrays import FloatArray, IntArray
from prtnet.canvas import Canvas
from prtnet.errors import PrtnetError
from prtnet.scene import Scene

__all__ = ["PERIOD", "Worn", "swung"]

PERIOD = 4.0  # seconds of a twist to and fro
FRAMED = 9  # poses of a clip that must be in the picture


@dataclass(frozen=True, eq=False)
class Worn:
    """A canvas that may move.

    Attributes:
        name: of the file, or of what is built in.
        rest: where its frames are known.
        scene: that moves it; None for what stands still.
        source: which of the scene's vertices those of the canvas are, (V,).
    """

    name: str
    rest: Canvas
    scene: Scene | None = None
    source: IntArray | None = None

    def clip(self, name: str | None) -> Clip | None:
        """The clip of a name, or the first; None where nothing moves.

        Raises:
            PrtnetError: there is none of that name.
        """
        if self.scene is None:
            return None
        return self.scene.clip(name) if name else self.scene.clips[0]

    def at(self, clip: Clip | None, time: float, twist: float = 0.0) -> Canvas:
        """Where it is.

        Args:
            clip: of these; None for at rest.
            time: seconds into it.
            twist: about the vertical, from bottom to top, radians.

        Raises:
            PrtnetError: the time is outside the clip.
        """
        canvas = self.rest
        if clip is not None and self.scene is not None:
            if not clip.start - 1e-6 <= time <= clip.end + 1e-6:
                told = f"clip '{clip.name}' runs from {clip.start:g} to {clip.end:g} s"
                raise PrtnetError(self.name, f"{told}; give a time inside it")
            posed = self.scene.geometry(self.scene.poses(clip, np.array([time])))
            canvas = canvas.moved(posed.positions[0, self.source], posed.normals[0, self.source])
        return canvas.twisted(twist) if twist else canvas

    def times(self, clip: Clip | None, twisted: bool, fps: float) -> list[float]:
        """Of a movie of all that moves: the clip, or else a twist to and fro.

        Raises:
            PrtnetError: nothing moves.
        """
        if clip is not None:
            return [float(time) for time in clip.times(fps)]
        if not twisted:
            raise PrtnetError(self.name, "does not move; twist it, show it on a scene, or spin it")
        return [k / fps for k in range(round(PERIOD * fps))]

    def extent(self, clip: Clip | None, twist: float) -> FloatArray:
        """Places (P, V, 3) that it comes to, of a clip and a twist to and fro."""
        poses = [0.0] if clip is None else np.linspace(clip.start, clip.end, FRAMED).tolist()
        twists = [0.0] if not twist else [twist, 0.5 * twist, 0.0, -0.5 * twist, -twist]
        if len(poses) > 1 and twist:
            twists = [twist, -twist]
        return np.stack([self.at(clip, time, t).positions for time in poses for t in twists])


def swung(twist: float, seconds: float) -> float:
    """A twist that goes to and fro: as it is given at the start."""
    return twist * math.cos(2.0 * math.pi * seconds / PERIOD)
