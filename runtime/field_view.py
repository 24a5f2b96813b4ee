"""How a field is looked at: everything that an interactive view, or an option, changes."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from prtnet.canvas import Canvas
from runtime.outlook import Outlook
from runtime.worn import Worn, swung

__all__ = ["FIELD_MODES", "FieldView"]

FIELD_MODES = ("lobes", "one lobe", "harmonics", "truth")


@dataclass
class FieldView(Outlook):
    """What is looked at, and how.

    Attributes:
        clip: the animation of what the field is on; empty where there is none.
        time: seconds into it.
        twist: about the vertical, degrees from bottom to top; it goes to and fro.
        swing: seconds since it was as it is given.
        count: lobes that are fitted to transfer.
        by_table: whether lobes are looked up in a table of the light; otherwise evaluated.
    """

    clip: str = ""
    time: float = 0.0
    twist: float = 0.0
    swing: float = 0.0
    count: int = 4
    by_table: bool = True
    left: str = field(default="lobes", kw_only=True)
    right: str = field(default="harmonics", kw_only=True)

    @property
    def moments(self) -> tuple[Any, ...]:
        """What the canvas depends on: equal where it is the same."""
        return self.clip, self.time, swung(self.twist, self.swing)

    def canvas(self, worn: Worn) -> Canvas:
        """What the field is on, posed and twisted.

        Raises:
            PrtnetError: there is no such clip, or a time is outside it.
        """
        clip = worn.clip(self.clip)
        return worn.at(clip, self.time, math.radians(swung(self.twist, self.swing)))
