"""GLSL that makes lobes, and visibility, of the numbers that a model of kind ``lobes`` predicts.

What ``prtnet.lobe_numbers`` does. A shader that wants visibility in another frame, around the
mirrored view say, turns the axes: ``prtnet_lobes`` gives them.
"""

from __future__ import annotations

from prtnet.glsl import filled, harmonics_glsl
from prtnet.lobe_numbers import TILT, LobeNumbers

__all__ = ["lobes_glsl"]

GLSL = """
const highp int PRTNET_ORDER = $ORDER;
const highp int PRTNET_LOBES = $COUNT;  // of a receiver
const highp float PRTNET_UNIT[PRTNET_ORDER] = float[PRTNET_ORDER]($UNITS);

$HARMONICS
// Of lobe k: its axis in the receiver's local frame, and g*_l of band l at k * PRTNET_ORDER + l.
void prtnet_lobes(highp int receiver, out highp vec3 axis[PRTNET_LOBES],
                  out highp float g[PRTNET_LOBES * PRTNET_ORDER]) {
    highp vec4 row[PRTNET_ROW];
    prtnet_numbers(receiver, row);
    highp float number[4 * PRTNET_ROW];
    for (highp int k = 0; k < PRTNET_ROW; ++k) {
        number[4 * k] = row[k].x;
        number[4 * k + 1] = row[k].y;
        number[4 * k + 2] = row[k].z;
        number[4 * k + 3] = row[k].w;
    }
    for (highp int k = 0; k < PRTNET_LOBES; ++k) {
        highp vec3 a = vec3(number[1 + 3 * k], number[2 + 3 * k], number[3 + 3 * k] + $TILT);
        axis[k] = a / max(length(a), $TILT);
        g[k * PRTNET_ORDER] = k == 0 ? number[0] / PRTNET_UNIT[0] : 0.0;
        highp int first = 3 * PRTNET_LOBES + k * (PRTNET_ORDER - 1);
        for (highp int l = 1; l < PRTNET_ORDER; ++l)
            g[k * PRTNET_ORDER + l] = number[first + l] / PRTNET_UNIT[l];
    }
}

// Coefficient i is v[i / 4][i % 4], in the receiver's local frame.
void prtnet_visibility(highp int receiver, out highp vec4 v[PRTNET_TEXELS]) {
    highp vec3 axis[PRTNET_LOBES];
    highp float g[PRTNET_LOBES * PRTNET_ORDER];
    prtnet_lobes(receiver, axis, g);
    for (highp int k = 0; k < PRTNET_TEXELS; ++k) v[k] = vec4(0.0);
    for (highp int k = 0; k < PRTNET_LOBES; ++k) {
        highp float y[PRTNET_ORDER * PRTNET_ORDER];
        prtnet_harmonics(axis[k], y);
        for (highp int l = 0; l < PRTNET_ORDER; ++l)
            for (highp int i = l * l; i < (l + 1) * (l + 1); ++i)
                v[i / 4][i % 4] += g[k * PRTNET_ORDER + l] * y[i];
    }
}
"""


def lobes_glsl(numbers: LobeNumbers) -> str:
    """``prtnet_lobes`` and ``prtnet_visibility``, behind a ``prtnet_numbers``."""
    words = {
        "ORDER": numbers.order,
        "COUNT": numbers.count,
        "UNITS": ", ".join(f"{float(unit):.9e}" for unit in numbers.unit),
        "HARMONICS": harmonics_glsl(numbers.order, "prtnet_harmonics"),
        "TILT": f"{TILT:e}",
    }
    return filled(GLSL, words)
