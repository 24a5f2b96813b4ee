"""Light directions drawn from where a BRDF reflects them to the viewer, with their density.

Any BRDF is drawn from a table of its own values: of f · cos over half vectors, whose cells are
small about the normal. There every highlight stays as the view moves, however narrow it is; in a
table over light directions it would move from cell to cell.
"""

from __future__ import annotations

import math
from weakref import WeakKeyDictionary

import numpy as np

from prtnet.arrays import FloatArray, IntArray
from prtnet.brdf import BRDF, half_vector
from prtnet.sampling import Cells, around

__all__ = ["BRDFSampler", "brdf_sampler"]

RINGS, SECTORS = 48, 32  # of half vectors; the innermost ring is 0.04 degrees wide
VIEWS = 24  # elevations of the view, closer the more it grazes
AZIMUTHS = 16  # of the view, where they matter
SAMPLES = 2  # of a cell, a side
SPREAD = 0.1  # of the brightest cell beside it, that a cell has at least


class BRDFSampler:
    """Draws what a table of a BRDF says is bright.

    What the table misses (f between its samples, cells that are partly below the horizon) is never
    drawn: other ways to draw must be there beside it.

    Args:
        brdf: the reflectance.
    """

    def __init__(self, brdf: BRDF) -> None:
        self.turns = brdf.turns
        self.azimuths = 1 if brdf.turns else AZIMUTHS
        # 1 − cos of the rings' edges, at angles that grow with the square of their number.
        self.edges = 2.0 * np.sin(math.pi / 4.0 * np.linspace(0.0, 1.0, RINGS + 1) ** 2) ** 2
        self.solid = np.diff(self.edges) * (2.0 * math.pi / SECTORS)  # angle of a cell of each ring
        self.cells = Cells(self._weights(brdf))

    def draw(self, view: FloatArray, u: FloatArray) -> FloatArray:
        """Unit directions (N, 3) for views (N, 3), of random numbers (N, 2) in [0, 1).

        Those below the horizon reflect nothing.
        """
        table, start = self._table(view)
        ring, sector, left = self.cells.draw(table, u)
        drop = self.edges[ring] + np.diff(self.edges)[ring] * left[:, 0]
        half = around(drop, start + (sector + left[:, 1]) * (2.0 * math.pi / SECTORS))
        return 2.0 * (half * view).sum(axis=1, keepdims=True) * half - view

    def density(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """Of being drawn (N,), 1/sr, at directions above the horizon (N, 3), for views (N, 3)."""
        table, start = self._table(view)
        half = half_vector(light, view)
        angle = np.arctan2(np.hypot(half[:, 0], half[:, 1]), half[:, 2])
        ring = np.sqrt(angle * (2.0 / math.pi)) * RINGS
        turn = (np.arctan2(half[:, 1], half[:, 0]) - start) / (2.0 * math.pi)
        ring, sector = (
            np.clip(place.astype(np.int64), 0, count - 1)
            for place, count in ((ring, RINGS), ((turn % 1.0) * SECTORS, SECTORS))
        )
        chance = self.cells.probability(table, ring, sector) / self.solid[ring]
        # A light turns twice as far as the half vector: dl = 4 (v·h) dh.
        return chance / np.maximum(4.0 * (half * view).sum(axis=1), 1e-12)

    def _table(self, view: FloatArray) -> tuple[IntArray, FloatArray]:
        """The table (N,) of views (N, 3), and the azimuth (N,) that its sectors start at."""
        up = np.sqrt(np.arcsin(np.clip(view[:, 2], 0.0, 1.0)) * (2.0 / math.pi))
        table = np.minimum((up * VIEWS).astype(np.int64), VIEWS - 1) * self.azimuths
        azimuth = np.arctan2(view[:, 1], view[:, 0])
        if self.turns:
            return table, azimuth
        turn = azimuth / (2.0 * math.pi) % 1.0 * self.azimuths
        return table + np.minimum(turn.astype(np.int64), self.azimuths - 1), np.zeros(len(view))

    def _weights(self, brdf: BRDF) -> FloatArray:
        """∫ f · cos dl, to a factor, over cells (tables, rings, sectors), the mean of colours."""
        line = (np.arange(SAMPLES) + 0.5) / SAMPLES
        inner = self.edges[:-1, None] + np.diff(self.edges)[:, None] * line
        turn = (np.arange(SECTORS)[:, None] + line) * (2.0 * math.pi / SECTORS)
        half = around(*np.broadcast_arrays(inner[:, :, None, None], turn))  # [R, J, S, J, 3]
        cosine = np.sin(math.pi / 2.0 * ((np.arange(VIEWS) + 0.5) / VIEWS) ** 2)
        first = 0.0 if self.turns else 0.5
        azimuth = (np.arange(self.azimuths) + first) * (2.0 * math.pi / self.azimuths)
        views = around(*np.broadcast_arrays(1.0 - cosine[:, None], azimuth)).reshape(-1, 3)
        weights = np.empty((len(views), RINGS, SECTORS))
        for table, view in enumerate(views):
            facing = half @ view
            light = 2.0 * facing[..., None] * half - view
            # dl = 4 (v·h) dh; the 4 is the same everywhere.
            seen = brdf(light, view).mean(axis=-1) * np.maximum(light[..., 2] * facing, 0.0)
            weights[table] = spread(seen.mean(axis=(1, 3)) * self.solid[:, None])
        return weights


def spread(weights: FloatArray) -> FloatArray:
    """Weights (rings, sectors), at least a share of the largest beside: for what samples missed.

    A cell may be bright between its samples, or reach above the horizon with none of them there.
    """
    wide = np.pad(np.pad(weights, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), mode="edge")
    largest = np.lib.stride_tricks.sliding_window_view(wide, (3, 3)).max(axis=(2, 3))
    return np.maximum(weights, SPREAD * largest)


SAMPLERS: WeakKeyDictionary[BRDF, BRDFSampler] = WeakKeyDictionary()


def brdf_sampler(brdf: BRDF) -> BRDFSampler:
    """A sampler of a BRDF, made once; it takes megabytes, and goes with the BRDF it was made of."""
    found = SAMPLERS.get(brdf)
    if found is None:
        found = SAMPLERS[brdf] = BRDFSampler(brdf)
    return found
