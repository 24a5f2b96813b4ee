"""Fits of zonal lobes: random functions beside SciPy's BFGS, and the diffuse transfer of a mesh.

python bench/lobes.py [--write] [--quick] [--transfer FILE]

The file holds transfer vectors (V, 36) under "transfer" (.npz or .safetensors). Without one the
bunny is traced here, decimated to 17,500 vertices: the cosine inside, no light from the bunny
itself.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from pathlib import Path

import numpy as np
from safetensors.numpy import load_file
from scipy.optimize import minimize
from tables import per_cent, publish, scene_path
from threadpoolctl import threadpool_limits

from data_gen.bake import BakeConfig, bake_mesh
from data_gen.coarse_mesh import coarser
from data_gen.static_mesh import read_mesh
from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.cores import core_count
from prtnet.zh import Lobes, best_coefficients, relative_error
from prtnet.zh_fit import ITERATIONS, Search, fit_lobes

ORDER = 6
PEER = 160  # functions that SciPy fits: of fewer, one that ends elsewhere decides the mean
VERTICES = 17_500
RAYS = 1024
STARTS, GOOD = 4, 0.02  # random starts of transfer, and the error that needs none


def random_functions(count: int) -> FloatArray:
    """Unit vectors of coefficients, (count, 36)."""
    vectors = np.random.default_rng(0).normal(size=(count, ORDER**2))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def misses(lobes: Lobes, target: FloatArray) -> FloatArray:
    """‖f̃ − f‖ of unit vectors."""
    return np.asarray(np.linalg.norm(lobes.harmonics() - target, axis=-1))


def as_in_the_paper(target: FloatArray, axes: FloatArray) -> tuple[float, float]:
    """Error and seconds of SciPy's BFGS over axes and coefficients (N, 3), equations 17 to 21."""
    count, band = len(axes), sh.bands(ORDER)

    def objective(unknowns: FloatArray) -> tuple[float, FloatArray]:
        axes = unknowns[: 3 * count].reshape(count, 3)
        g = unknowns[3 * count :].reshape(count, ORDER)
        basis = sh.evaluate(axes / np.linalg.norm(axes, axis=1, keepdims=True), ORDER)
        missed = (basis * g[:, band]).sum(axis=0) - target
        slope = 2.0 * np.add.reduceat(basis * missed, np.arange(ORDER) ** 2, axis=1)
        turn = 2.0 * ((g[:, band] * missed)[:, None] @ sh.gradient(axes, ORDER))[:, 0]
        return float(missed @ missed), np.concatenate([turn.ravel(), slope.ravel()])

    started = time.perf_counter()
    g = best_coefficients(sh.evaluate(axes, ORDER), target)
    start = np.concatenate([axes.ravel(), g.ravel()])
    found = minimize(objective, start, jac=True, method="BFGS", options={"gtol": 1e-6})
    return math.sqrt(max(found.fun, 0.0)), time.perf_counter() - started


def same_starts(target: FloatArray, count: int) -> tuple[list[float], list[float]]:
    """Mean error and time of a function: all at once, and by SciPy; greedy axes to start from."""
    search = Search(target)
    for _ in range(count):
        search.grow()
    axes = search.greedy_axes
    with threadpool_limits(1):
        started = time.perf_counter()
        lobes = search.finished(search.refined(axes[:, None], ITERATIONS)[0][:, 0])
        ours = (time.perf_counter() - started) / len(target)
        peer = [as_in_the_paper(target[k], axes[k]) for k in range(PEER)]
    errors = [float(misses(lobes, target)[:PEER].mean()), statistics.fmean(e for e, _ in peer)]
    return errors, [ours, statistics.median(seconds for _, seconds in peer)]


def random_table(count: int) -> None:
    """Fits of 1 to 6 lobes to random functions."""
    target = random_functions(count)
    fit_lobes(target[:64], 2, 0)  # warm up
    rows = []
    for lobes in range(1, 7):
        started = time.perf_counter()
        found = fit_lobes(target, lobes, 0)
        seconds = (time.perf_counter() - started) / count
        errors, times = same_starts(target, lobes)
        missed = misses(found, target)
        rows.append([
            lobes, f"{missed.mean():.5f}", f"{missed.max():.5f}", f"{1e6 * seconds:.0f}",
            f"{errors[0]:.5f}", f"{errors[1]:.5f}", f"{1e6 * times[0]:.0f}",
            f"{1e6 * times[1]:.0f}", f"{times[1] / times[0]:.0f} ×",
        ])  # fmt: skip
        print(rows[-1], flush=True)
    publish(
        "lobes",
        ("lobes", "mean error", "largest", "µs a function", "from one start", "SciPy", "µs",
         "SciPy, µs", "faster"),
        rows,
        f"{count:,} random unit vectors of order {ORDER}; errors are of functions of norm 1. Then"
        f" one search from greedy axes, on one core, beside SciPy's BFGS over axes and coefficients"
        f" from the same: mean error of {PEER} of the functions, time of one of them (median).",
    )  # fmt: skip


def bunny_transfer(vertices: int) -> FloatArray:
    """Diffuse transfer of the decimated bunny without further bounces, in local frames, (V, 36)."""
    mesh = coarser(read_mesh(scene_path("bunny.ply")), vertices)
    settings = BakeConfig(order=ORDER, rays=RAYS, bounces=0, albedo=1.0, threads=core_count())
    return bake_mesh(mesh, settings).vectors


def transfer_table(target: FloatArray, name: str) -> None:
    """Fits of 1 to 4 lobes to the transfer vectors of a mesh."""
    rows = []
    for lobes in range(1, 5):
        for starts in (0, STARTS):
            started = time.perf_counter()
            found = fit_lobes(target, lobes, starts, GOOD)
            seconds = time.perf_counter() - started
            length = np.linalg.norm(target, axis=1)  # 0 where a vertex sees nothing
            each = misses(found, target) / np.where(length == 0, 1.0, length)
            rows.append([
                f"{lobes}, {starts} random starts" if starts else str(lobes),
                per_cent(relative_error(target, found)),
                per_cent(float(np.quantile(each, 0.99))), f"{seconds:.1f}",
            ])  # fmt: skip
            print(rows[-1], flush=True)
            if lobes == 1:
                break
    publish(
        "lobes of transfer", ("lobes", "error", "p99", "seconds"), rows,
        f"{name}, {len(target):,} vertices, order {ORDER}. *p99*: over vertices. Random starts are"
        f" for vertices above {100 * GOOD:.0f} %.",
    )  # fmt: skip


def main() -> None:
    """Both tables."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--write", action="store_true", help="put the tables into the docs")
    options.add_argument("--quick", action="store_true", help="fewer of everything")
    options.add_argument("--transfer", type=Path, help="transfer vectors to fit")
    chosen = options.parse_args()
    random_table(100 if chosen.quick else 1000)
    if chosen.transfer is None:
        name = "The bunny, decimated, diffuse, no bounces"
        target = bunny_transfer(500 if chosen.quick else VERTICES)
    else:
        read = load_file if chosen.transfer.suffix == ".safetensors" else np.load
        name, target = f"`{chosen.transfer.name}`", np.asarray(read(chosen.transfer)["transfer"])
    transfer_table(target.astype(np.float64), name)


if __name__ == "__main__":
    main()
