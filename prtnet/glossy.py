"""Rows of BRDF-specialised transfer: "LDPRT" (Sloan, Luna and Snyder 2005), eq. 14–16.

    B_ij = ∫ b(v_i, s) y_j(s) s_z ds = U Σ V                                            [eq. 14]

over the cells v_i of a square of view directions, their three colours under each other. The n_b
largest singular values make u(v), the rows of Ũ, and Σ̃ Ṽ, which is also Ũᵀ B: the harmonics of n_b
*light functions* Σ_i Ũ_ib b(v_i, s) s_z. The paper multiplies Σ̃ Ṽ by a transfer matrix, whose
product loses bands; against rays the light functions themselves can be integrated instead, so M'
has its order-n rows without that loss.

A view counts as much as it covers of a picture: by the cosine, as in ``prtnet.factors``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF
from prtnet.factors import tabulate
from prtnet.hemisphere import cells, places

__all__ = ["BrdfRows", "brdf_rows"]

CELLS = 32  # a side, as in the paper
SAMPLES = 2  # of a cell, a side


@dataclass(frozen=True, eq=False)
class BrdfRows:
    """A BRDF as n_b light functions times n_b view functions.

    Attributes:
        light: means of the light functions, cosine included, over cells of the concentric map,
            (n_b, S).
        view: u_b, (n_b, S, 3) linear RGB.
        values: all singular values, descending.
    """

    light: FloatArray
    view: FloatArray
    values: FloatArray

    def at(self, directions: FloatArray) -> FloatArray:
        """Light functions (n_b, K) at directions (K, 3) above the horizon."""
        size = round(self.light.shape[1] ** 0.5)
        found = (places(directions, "concentric") + 1.0) * (size / 2.0)
        column, row = np.clip(found.astype(np.int64), 0, size - 1).T
        return self.light[:, row * size + column]

    def harmonics(self, order: int) -> FloatArray:
        """Σ̃ Ṽ: rows (n_b, n²) of a place that sees all of its sky."""
        return self.light @ cell_integrals(round(self.light.shape[1] ** 0.5), order)


def cell_integrals(size: int, order: int) -> FloatArray:
    """Integrals of the harmonics over the cells of the concentric map, (size², n²)."""
    out, area = cells(size, 4, "concentric")
    return np.asarray(np.einsum("sj,sjc->sc", area, sh.evaluate(out, order)))


def brdf_rows(brdf: BRDF, count: int, order: int) -> BrdfRows:
    """The best ``count`` rows for light of order n.

    Raises:
        ValueError: fewer than one row is asked for, or more than n².
    """
    if not 1 <= count <= order**2:
        raise ValueError(f"light of order {order} has 1 to {order**2} rows, not {count}")
    table = tabulate(brdf, CELLS, SAMPLES).astype(np.float64)  # [V, S, 3]
    seen = np.moveaxis(table, 2, 1) @ cell_integrals(CELLS, order)  # B, [V, 3, n²]
    out, area = cells(CELLS, 4, "concentric")
    weight = (area * out[..., 2]).sum(axis=1)
    gram = np.einsum("v,vci,vcj->ij", weight, seen, seen)
    values, vectors = np.linalg.eigh(gram)
    values = np.sqrt(np.maximum(values[::-1], 0.0))
    told = vectors[:, ::-1][:, :count]  # Ṽᵀ
    scale = np.where(values[:count] > 1e-12 * values[0], values[:count], np.inf)
    view = seen @ told / scale  # Ũ over the roots of the weights, [V, 3, n_b]
    light = np.einsum("v,vcb,vsc->bs", weight, view, table)
    return BrdfRows(light, np.ascontiguousarray(np.moveaxis(view, -1, 0)), values)
