"""What a material's operator costs to build and to store, and whether it integrates rightly.

python bench/operators.py [--write]

The operator's radiance is compared with sums over a million even directions: of the same light,
visibility and factors, which it must agree with to the error of those sums; and of the BRDF itself
in place of the factors, which shows what eight factors and their bands leave out. A second table
takes that apart: by how much the view grazes, and what the number of factors costs without bands.
"""

from __future__ import annotations

import math
import time

import numpy as np
from tables import publish

from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, GGX, Lambert
from prtnet.environment import environment
from prtnet.factors import harmonic_factors, tabulate
from prtnet.materials import BRDFS, PRESETS, SAMPLES, material
from prtnet.merl import SHAPE, Measured
from prtnet.reflection import ReflectionOperator

FACTORS, ORDER = 8, 4
DIRECTIONS = 1_000_000
BLOCK = 50_000
PLACES = 6  # receivers, each with its own light, visibility and view


def measured(brdf: BRDF) -> Measured:
    """A table as MERL's of an isotropic BRDF, at the middles of its bins."""
    half, difference, turn = (
        (np.arange(size) + 0.5) / size * scale
        for size, scale in zip(SHAPE, (1.0, math.pi / 2, math.pi), strict=True)
    )
    tilt = (math.pi / 2 * half**2)[:, None, None]
    sine = np.sin(difference)[:, None]
    x, y = sine * np.cos(turn), sine * np.sin(turn)
    z = np.broadcast_to(np.cos(difference)[:, None], x.shape)
    pair = []
    for sign in (1.0, -1.0):  # light and view, on either side of the half vector
        along = np.cos(tilt) * sign * x + np.sin(tilt) * z
        up = np.cos(tilt) * z - np.sin(tilt) * sign * x
        pair.append(np.stack(np.broadcast_arrays(along, sign * y, up), axis=-1))
    return Measured(brdf(*pair).astype(np.float32))


def signals() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Light (P, n², 3), visibility (P, n²) and views (P, 3) of places."""
    rng = np.random.default_rng(0)
    light = environment("studio")
    lights = np.stack([light.turned(60.0 * k).harmonics(ORDER) for k in range(PLACES)])
    blockers = rng.normal(size=(PLACES, 3))
    blockers /= np.linalg.norm(blockers, axis=1, keepdims=True)
    visibility = np.stack([
        sh.project_function(lambda s, b=b: (s @ b < 0.6).astype(float), ORDER) for b in blockers
    ])  # fmt: skip
    views = sh.fibonacci_hemisphere(PLACES + 1)[:-1]  # without the most grazing one
    return lights, visibility, views


def factors_of(brdf: BRDF) -> tuple[FloatArray, FloatArray] | None:
    """Harmonics of light and view factors, as ``material`` has them; of a diffuse one none."""
    if isinstance(brdf, Lambert):
        return None
    table = tabulate(brdf, samples=SAMPLES)
    return harmonic_factors(table, FACTORS, 2 * ORDER - 1, ORDER)


def sums(
    brdf: BRDF, lights: FloatArray, visibility: FloatArray, views: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Radiance (P, 3) by sums over directions: with the factors, and with the BRDF itself."""
    found = factors_of(brdf)
    by_factors, exact = np.zeros((PLACES, 3)), np.zeros((PLACES, 3))
    every = sh.fibonacci_sphere(DIRECTIONS)
    for start in range(0, DIRECTIONS, BLOCK):
        s = every[start : start + BLOCK]
        rows = sh.evaluate(s, 2 * ORDER - 1)
        for place, view in enumerate(views):
            arriving = (rows[:, : ORDER**2] @ visibility[place])[:, None]
            arriving = arriving * (rows[:, : ORDER**2] @ lights[place])
            f = brdf(s, view) * np.maximum(s[:, 2:], 0.0)
            exact[place] += (arriving * f).sum(axis=0)
            if found is not None:
                seen = np.einsum("i,bic->bc", sh.evaluate(view, ORDER), found[1])
                f = rows @ found[0].T @ seen
            by_factors[place] += (arriving * f).sum(axis=0)
    each = 4.0 * math.pi / DIRECTIONS
    return by_factors * each, exact * each


