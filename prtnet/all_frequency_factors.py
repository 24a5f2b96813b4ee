"""Light and view factors of a BRDF for transfer of all frequencies: a row of transfer for each.

"All-Frequency" (Liu, Sloan, Shum and Snyder 2004) eq. 3 and section 3: f · cos ≈ G(v) · F(s), the
table clamped at 3 and taken apart by ``prtnet.factors``. Beyond the paper a view counts as much as
it covers of a picture: the plain decomposition spends rows on peaks at grazing angles that few
pixels show. A diffuse BRDF is one row, exactly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, Lambert
from prtnet.factors import coverage, factorise, tabulate
from prtnet.hemisphere import places

__all__ = ["RowFactors", "row_factors"]

CELLS = 32  # of both tables, a side
SAMPLES = 2  # of a cell, a side: four change the errors by a hundredth of themselves
MOST = 3.0  # of f · cos


@dataclass(frozen=True, eq=False)
class RowFactors:
    """A BRDF as m products.

    Attributes:
        light: F over the cells of ``prtnet.hemisphere``'s concentric map, cosine included,
            (m, S) float32; None of a diffuse BRDF, whose F is the cosine.
        view: G over the cells of the same map, linear RGB, (m, S, 3) float32; (1, 1, 3) of a
            diffuse BRDF.
        error: of the clamped table, the share of its squares that m products leave, views weighed
            by what they cover of a picture.
        clamped: the share of the table's squares that clamping takes, so weighed.
    """

    light: FloatArray | None
    view: FloatArray
    error: float = 0.0
    clamped: float = 0.0

    @property
    def rows(self) -> int:
        """Rows m."""
        return len(self.view)

    def facts(self) -> dict[str, float]:
        """What there is to say about it, as JSON can hold it."""
        return {"rows": self.rows, "factor_error": self.error, "clamped": self.clamped}

    def at(self, directions: FloatArray) -> FloatArray:
        """F at unit directions (K, 3) in local frames, (K, m) float32; zero below the horizon.

        Bilinear between the middles of cells, and beyond the outermost as there.
        """
        up = directions[:, 2]
        if self.light is None:
            return np.maximum(up, 0.0)[:, None].astype(np.float32)
        size = round(self.light.shape[1] ** 0.5)
        above = np.flatnonzero(up > 0.0)
        at = (places(directions[above], "concentric") + 1.0) * (size / 2.0) - 0.5
        at = np.clip(at, 0.0, size - 1.0)
        low = np.minimum(at.astype(np.int64), size - 2)
        share = at - low
        found = np.zeros((len(directions), self.rows), dtype=np.float32)
        for row, column in np.ndindex(2, 2):
            weight = np.abs(1 - column - share[:, 0]) * np.abs(1 - row - share[:, 1])
            cell = (low[:, 1] + row) * size + low[:, 0] + column
            found[above] += weight[:, None].astype(np.float32) * self.light.T[cell]
        return found


def row_factors(brdf: BRDF, rows: int = 10) -> RowFactors:
    """The best rows for a BRDF; one for a diffuse one, whatever is asked for.

    Raises:
        ValueError: there are fewer light directions than rows, or none is asked for.
    """
    if isinstance(brdf, Lambert):
        colour = np.broadcast_to(np.asarray(brdf.diffuse) / np.pi, (1, 1, 3))
        return RowFactors(None, colour.astype(np.float32))
    table = tabulate(brdf, CELLS, SAMPLES)
    found = factorise(table, rows, most=MOST, covered=True)
    energy = found.values**2
    squares = coverage(len(table), "concentric") @ (table.astype(np.float64) ** 2).sum(axis=(1, 2))
    return RowFactors(
        found.light,
        found.view,
        float(energy[rows:].sum() / energy.sum()),
        max(0.0, float(1.0 - energy.sum() / squares)),
    )
