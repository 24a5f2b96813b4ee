"""Materials by name: what ``--brdf`` understands, as reflection product operators.

A name is that of a BRDF (``ggx``), of a preset (``gold``), or of a measured ``.binary`` file;
parameters follow a colon: ``ggx:roughness=0.2,fresnel=1/0.77/0.34``. ``lobe`` is no operator: it
shades visibility that is zonal lobes, with an exponent that may change while running.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.brdf import (
    BRDF,
    GGX,
    AshikhminShirley,
    BlinnPhong,
    CookTorrance,
    Lambert,
    Phong,
    Schlick,
)
from prtnet.errors import PrtnetError, nearest_name
from prtnet.factors import harmonic_factors, tabulate
from prtnet.merl import read_merl
from prtnet.one_dimensional import OneDimensional
from prtnet.operators import cosine_matrix
from prtnet.reflection import ReflectionOperator, operator_of

__all__ = ["BRDFS", "OF_LOBES", "PRESETS", "brdf_named", "material"]

BRDFS: dict[str, type[Any]] = {
    kind.name: kind
    for kind in (Lambert, Phong, BlinnPhong, CookTorrance, GGX, Schlick, AshikhminShirley)
}
OF_LOBES: dict[str, type[Any]] = {OneDimensional.name: OneDimensional}
"""Those that only models of lobes are shaded with."""
PRESETS: dict[str, BRDF] = {
    "matte": Lambert(0.8),
    "plastic": GGX(diffuse=(0.5, 0.08, 0.06), specular=1.0, roughness=0.4, fresnel=0.05),
    "gold": GGX(roughness=0.45, fresnel=(1.0, 0.77, 0.34)),
    "copper": CookTorrance(roughness=0.4, fresnel=(0.96, 0.64, 0.54)),
    "brushed": Schlick(specular=0.8, roughness=0.2, isotropy=0.3, fresnel=0.7),
    "satin": AshikhminShirley(diffuse=(0.12, 0.2, 0.45), specular=0.25, along=6.0, across=40.0),
}
MEASURED = ".binary"
SAMPLES = 2  # of a cell, a side: four change the transfer of an open vertex by 0.1 to 2.5 %


def brdf_named(text: str, of_lobes: bool = False) -> BRDF:
    """The BRDF that a name, and what follows its colon, stand for.

    Args:
        text: what ``--brdf`` was given.
        of_lobes: whether it is for visibility in zonal lobes.

    Raises:
        PrtnetError: there is no such name or parameter, a value is none that a surface has, or
            only lobes can be shaded with it.
    """
    if text.lower().endswith(MEASURED):
        return read_merl(text)
    name, _, words = text.partition(":")
    if name in OF_LOBES and not of_lobes:
        why = f"'{name}' is of visibility in zonal lobes: of models that --kind lobes trained"
        raise PrtnetError("--brdf", f"{why}; phong is for all")
    kinds = BRDFS | OF_LOBES
    if name not in kinds and name not in PRESETS:
        if is_file(text):
            raise PrtnetError(text, f"is no MERL file, which end in {MEASURED}")
        known = nearest_name(name, [*PRESETS, *(kinds if of_lobes else BRDFS)])
        raise PrtnetError("--brdf", f"'{name}' is neither a BRDF nor a file; {known}")
    start = PRESETS[name] if name in PRESETS else kinds[name]()
    fields = [field.name for field in dataclasses.fields(start)]  # type: ignore[arg-type]
    changed = {}
    for word in words.split(",") if words else []:
        key, equals, value = (part.strip() for part in word.partition("="))
        if key not in fields or not equals:
            known = nearest_name(key, fields)
            raise PrtnetError("--brdf", f"{name} has no '{word}'; write NAME=VALUE, {known}")
        changed[key] = number_or_colour(value)
    return dataclasses.replace(start, **changed)  # type: ignore[type-var]


def is_file(text: str) -> bool:
    """Whether this is the name of a file that is there."""
    try:
        return Path(text).is_file()
    except OSError:  # too long for a name
        return False


def number_or_colour(text: str) -> float | tuple[float, float, float]:
    """``0.2``, or linear RGB ``1/0.5/0``.

    Raises:
        PrtnetError: it is neither.
    """
    try:
        values = tuple(float(part) for part in text.split("/"))
    except ValueError:
        values = ()
    if len(values) == 1:
        return values[0]
    if len(values) == 3:
        return values[0], values[1], values[2]
    raise PrtnetError("--brdf", f"'{text}' is neither a number nor a colour R/G/B")


def material(
    brdf: BRDF, factors: int = 8, order: int = 4, view_order: int | None = None
) -> ReflectionOperator:
    """A BRDF as an operator; a diffuse one exactly, of a single factor.

    Args:
        brdf: the reflectance.
        factors: k of its products.
        order: bands n of light and visibility.
        view_order: m of the view factors; n when not given.
    """
    view_order = order if view_order is None else view_order
    if isinstance(brdf, Lambert):
        view = np.zeros((1, view_order**2, 3), dtype=np.float32)
        view[0, 0] = np.sqrt(4.0 * np.pi) * np.asarray(brdf.diffuse) / np.pi
        return ReflectionOperator(cosine_matrix(order)[None].astype(np.float32), view)
    table = tabulate(brdf, samples=SAMPLES)
    return operator_of(*harmonic_factors(table, factors, 2 * order - 1, view_order), order)
