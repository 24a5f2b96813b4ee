"""Lobes over a whole texture or mesh at once, so that what lies between its points is right too.

A renderer interpolates lobes: between the texels of a texture, across the triangles of a mesh. Fits
by themselves do not survive that: one point's second lobe may be its neighbour's third. Here lobes
live at knots, what they are at samples is interpolated, and the error at all samples is minimised
at once. Samples lie closer than knots, so neighbours that do not correspond cost: nothing else
makes them do so [1, section 4.2, "Wrinkle Model"].

Papers:
    [1] Sloan, Luna and Snyder, "Local, Deformable Precomputed Radiance Transfer", 2005.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import scipy.optimize
import scipy.sparse
import scipy.sparse.linalg

from prtnet.arrays import FloatArray, IntArray
from prtnet.axis_frames import frame_about
from prtnet.cores import one_thread, thread_count
from prtnet.sh import evaluate, order_of
from prtnet.zh import (
    RIDGE,
    Lobes,
    LobesApart,
    bands_apart,
    best_coefficients,
    checked,
    zonal_energy,
)
from prtnet.zh_fit import fit_lobes, linear_axes
from prtnet.zh_misfit import BandValues, Cosines, parts_of

__all__ = ["bilinear", "coherent_lobes", "interpolated", "with_midpoints"]

FIRST_ITERATIONS = 40
ITERATIONS = 300
ANGLES = np.radians([20.0, 35.0, 50.0, 65.0, 80.0])  # of lobes around the linear axis
TURNS = np.radians(22.5 * np.arange(8))
HISTORY = 20
TOLERANCE = 1e-9  # share of the objective gained in one iteration
BLOCK = 2048  # samples at a time
LEAST = 1e-6  # length of an interpolated axis: of opposite ones nothing is left to point anywhere


def coherent_lobes(
    target: FloatArray,
    weights: scipy.sparse.csr_array,
    count: int = 3,
    start: Lobes | None = None,
    iterations: int = ITERATIONS,
) -> LobesApart:
    """Lobes at knots that, interpolated, are near functions known at samples.

    Axes are interpolated linearly and then made unit vectors, coefficients linearly. Deterministic.

    Args:
        target: f at the samples, (P, n²).
        weights: of knots in samples, (P, K), as ``bilinear`` and ``with_midpoints`` make them;
            every knot has a sample.
        count: number of lobes N.
        start: lobes (K, N) whose axes to begin from. Otherwise all begin about the axes of the
            mean function, or about and around their own linear axis as in [1]: what is better.
        iterations: of L-BFGS, at most.

    Returns:
        The lobes at the knots, (K, N), in the dtype of ``target``.
    """
    values, dtype = checked(target)
    if weights.shape[0] != len(values):
        raise ValueError(f"weights of {weights.shape[0]} samples for {len(values)} functions")
    scale = float(np.sqrt(np.mean(np.square(values).sum(axis=-1)))) or 1.0
    values = values / scale
    at_knots = interpolants(values, weights)
    threads = thread_count()
    with one_thread(), ThreadPoolExecutor(threads) as pool:
        surface = Surface(values, weights, count, pool)
        if start is None:
            starts = beginnings(values, at_knots, count)
        else:
            starts = [best_about(start.axes.astype(np.float64), at_knots, bands_apart(count))]
        # A few steps tell which start is better; it alone goes on.
        found = [surface.fitted(lobes, min(iterations, FIRST_ITERATIONS)) for lobes in starts]
        lobes, _ = min(found, key=lambda result: result[1])
        if iterations > FIRST_ITERATIONS:
            lobes, _ = surface.fitted(lobes, iterations - FIRST_ITERATIONS)
    first = bands_apart(count)
    low = np.zeros((len(at_knots), 4))
    low[:, : min(first**2, at_knots.shape[1])] = at_knots[:, : first**2]
    return LobesApart(
        (low * scale).astype(dtype),
        Lobes(lobes.axes.astype(dtype), (lobes.coefficients * scale).astype(dtype)),
    )


def interpolated(lobes: LobesApart, weights: scipy.sparse.csr_array) -> LobesApart:
    """Lobes at samples (P, N) of lobes at knots (K, N): axes are made unit vectors again."""
    knots, count = lobes.lobes.axes.shape[:2]
    axes = (weights @ lobes.lobes.axes.reshape(knots, -1)).reshape(-1, count, 3)
    length = np.maximum(np.linalg.norm(axes, axis=-1, keepdims=True), LEAST)
    coefficients = weights @ lobes.lobes.coefficients.reshape(knots, -1)
    order = lobes.lobes.coefficients.shape[-1]
    return LobesApart(
        weights @ lobes.low, Lobes(axes / length, coefficients.reshape(-1, count, order))
    )


def beginnings(values: FloatArray, at_knots: FloatArray, count: int) -> list[Lobes]:
    """Lobes (K, N) to begin from: everywhere those of the mean function; around linear axes."""
    shared = fit_lobes(values.mean(axis=0), count)
    same = np.tile(shared.axes, (len(at_knots), 1, 1))
    first = bands_apart(count)
    around = [
        best_about(cone(at_knots, count, angle, turn), at_knots, first)
        for angle in ANGLES
        for turn in TURNS
    ]
    rest = at_knots.copy()
    rest[:, : first**2] = 0.0
    nearest = min(around, key=lambda lobes: float(np.linalg.norm(lobes.harmonics() - rest)))
    return [best_about(same, at_knots, first), nearest]


def cone(target: FloatArray, count: int, angle: float, turn: float) -> FloatArray:
    """Axes (K, N, 3): the linear axis of functions (K, n²), and the others around it [1].

    Two lobes lie to both sides of it. Knots get the same turn: by the shortest way from +z.
    """
    middle = linear_axes(target)
    alone = count != 2
    about = turn + 2.0 * math.pi * np.arange(count - alone) / max(count - alone, 1)
    local = np.stack(
        [math.sin(angle) * np.cos(about), math.sin(angle) * np.sin(about),
         np.full(len(about), math.cos(angle))], axis=-1
    )  # fmt: skip
    if alone:
        local = np.concatenate([[[0.0, 0.0, 1.0]], local])
    return local @ np.swapaxes(frame_about(middle), -1, -2)


class Surface:
    """The error of interpolated lobes at all samples.

    Unknowns are columns, a knot each: the x of all axes, y, z, then coefficients by bands.
    """

    def __init__(
        self,
        target: FloatArray,
        weights: scipy.sparse.csr_array,
        count: int,
        pool: ThreadPoolExecutor,
    ) -> None:
        self.count, self.order, self.pool = count, order_of(target), pool
        self.first = min(bands_apart(count), self.order)  # band of the lobes
        self.energy = zonal_energy(np.arange(1, self.order))[:, None, None]
        self.knots = weights.shape[1]
        self.samples = len(target)
        rest = target.copy()
        rest[:, : self.first**2] = 0.0
        self.blocks = []
        for begin in range(0, len(rest), BLOCK):
            part = slice(begin, begin + BLOCK)
            rows = scipy.sparse.csr_array(weights[part])
            size = float(np.square(rest[part]).sum())
            self.blocks.append((rows, scipy.sparse.csr_array(rows.T), parts_of(rest[part]), size))

    def fitted(self, start: Lobes, iterations: int) -> tuple[Lobes, float]:
        """The end of a search from lobes, and the objective there."""
        if self.order <= self.first:
            return start, 0.0
        result = scipy.optimize.minimize(
            self.objective, self.packed(start), jac=True, method="L-BFGS-B",
            options={"maxiter": iterations, "maxcor": HISTORY, "ftol": TOLERANCE, "gtol": 0.0,
                     "maxfun": 2 * iterations + 1},
        )  # fmt: skip
        return self.unpacked(result.x), float(result.fun)

    def packed(self, lobes: Lobes) -> FloatArray:
        """Lobes (K, N) as unknowns."""
        axes = lobes.axes.transpose(2, 1, 0).reshape(-1, self.knots)
        coefficients = lobes.coefficients[..., self.first :].transpose(2, 1, 0)
        return np.concatenate([axes, coefficients.reshape(-1, self.knots)]).ravel()

    def unpacked(self, unknowns: FloatArray) -> Lobes:
        """Unknowns as lobes (K, N)."""
        columns = unknowns.reshape(-1, self.knots)
        axes = columns[: 3 * self.count].reshape(3, self.count, -1).transpose(2, 1, 0)
        found = columns[3 * self.count :].reshape(-1, self.count, self.knots).transpose(2, 1, 0)
        coefficients = np.zeros((self.knots, self.count, self.order))
        coefficients[..., self.first :] = found
        return Lobes(axes / np.linalg.norm(axes, axis=-1, keepdims=True), coefficients)

    def objective(self, unknowns: FloatArray) -> tuple[float, FloatArray]:
        """Mean squared error of samples, and ε‖g*‖² of knots; its slope."""
        columns = unknowns.reshape(-1, self.knots)
        axes = columns[: 3 * self.count].reshape(3, self.count, self.knots)
        length = np.sqrt((axes * axes).sum(axis=0))
        unit = axes / length
        g = columns[3 * self.count :]
        table = np.ascontiguousarray(np.concatenate([unit.reshape(-1, self.knots), g]).T)
        total, slope = 0.0, np.zeros_like(table)
        for value, part in self.pool.map(lambda block: self.of_block(table, *block), self.blocks):
            total += value
            slope += part
        slope = np.ascontiguousarray(slope.T) / self.samples
        around = slope[: 3 * self.count].reshape(axes.shape)  # a view
        around -= (around * unit).sum(axis=0) * unit
        around /= length
        size = np.repeat(self.energy[self.first - 1 :, 0], self.count, axis=0) * g
        slope[3 * self.count :] += 2.0 * RIDGE / self.knots * size
        return total / self.samples + RIDGE / self.knots * float((size * g).sum()), slope.ravel()

    def of_block(
        self,
        table: FloatArray,
        rows: scipy.sparse.csr_array,
        columns: scipy.sparse.csr_array,
        parts: list[FloatArray],
        size: float,
    ) -> tuple[float, FloatArray]:
        """Squared error of some samples and its slope by what knots hold (K, 3N + …)."""
        mixed = np.ascontiguousarray((rows @ table).T)
        axes = mixed[: 3 * self.count].reshape(3, self.count, -1)
        length = np.maximum(np.sqrt((axes * axes).sum(axis=0)), LEAST)
        unit = axes / length
        g = np.zeros((self.order - 1, *unit.shape[1:]))
        g[self.first - 1 :] = mixed[3 * self.count :].reshape(-1, *unit.shape[1:])
        bands = BandValues(unit, parts)
        cosines = Cosines(unit, self.order)
        pull = self.energy * cosines.times(g)
        value = size + float((g * (pull - 2.0 * bands.bands)).sum())
        around = cosines.slope(g, self.energy) - bands.slope(g)
        around -= (around * unit).sum(axis=0) * unit
        around *= 2.0 / length
        along = 2.0 * (pull - bands.bands)[self.first - 1 :]
        slope = np.concatenate([part.reshape(-1, unit.shape[2]) for part in (around, along)])
        return value, columns @ np.ascontiguousarray(slope.T)


def best_about(axes: FloatArray, target: FloatArray, first: int) -> Lobes:
    """Lobes about axes (K, N, 3) with the best coefficients of bands not stored apart."""
    order = order_of(target)
    coefficients = best_coefficients(evaluate(axes, order), target)
    coefficients[..., :first] = 0.0
    return Lobes(axes, coefficients)


def interpolants(values: FloatArray, weights: scipy.sparse.csr_array) -> FloatArray:
    """What interpolates to values (P, C) with the least squared error, (K, C)."""
    ridge = RIDGE * scipy.sparse.eye_array(weights.shape[1])
    normal = scipy.sparse.csc_array(weights.T @ weights + ridge)
    return np.asarray(scipy.sparse.linalg.splu(normal).solve(weights.T @ values))


def bilinear(
    samples: tuple[int, int], knots: tuple[int, int], tiled: bool | tuple[bool, bool] = False
) -> scipy.sparse.csr_array:
    """Weights of a grid of knots in a finer grid of samples, (H W, h w), both row by row.

    Args:
        samples: rows H and columns W.
        knots: rows h and columns w.
        tiled: the texture repeats itself: sample i lies at i h/H. Otherwise the corners of both
            grids are the same places: sample i lies at i (h − 1)/(H − 1). A pair is for the rows'
            and the columns' places each.
    """
    both = (tiled, tiled) if isinstance(tiled, bool) else tiled
    rows, columns = map(linear, samples, knots, both)
    return scipy.sparse.csr_array(scipy.sparse.kron(rows, columns, format="csr"))


def linear(samples: int, knots: int, tiled: bool) -> scipy.sparse.csr_array:
    """Weights of knots along a line, (samples, knots)."""
    if samples < knots or knots < 1:
        raise ValueError(f"{samples} samples along an edge do not hold {knots} knots")
    at = np.arange(samples)
    place = at * knots / samples if tiled else at * (knots - 1) / max(samples - 1, 1)
    before = np.floor(place).astype(np.int64)
    after = (before + 1) % knots if tiled else np.minimum(before + 1, knots - 1)
    share = place - before
    values, index = np.concatenate([1.0 - share, share]), np.concatenate([before, after])
    result = scipy.sparse.csr_array((values, (np.tile(at, 2), index)), shape=(samples, knots))
    result.eliminate_zeros()
    return result


def with_midpoints(vertices: int, edges: IntArray) -> scipy.sparse.csr_array:
    """Weights of the vertices of a mesh in vertices and the middles of edges, (V + E, V).

    Times the transfer at the vertices this is the transfer that a renderer would interpolate.

    Args:
        vertices: how many, V.
        edges: pairs, (E, 2).
    """
    middles = np.repeat(np.arange(len(edges)), 2)
    halves = scipy.sparse.csr_array(
        (np.full(2 * len(edges), 0.5), (middles, edges.ravel())), shape=(len(edges), vertices)
    )
    whole = scipy.sparse.eye_array(vertices, format="csr")
    return scipy.sparse.csr_array(scipy.sparse.vstack([whole, halves], format="csr"))
