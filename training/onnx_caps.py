"""Sums of caps' spherical harmonics as nodes: the twin of ``prtnet.surroundings.cap_sums``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from prtnet import sh
from prtnet.occluders import cap_integral_rows
from prtnet.surroundings import SOFTEST
from training.onnx_expression import Value

__all__ = ["cap_sum_nodes"]


def cap_sum_nodes(
    direction: Sequence[Value], sine2: Value, groups: Sequence[Any], order: int
) -> list[Value]:
    """Sums over the last axis, which stays: G · n² values (…, 1), group by group.

    Args:
        direction: x, y and z of unit directions to the occluders, (…, K).
        sine2: squared sine of the half-angle of each cap, (…, K).
        groups: how much each occluder belongs to each group, broadcast to (…, K).
        order: n, number of bands.
    """
    x, y, z = direction
    softness = sine2.sqrt().clip(SOFTEST)
    above = (z / softness * 0.5 + 0.5).clip(0.0, 1.0) * (2.0 * math.pi)
    cosine = (1.0 - sine2).sqrt()
    integrals: list[Any] = cap_integral_rows(cosine, order)  # type: ignore[arg-type]
    weighed = [[i * above * group for i in integrals] for group in groups]
    rows: list[Value] = sh.components(x, y, z, order)  # type: ignore[type-var]
    axis = 3  # of the occluders, in (P, C, R, K)
    return [
        (row * own[math.isqrt(index)]).total(axis)
        for own in weighed
        for index, row in enumerate(rows)
    ]
