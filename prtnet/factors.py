"""BRDFs as sums of products: a factor of the light direction times one of the view direction.

After Kautz and McCool 1999 as "All-Frequency" section 3 uses it: the table of f · cos over light
and view directions, averaged within its cells, and its singular value decomposition. The three
colours of a view stand under each other, so that they share the light factors.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prtnet import sh
from prtnet.arrays import FloatArray, IntArray
from prtnet.brdf import BRDF
from prtnet.hemisphere import Mapping, cells

__all__ = ["Factors", "factorise", "tabulate"]

BLOCK = 1 << 20  # pairs of directions evaluated at a time


@dataclass(frozen=True, eq=False)
class Factors:
    """f(light, view) · cos ≈ Σ_b light_b · view_b.

    Attributes:
        light: (k, S) over the cells of light directions.
        view: (k, V, 3) over the cells of view directions, linear RGB.
        values: singular values, of all min(3V, S) of them, descending.
        size: cells a side, S = V = size².
        mapping: of both tables.
    """

    light: FloatArray
    view: FloatArray
    values: FloatArray
    size: int
    mapping: Mapping

    def table(self) -> FloatArray:
        """(V, S, 3) the sum over factors."""
        return np.einsum("bs,bvc->vsc", self.light, self.view)

    def projected(self, light_order: int, view_order: int) -> tuple[FloatArray, FloatArray]:
        """Factors as spherical harmonics: light (k, n²) and view (k, m², 3).

        A light factor is integrated against the harmonics: it is zero below the horizon. Of a view
        factor only the upper hemisphere is ever seen, where the harmonics come closest to it.
        """
        out, area = cells(self.size, 4, self.mapping)
        rows = sh.evaluate(out.reshape(-1, 3), max(light_order, view_order))
        rows = rows.reshape(*area.shape, -1)
        light = self.light @ np.einsum("sj,sjc->sc", area, rows[..., : light_order**2])
        root = np.sqrt(area).reshape(-1, 1)
        system = root * rows[..., : view_order**2].reshape(len(root), -1)
        view = np.repeat(self.view, area.shape[1], axis=1)  # [k, V · J, 3]
        right = np.moveaxis(view, 0, 1).reshape(len(root), -1) * root
        fitted = np.linalg.lstsq(system, right, rcond=1e-6)[0]
        return light, np.moveaxis(fitted.reshape(view_order**2, len(self.view), 3), 1, 0)


def tabulate(
    brdf: BRDF, size: int = 32, samples: int = 4, mapping: Mapping = "concentric"
) -> FloatArray:
    """(V, S, 3) float32: means of f · cos over cells of view and light directions.

    Args:
        brdf: what to tabulate.
        size: cells a side of both.
        samples: of each cell, a side: their fourth power of every pair.
        mapping: of both.
    """
    out, area = cells(size, samples, mapping)
    total = area.sum(axis=1, keepdims=True)
    weight = np.where(total > 0.0, area / np.maximum(total, 1e-30), 0.0)
    table = np.empty((len(out), len(out), 3), dtype=np.float32)
    light = out.reshape(1, -1, 3)
    cosine = (np.maximum(light[0, :, 2], 0.0) * weight.ravel())[:, None]
    alike = symmetries(size, brdf.turns, brdf.mirrors)
    views = np.unique(alike.min(axis=0))
    for part in blocks(len(views), light.shape[1]):
        rows = views[part]
        mean = np.zeros((len(rows), len(out), 3))
        for sample in range(out.shape[1]):  # of the view's cell
            value = brdf(light, out[rows, sample][:, None]) * cosine
            value = value.reshape(len(mean), *area.shape, 3).sum(axis=2)
            mean += weight[rows, sample, None, None] * value
        for moved in alike:
            table[moved[rows][:, None], moved] = mean
    return table


def symmetries(size: int, turns: bool, mirrors: bool) -> IntArray:
    """Where cells of a table go when all is turned by quarters, and mirrored, (G, size²).

    A BRDF that such a move of both directions leaves alike has the same numbers there.
    """
    index = np.arange(size * size).reshape(size, size)
    found = [np.rot90(index, k) for k in (range(4) if turns else (0, 2) if mirrors else (0,))]
    if mirrors:
        found += [np.flip(one, axis=1) for one in found]
    return np.stack([one.ravel() for one in found])


def blocks(count: int, each: int) -> Iterator[slice]:
    """Slices of ``count`` rows of ``each`` pairs."""
    step = max(1, BLOCK // each)
    for start in range(0, count, step):
        yield slice(start, min(start + step, count))


def factorise(
    table: FloatArray, count: int = 8, mapping: Mapping = "concentric", most: float | None = None
) -> Factors:
    """The best factors of a table, in the sum of squares over its cells.

    Args:
        table: (V, S, 3) from :func:`tabulate`.
        count: factors k.
        mapping: of the table.
        most: larger values are clamped first ("All-Frequency" section 3 clamps at 3).

    Raises:
        ValueError: there are fewer light directions than factors.
    """
    views, lights, colours = table.shape
    if not 1 <= count <= lights:
        raise ValueError(f"a table of {lights} light directions has no {count} factors")
    kept = table if most is None else np.minimum(table, most)
    matrix = kept.swapaxes(1, 2).reshape(views * colours, lights).astype(np.float64)
    # Of the smaller side's Gram matrix: k of a thousand singular values are asked for.
    values, vectors = np.linalg.eigh(matrix.T @ matrix)
    values, vectors = np.sqrt(np.maximum(values[::-1], 0.0)), vectors[:, ::-1]
    light = vectors[:, :count].T  # [k, S], orthonormal
    view = np.moveaxis((matrix @ light.T).reshape(views, colours, -1), -1, 0)
    root = np.sqrt(np.maximum(values[:count], 1e-30))[:, None]
    return Factors(
        (light * root).astype(np.float32),
        (view / root[..., None]).astype(np.float32),
        values,
        round(lights**0.5),
        mapping,
    )
