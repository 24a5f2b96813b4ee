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

__all__ = ["Factors", "coverage", "factorise", "harmonic_factors", "symmetries", "tabulate"]

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
        light = self.light @ integrals(out, area, light_order)
        return light, fitted(self.view, out, area, view_order)


def integrals(out: FloatArray, area: FloatArray, order: int) -> FloatArray:
    """Integrals of the harmonics over cells, (S, n²), of directions and areas of ``cells``."""
    rows = sh.evaluate(out.reshape(-1, 3), order).reshape(*area.shape, -1)
    return np.asarray(np.einsum("sj,sjc->sc", area, rows))


def fitted(view: FloatArray, out: FloatArray, area: FloatArray, order: int) -> FloatArray:
    """Harmonics (k, m², 3) that come closest to view factors (k, V, 3) over solid angles."""
    root = np.sqrt(area).reshape(-1, 1)
    system = root * sh.evaluate(out.reshape(-1, 3), order)
    right = np.moveaxis(np.repeat(view, area.shape[1], axis=1), 0, 1)  # [V · J, k, 3]
    found = np.linalg.lstsq(system, right.reshape(len(root), -1) * root, rcond=1e-6)[0]
    return np.moveaxis(found.reshape(order**2, len(view), 3), 1, 0)


def harmonic_factors(
    table: FloatArray,
    count: int = 8,
    light_order: int = 7,
    view_order: int = 4,
    mapping: Mapping = "concentric",
) -> tuple[FloatArray, FloatArray]:
    """The best factors for order-limited light, over the pixels that a ball shows.

    Of the table only what harmonics of light can tell apart is taken apart, and a view counts as
    much as it covers of a picture, the cosine. The plain decomposition spends factors on peaks at
    grazing angles that such light cannot bring out, and few pixels show.

    Args:
        table: (V, S, 3) from :func:`tabulate`.
        count: factors k; fewer where light has no more coefficients.
        light_order: bands of light factors: 2n − 1 for light and visibility of n.
        view_order: bands m of view factors.
        mapping: of the table.

    Returns:
        Light factors (k, (2n − 1)²), orthonormal, and view factors (k, m², 3).

    Raises:
        ValueError: no factor is asked for.
    """
    if count < 1:
        raise ValueError(f"a material needs at least one factor, not {count}")
    views, lights, _ = table.shape
    out, area = cells(round(lights**0.5), 4, mapping)
    told = np.moveaxis(table, 2, 1).astype(np.float64) @ integrals(out, area, light_order)
    covered = area * np.maximum(out[..., 2], 0.0)
    weight = np.sqrt(covered.sum(axis=1))[:, None]
    flat = (told * weight[:, None]).reshape(3 * views, -1)
    light = np.linalg.eigh(flat.T @ flat)[1][:, ::-1][:, :count].T
    view = np.moveaxis(told @ light.T, -1, 0)  # [k, V, 3]
    return light, fitted(view, out, covered, view_order)


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


def coverage(views: int, mapping: Mapping) -> FloatArray:
    """∫ cos over the cells of view directions, (V,): what a picture of a ball shows of each."""
    out, area = cells(round(views**0.5), 4, mapping)
    return np.asarray((area * np.maximum(out[..., 2], 0.0)).sum(axis=1))


def factorise(
    table: FloatArray,
    count: int = 8,
    mapping: Mapping = "concentric",
    most: float | None = None,
    covered: bool = False,
) -> Factors:
    """The best factors of a table, in the sum of squares over its cells.

    Args:
        table: (V, S, 3) from :func:`tabulate`.
        count: factors k.
        mapping: of the table.
        most: larger values are clamped first ("All-Frequency" section 3 clamps at 3).
        covered: whether a view counts as much as it covers of a picture, by the cosine over its
            cell, as the singular values then do; otherwise all count alike.

    Raises:
        ValueError: there are fewer light directions than factors.
    """
    views, lights, colours = table.shape
    if not 1 <= count <= lights:
        raise ValueError(f"a table of {lights} light directions has no {count} factors")
    kept = table if most is None else np.minimum(table, most)
    matrix = kept.swapaxes(1, 2).reshape(views * colours, lights).astype(np.float64)
    weighted = matrix
    if covered:
        weighted = matrix * np.sqrt(np.repeat(coverage(views, mapping), colours))[:, None]
    # Of the smaller side's Gram matrix: k of a thousand singular values are asked for.
    values, vectors = np.linalg.eigh(weighted.T @ weighted)
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
