"""How much of anything commands, readers of files and shaders take: one home for all of these.

What is beyond is refused before the work, in one line.
"""

from __future__ import annotations

import math

from prtnet.errors import PrtnetError

__all__ = [
    "LARGEST",
    "MOST_BOUNCES",
    "MOST_COPIES",
    "MOST_FACTORS",
    "MOST_FPS",
    "MOST_LIGHT_LOBES",
    "MOST_LOBES",
    "MOST_ORDER",
    "MOST_PIXELS",
    "MOST_RAYS",
    "MOST_REPEAT",
    "MOST_SPIN",
    "MOST_TEXELS",
    "MOST_THREADS",
    "check_field_limits",
    "check_order",
    "check_side",
    "check_within",
]

MOST_ORDER = 16  # bands of local transfer
MOST_LOBES = 8  # zonal lobes of a row of transfer, or of a receiver's visibility
MOST_TEXELS = 4096  # a side of a patch
MOST_RAYS = 1 << 17  # of a point
MOST_BOUNCES = 10_000
MOST_REPEAT = 1000  # widths of a patch
MOST_LIGHT_LOBES = 11  # of each colour: what holds any light of order 6; shaders are made for it
MOST_FACTORS = 64  # of a BRDF, likewise
MOST_COPIES = 100  # characters
MOST_PIXELS = 8192  # a side of a picture
MOST_THREADS = 1024
MOST_SPIN = 999  # pictures all around
MOST_FPS = 240  # pictures a second of a movie
LARGEST = 1e12  # number of a field: pictures of larger ones overflow, and no simulation gives them


def check_within(subject: str, value: float | None, least: float, most: float) -> None:
    """Refuse a number outside of [least, most], or none; None is fine.

    Raises:
        PrtnetError: it is.
    """
    if value is None or least <= value <= most:
        return
    bounds = f"at least {least:g}" if math.isinf(most) else f"from {least:g} to {most:g}"
    raise PrtnetError(subject, f"is {value:g}; it must be {bounds}")


def check_side(subject: str, size: tuple[int, int] | None, most: int) -> None:
    """Refuse a picture or a patch (W, H) with a side too long.

    Raises:
        PrtnetError: it has one.
    """
    if size is not None and max(size) > most:
        raise PrtnetError(subject, f"is too large; give at most {most}x{most}")


def check_order(order: int) -> None:
    """Raise ValueError for a file of more bands than any command takes."""
    if not 1 <= order <= MOST_ORDER:
        raise ValueError(f"order {order}, of at most {MOST_ORDER}")


def check_field_limits(
    order: int, rows: int, lobes: int | None, texels: tuple[int, ...] | None
) -> None:
    """Raise ValueError for a field that no command would have made, with what is too large.

    Args:
        order: bands n.
        rows: of every point, at most the n² that light tells apart.
        lobes: of every row; None where it is transfer.
        texels: rows and columns of a patch; None for a mesh.
    """
    check_order(order)
    if rows > order**2:
        raise ValueError(f"{rows} rows, of at most {order**2} for this order")
    if lobes is not None and lobes > MOST_LOBES:
        raise ValueError(f"{lobes} lobes a row, of at most {MOST_LOBES}")
    if texels is not None and max(texels) > MOST_TEXELS:
        raise ValueError(f"{texels[1]}x{texels[0]} texels, of at most {MOST_TEXELS} a side")
