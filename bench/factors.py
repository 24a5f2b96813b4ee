"""How well a BRDF's factors hold it: the table of "All-Frequency" section 3, and what it costs.

python bench/factors.py [--write]
"""

from __future__ import annotations

import time

import numpy as np
from tables import publish

from prtnet import sh
from prtnet.arrays import FloatArray
from prtnet.brdf import BRDF, CookTorrance, Schlick
from prtnet.factors import factorise, tabulate
from prtnet.hemisphere import Mapping, cells
from prtnet.reflection import reflection_operator

MODELS: dict[str, BRDF] = {
    "Cook-Torrance": CookTorrance(roughness=0.4, fresnel=0.5),
    "Schlick": Schlick(roughness=0.2, isotropy=0.2, fresnel=0.8),
}
PAPER = {
    "SVD, 10": ((0.0677, 0.554), (0.0389, 0.298)),
    "SH, order 4": ((0.156, 1.21), (0.121, 0.634)),
    "SH, order 5": ((0.102, 0.967), (0.0766, 0.438)),
    "SH, order 6": ((0.0708, 0.727), (0.0511, 0.333)),
    "SH, order 7": ((0.0538, 0.532), (0.038, 0.267)),
}
CLAMP = 3.0  # the paper's
SIZE, SAMPLES = 32, 4


def harmonics(table: FloatArray, order: int, mapping: Mapping) -> FloatArray:
    """The table with its view side in spherical harmonics, by least squares over the cells."""
    out, area = cells(SIZE, SAMPLES, mapping)
    total = area.sum(axis=1)
    weight = area / np.maximum(total, 1e-30)[:, None]
    rows = np.einsum("vj,vjc->vc", weight, sh.evaluate(out.reshape(-1, 3), order).reshape(
        *area.shape, -1))  # fmt: skip
    fitted, *_ = np.linalg.lstsq(rows, table, rcond=None)
    return rows @ fitted


def errors(mapping: Mapping, clamp: float | None) -> dict[str, list[tuple[float, float]]]:
    """RMS and maximum over all pairs of cells above the horizon, by method and model."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in PAPER}
    _, area = cells(SIZE, SAMPLES, mapping)
    seen = area.sum(axis=1) > 0.0
    for name, brdf in MODELS.items():
        begun = time.perf_counter()
        table = tabulate(brdf, SIZE, SAMPLES, mapping)
        if clamp is not None:
            table = np.minimum(table, clamp)
        print(name, mapping, f"{time.perf_counter() - begun:.0f} s", flush=True)
        grey = table[..., 0].astype(np.float64)
        for method in found:
            if method.startswith("SVD"):
                guess = factorise(table, 10, mapping).table()[..., 0]
            else:
                guess = harmonics(grey, int(method[-1]), mapping)
            off = (guess - grey)[np.ix_(seen, seen)]
            found[method].append((float(np.sqrt(np.square(off).mean())), float(np.abs(off).max())))
    return found


def cost() -> str:
    """Seconds and bytes of an operator of eight factors."""
    parts = []
    for name, brdf in MODELS.items():
        begun = time.perf_counter()
        made = reflection_operator(factorise(tabulate(brdf, SIZE, 2), 8))
        seconds = time.perf_counter() - begun
        parts.append(f"{name} {seconds:.1f} s and {len(made.packed()) / 1000:.1f} kB")
    return "Operators of eight factors and four bands: " + ", ".join(parts) + "."


def main() -> None:
    """The paper's table beside ours."""
    ours = {
        "parabolic, clamped": errors("parabolic", CLAMP),
        "concentric, clamped": errors("concentric", CLAMP),
        "concentric": errors("concentric", None),
    }
    rows = []
    for method, paper in PAPER.items():
        cells_of = [paper, *(table[method] for table in ours.values())]
        rows.append(
            [method]
            + [f"{value[m][0]:.3f}, {value[m][1]:.2f}" for m in range(2) for value in cells_of]
        )
    heads = ["paper", *ours]
    columns = ("rows", *(f"{name}: {head}" for name in MODELS for head in heads))
    publish("factors", columns, rows, note=f"RMS, maximum. {cost()}")


if __name__ == "__main__":
    main()