def apart(name: str, brdf: BRDF) -> list[str]:
    """What of the difference from a BRDF is due to what, largest over places, per cent.

    Light times visibility has 2n − 1 bands, so of f · cos no more are told: what factors of light
    leave of those is the price of their number, the rest that of the view's bands and cells.
    """
    lights, visibility, views = signals()
    s = sh.fibonacci_sphere(DIRECTIONS // 10)
    rows = sh.evaluate(s, 2 * ORDER - 1)
    each = 4.0 * math.pi / len(s)
    low = rows[:, : ORDER**2]
    arriving = np.stack([
        rows.T @ ((low @ seen)[:, None] * (low @ light)) * each
        for light, seen in zip(lights, visibility, strict=True)
    ])  # fmt: skip
    told = np.stack([rows.T @ (brdf(s, v) * np.maximum(s[:, 2:], 0.0)) * each for v in views])
    exact = (arriving * told).sum(axis=1)  # [P, 3]
    table, found = tabulate(brdf, samples=SAMPLES), {}
    for count in (FACTORS, 2 * FACTORS):
        light, view = harmonic_factors(table, count, 2 * ORDER - 1, ORDER)
        kept = np.einsum("bi,bj,pjc->pic", light, light, told)
        ours = np.einsum("bi,bmc,pm->pic", light, view, sh.evaluate(views, ORDER))
        by_kept, by_ours = ((arriving * one).sum(axis=1) for one in (kept, ours))
        found[count] = [
            100.0 * np.abs(other).max(axis=1) / np.abs(exact).max()
            for other in (by_ours - exact, by_kept - exact, by_ours - by_kept)
        ]
    whole, factors, bands = found[FACTORS]
    more = found[2 * FACTORS][0]
    cells = whole[:-1].max(), whole[-1], factors[-1], bands.max(), more[-1]
    return [name, *(f"{cell:.1f} %" for cell in cells)]


def row(name: str, brdf: BRDF) -> list[str]:
    """Seconds, bytes and differences of one BRDF."""
    begun = time.perf_counter()
    made: ReflectionOperator = material(brdf, FACTORS, ORDER)
    seconds = time.perf_counter() - begun
    lights, visibility, views = signals()
    ours = made.radiance(lights, visibility, views)
    by_factors, exact = sums(brdf, lights, visibility, views)
    scale = np.abs(exact).max()
    off = [np.abs(ours - other).max() / scale for other in (by_factors, exact)]
    size = len(made.packed())
    return [name, f"{seconds:.1f}", f"{size:,}", f"{off[0]:.1e}", f"{100 * off[1]:.1f} %"]


def all_of_them() -> dict[str, BRDF]:
    """Every BRDF that has a name, the presets, and one that was measured."""
    every: dict[str, BRDF] = {name: kind() for name, kind in BRDFS.items()}
    every |= {name: brdf for name, brdf in PRESETS.items() if name != "matte"}
    every["measured (a MERL table of ggx)"] = measured(GGX())
    return every


def main() -> None:
    """What operators cost, how far they are off, and why."""
    every, rows = all_of_them(), []
    for name, brdf in every.items():
        rows.append(row(name, brdf))
        print(rows[-1], flush=True)
    columns = ("BRDF", "seconds", "bytes", "from its sums", "from the BRDF")
    note = (
        f"{FACTORS} factors, order {ORDER}, half precision, symmetric halves of matrices. Largest "
        f"differences over {PLACES} places, relative to the largest radiance."
    )
    publish("operators", columns, rows, note=note)
    publish_apart(every)


def publish_apart(every: dict[str, BRDF]) -> None:
    """Differences from BRDFs by their causes."""
    rows = []
    for name, brdf in every.items():
        if not isinstance(brdf, Lambert):
            rows.append(apart(name, brdf))
            print(rows[-1], flush=True)
    tilts = [f"{tilt:.0f}°" for tilt in np.degrees(np.arccos(signals()[2][-2:, 2]))]
    columns = (
        "BRDF", f"views to {tilts[0]}", f"at {tilts[1]}", "there, of the factors",
        "of the view's bands", f"there, {2 * FACTORS} factors",
    )  # fmt: skip
    publish("operators apart", columns, rows, note="As *from the BRDF*, by what it is due to.")


if __name__ == "__main__":
    main()
