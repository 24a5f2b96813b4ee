"""Fields of lobes from fields of transfer: each point by itself, or all that they are between too.

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import scipy.sparse

from prtnet.arrays import FloatArray
from prtnet.console import Report, silent
from prtnet.exchange import Given, Result, exchange
from prtnet.lobe_field import LobeField, halved
from prtnet.transfer import Patch, Surface, TransferField
from prtnet.zh import Lobes, LobesApart, apart, exact_lobes
from prtnet.zh_fit import BLOCK as FUNCTIONS
from prtnet.zh_fit import fit_lobes
from prtnet.zh_surface import bilinear, coherent_lobes, with_midpoints

__all__ = ["between", "exact_field", "lobe_field"]

STARTS, GOOD = 4, 0.02  # random starts, and the error that needs none
BLOCK = 1 << 13  # functions between two reports


def lobe_field(
    field: TransferField, count: int, coherent: bool = False, report: Report = silent
) -> LobeField:
    """The nearest field of lobes; its metadata say how far it is, and what it took.

    The lowest bands are stored apart [1, section 3.3]: three axes hold any linear band, so that a
    fit to all bands is one to the others as well.

    Args:
        field: what to fit.
        count: lobes N of every row.
        coherent: fit a texture or mesh at once, so that its lobes can be interpolated
            (``prtnet.zh_surface``); slower.
        report: of progress.

    Raises:
        PrtnetError: a coefficient is larger than half precision holds.
        ValueError: ``count`` is below 1.
    """
    started = time.perf_counter()
    transfer = field.transfer.astype(np.float64)
    fit = fitted_at_once if coherent else fitted_apart
    lobes = halved(str(field.metadata.get("source", "field")), fit(field, transfer, count, report))
    missed = lobes.harmonics() - transfer
    size = float(np.linalg.norm(transfer))
    each = np.linalg.norm(missed, axis=-1) / np.maximum(
        np.linalg.norm(transfer, axis=-1), np.finfo(np.float32).tiny
    )
    told = {"error": float(np.linalg.norm(missed)) / size if size > 0 else 0.0,
            "p99": float(np.quantile(each, 0.99)),
            "seconds": time.perf_counter() - started}  # fmt: skip
    return LobeField(
        lobes.low, lobes.lobes.axes, lobes.lobes.coefficients, field.layout, coherent, field.view,
        {**field.metadata, "fit": told},
    )  # fmt: skip


def exact_field(field: TransferField) -> LobeField:
    """The very transfer as 2n − 1 lobes, about axes that all points share: exact but for rounding.

    Coherent, and between points exactly what is between their transfer. More lobes than a file
    takes: it is there to be drawn beside fewer.

    Raises:
        PrtnetError: a coefficient is larger than half precision holds.
    """
    transfer = field.transfer.astype(np.float64)
    shared = apart(transfer, exact_lobes(transfer))
    lobes = halved(str(field.metadata.get("source", "field")), shared)
    return LobeField(
        lobes.low, lobes.lobes.axes, lobes.lobes.coefficients, field.layout, True, field.view,
        field.metadata,
    )  # fmt: skip


def fitted_apart(
    field: TransferField, transfer: FloatArray, count: int, report: Report
) -> LobesApart:
    """Lobes (K, R, N), each row of each point by itself."""
    del field
    flat = transfer.reshape(-1, transfer.shape[-1])
    parts = []
    place = exchange()
    if place is not None:
        blocks = -(-len(flat) // FUNCTIONS)

        def told(done: int) -> None:
            report("lobes", min(done * FUNCTIONS, len(flat)), len(flat))

        results = place.ordered(LobeBlock(count), {"transfer": flat}, blocks, told)
        parts = [Lobes(own["axes"], own["coefficients"]) for _, own in results]
    for start in range(0, 0 if place else len(flat), BLOCK):
        report("lobes", start, len(flat))
        parts.append(fit_lobes(flat[start : start + BLOCK], count, STARTS, GOOD))
    axes, coefficients = (
        np.concatenate([getattr(part, name) for part in parts]).reshape(
            *transfer.shape[:2], count, -1
        )
        for name in ("axes", "coefficients")
    )
    return apart(transfer, Lobes(axes, coefficients))


@dataclass(frozen=True)
class LobeBlock:
    """Lobes of some rows of points: work that can be handed over.

    Attributes:
        count: lobes N of a row.
    """

    count: int

    def __call__(self, number: int, given: Given) -> Result:
        """See ``prtnet.exchange.Work``."""
        rows = slice(number * FUNCTIONS, (number + 1) * FUNCTIONS)
        lobes = fit_lobes(given.part("transfer", rows), self.count, STARTS, GOOD)
        return {}, {"axes": lobes.axes, "coefficients": lobes.coefficients}


def fitted_at_once(
    field: TransferField, transfer: FloatArray, count: int, report: Report
) -> LobesApart:
    """Lobes (K, R, N) of all points at once, one row after the other."""
    weights = between(field.layout)
    rows = []
    for row in range(transfer.shape[1]):
        report("rows", row, transfer.shape[1])
        rows.append(coherent_lobes(weights @ transfer[:, row], weights, count))
    return LobesApart(
        np.stack([row.low for row in rows], axis=1),
        Lobes(
            np.stack([row.lobes.axes for row in rows], axis=1),
            np.stack([row.lobes.coefficients for row in rows], axis=1),
        ),
    )


def between(layout: Patch | Surface) -> scipy.sparse.csr_array:
    """Weights of points in points and what lies midway between them, (P, K)."""
    if isinstance(layout, Patch):
        height, width = layout.heights.shape
        across, along = layout.tiles
        samples = (2 * height - (not along), 2 * width - (not across))
        return bilinear(samples, (height, width), (along, across))
    pairs = np.concatenate([layout.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    return with_midpoints(len(layout), np.unique(np.sort(pairs, axis=1), axis=0))
