"""What receivers see, for a shader: the frame every kind of surroundings gives on the GPU.

A kind lays out what never changes as textures of indices and numbers, puts what changes with the
pose (a few texels an occluder) into another, and writes GLSL that sums the caps one receiver sees.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.glsl import filled, harmonics_glsl
from prtnet.surroundings import SOFTEST

__all__ = ["SeenTables", "cap_glsl", "fours", "slots_of_sums"]

CAP = """\
const highp int PRTNET_CAP_TEXELS = $TEXELS;  // of the $COUNT harmonics of what is seen

$HARMONICS
// Harmonics of the cap about a unit direction, as much of it as is above the horizon.
void prtnet_cap(highp vec3 toward, highp float sine2, out highp vec4 cap[PRTNET_CAP_TEXELS]) {
    highp float y[$COUNT];
    prtnet_harmonics(toward, y);
    highp float softness = max(sqrt(sine2), $SOFTEST);
    highp float cosine = sqrt(max(1.0 - sine2, 0.0));
    highp float covered = $TURN * sine2 * clamp(0.5 + 0.5 * toward.z / softness, 0.0, 1.0);
    highp float i0 = covered / (1.0 + cosine);  // integrals of P_l, without small differences
    highp float i1 = 0.5 * covered;
    highp float i2 = i1 * cosine;
    highp float i3 = 0.25 * i1 * (5.0 * cosine * cosine - 1.0);
$ROWS
}
"""


@dataclass(frozen=True, eq=False)
class SeenTables:
    """Surroundings laid out for a shader.

    Attributes:
        kind: of surroundings.
        slots: the feature in each of 4 · T slots that the GLSL fills, −1 for one that stays zero.
        indices: texels (N, 4) int64, of non-negative numbers.
        rest: texels (N, 4) float32 of receivers at rest; none if the pose says all of them.
        numbers: texels (N, 4) float32.
        posed_texels: how many there are of a pose.
        posed: from a flattened pose (D,) to its texels (N, 4) float32.
        glsl: ``prtnet_carried`` and ``prtnet_seen``; it counts texels of indices and numbers from
            PRTNET_INDICES and PRTNET_NUMBERS.
        layout: what ``posed`` has, in numbers, for ``gpu.json``.
    """

    kind: str
    slots: IntArray
    indices: IntArray
    rest: FloatArray
    numbers: FloatArray
    posed_texels: int
    posed: Callable[[FloatArray], FloatArray]
    glsl: str
    layout: dict[str, float]


def cap_glsl(order: int) -> str:
    """``prtnet_cap``: the order² harmonics of one cap, at most four bands."""
    count = order**2
    terms = [
        f"i{math.isqrt(i)} * y[{i}]" if i < count else "0.0" for i in range(-(-count // 4) * 4)
    ]
    rows = [
        f"    cap[{k}] = vec4({', '.join(terms[4 * k : 4 * k + 4])});"
        for k in range(len(terms) // 4)
    ]
    return filled(
        CAP,
        {
            "TEXELS": len(rows), "COUNT": count, "SOFTEST": SOFTEST, "TURN": f"{2 * math.pi:.9e}",
            "HARMONICS": harmonics_glsl(order, "prtnet_harmonics"), "ROWS": "\n".join(rows),
        },
    )  # fmt: skip


def slots_of_sums(first: int, groups: int, order: int) -> IntArray:
    """Slots of sums over caps, group by group, whose features begin at ``first``."""
    count = order**2
    slots = np.full((groups, -(-count // 4) * 4), -1, dtype=np.int64)
    slots[:, :count] = first + np.arange(groups * count).reshape(groups, count)
    return slots.ravel()


def fours(values: IntArray, filler: int) -> IntArray:
    """Rows (N, W) of indices as whole texels (N, ⌈W / 4⌉, 4), ``filler`` behind."""
    count, width = values.shape
    whole = np.full((count, -(-width // 4) * 4), filler, dtype=np.int64)
    whole[:, :width] = values
    return whole.reshape(count, -1, 4)
