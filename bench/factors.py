"""How well ten products hold a BRDF: the table of "All-Frequency" section 3, read several ways.

python bench/factors.py [--write]

The paper gives its errors but not its formulas. Read as the models are printed, with harmonics as
good as they can be, our errors are others; three changes bring them to the paper's:

- *bare*: the BRDF without the denominator π n·l n·v (Schlick's without 4π v v′). Then nothing peaks
  at grazing angles, and the largest value is about the 3 that the paper clamps at.
- *projected*: harmonics by projection, on both sides, of a function that is zero below the horizon,
  instead of least squares over the hemisphere on the view side: they must then hold its edge too.
- *isotropic*: Schlick's without the azimuth factor A, whose edge at the normal no order holds: with
  it errors of harmonics fall too slowly.

With them ten factors are worth between 36 and 49 rows, as in the paper, and root mean squares are
near. Which Fresnel term, with or without shadowing G, and whether pairs weigh by cell or by solid
angle, changes them by a tenth and cannot be told. What remains: the paper's maxima of low orders
are higher than ours; how it samples pairs is not said.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from tables import publish

from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, Angles, CookTorrance, Schlick, half_vector
from prtnet.factors import tabulate
from prtnet.hemisphere import cells

PAPER = {
    "Cook-Torrance": ((0.0677, 0.554), (0.156, 1.21), (0.102, 0.967), (0.0708, 0.727),
                      (0.0538, 0.532)),
    "Schlick": ((0.0389, 0.298), (0.121, 0.634), (0.0766, 0.438), (0.0511, 0.333), (0.038, 0.267)),
}  # fmt: skip
ORDERS, FACTORS = (4, 5, 6, 7), 10
METHODS = (f"SVD, {FACTORS}", *(f"SH, order {order}" for order in ORDERS))
CLAMP = 3.0  # the paper's
SIZE, SAMPLES = 32, 2  # 16 samples a pair; 256, as in the paper, change the last digit
Error = tuple[float, float]


class BareCookTorrance(CookTorrance):
    """F D G, with D of Beckmann, less its 1/π too."""

    def lobe(self, a: Angles, roughness2: float) -> FloatArray:
        """Without 1/(4π n·l n·v)."""
        return super().lobe(a, roughness2) * (4.0 * math.pi * a.light * a.view)


class BareSchlick(Schlick):
    """S(u) G G′ Z A."""

    def above(self, light: FloatArray, view: FloatArray) -> FloatArray:
        """The part that has a denominator, without it: r is the roughness, p the isotropy."""
        r, p = self.roughness, self.isotropy
        half = half_vector(light, view)
        between = np.clip((half * view).sum(axis=-1), 0.0, 1.0)
        across = half[..., 0] ** 2 + half[..., 1] ** 2
        zenith = r / (across + r * half[..., 2] ** 2) ** 2
        w2 = np.where(across > 1e-12, half[..., 0] ** 2 / np.maximum(across, 1e-12), 0.5)
        azimuth = np.sqrt(p / (p * p * (1.0 - w2) + w2))
        cosines = [np.maximum(d[..., 2], 0.0) for d in (light, view)]
        reach = cosines[0] / (r - r * cosines[0] + cosines[0])
        reach = reach * cosines[1] / (r - r * cosines[1] + cosines[1])
        start = np.broadcast_to(np.asarray(self.fresnel, dtype=np.float64), (3,))
        mirror = start + (1.0 - start) * ((1.0 - between) ** 5)[..., None]
        return mirror * (reach * zenith * azimuth)[..., None]


def best(table: FloatArray, rows: FloatArray, _solid: FloatArray) -> FloatArray:
    """The view side of a table in harmonics (V, n²), by least squares over its cells."""
    return np.asarray(rows @ np.linalg.lstsq(rows, table, rcond=None)[0])


def projected(table: FloatArray, rows: FloatArray, solid: FloatArray) -> FloatArray:
    """Both sides of a table by projection: it is zero below the horizon."""
    onto = rows @ (rows * solid[:, None]).T
    return np.asarray(onto @ table @ onto.T)


def errors(
    brdf: BRDF, harmonics: Sequence[Callable[[FloatArray, FloatArray, FloatArray], FloatArray]]
) -> list[list[Error]]:
    """RMS over solid angles, and maximum, of every method; a list for each kind of harmonics."""
    out, area = cells(SIZE, SAMPLES, "parabolic")
    solid = area.sum(axis=1)
    seen = solid > 0.0
    solid, weight = solid[seen], area[seen] / solid[seen, None]
    table = np.minimum(tabulate(brdf, SIZE, SAMPLES, "parabolic")[..., 0], CLAMP)
    table = table[np.ix_(seen, seen)].astype(np.float64)
    vectors = np.linalg.eigh(table.T @ table)[1][:, -FACTORS:]
    share = solid / solid.sum()

    def off(guess: FloatArray) -> Error:
        square = np.square(guess - table)
        return float(np.sqrt(share @ square @ share)), float(np.sqrt(square.max()))

    svd = off(table @ vectors @ vectors.T)
    found = [[svd] for _ in harmonics]
    for order in ORDERS:
        every = sh.evaluate(out[seen].reshape(-1, 3), order).reshape(*weight.shape, -1)
        rows = np.einsum("vj,vjc->vc", weight, every)
        for kind, one in zip(harmonics, found, strict=True):
            one.append(off(kind(table, rows, solid)))
    return found


def readings(name: str) -> dict[str, list[Error]]:
    """Errors of a model by how it is read."""
    if name == "Cook-Torrance":
        given = {"roughness": 0.4, "fresnel": 0.5}
        printed, bare = CookTorrance(**given), BareCookTorrance(**given)
    else:
        given = {"roughness": 0.2, "isotropy": 0.2, "fresnel": 0.8}
        printed, bare = Schlick(**given), BareSchlick(**given)
    models: dict[str, BRDF] = {"": printed, "bare": bare}
    if name == "Schlick":
        models["bare, isotropic"] = dataclasses.replace(bare, isotropy=1.0)
    found = {}
    for label, brdf in models.items():
        plain, changed = errors(brdf, (best, projected))
        found[label or "as printed"] = plain
        found[f"{label}, projected".removeprefix(", ")] = changed
    return found


def rows_worth(svd: Error, harmonics: Sequence[Error]) -> str:
    """Between how many rows of harmonics the factors' RMS is."""
    fewer = [order**2 for order, error in zip(ORDERS, harmonics, strict=True) if error[0] > svd[0]]
    if not fewer:
        return f"under {ORDERS[0] ** 2}"
    if len(fewer) == len(ORDERS):
        return f"over {ORDERS[-1] ** 2}"
    return f"{fewer[-1]} to {ORDERS[len(fewer)] ** 2}"


def main() -> None:
    """The paper's errors beside those of every reading, a table a model."""
    for name, paper in PAPER.items():
        begun = time.perf_counter()
        found = {"paper": list(paper), **readings(name)}
        print(f"{name}: {time.perf_counter() - begun:.0f} s", flush=True)
        rows = [
            [method, *(f"{one[k][0]:.3f}, {one[k][1]:.2f}" for one in found.values())]
            for k, method in enumerate(METHODS)
        ]
        worth = [rows_worth(one[0], one[1:]) for one in found.values()]
        rows.append(["rows that ten factors are worth", *worth])
        publish(f"factors {name}", ("method", *found), rows, note="RMS, maximum.")


if __name__ == "__main__":
    main()
