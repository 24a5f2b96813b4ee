"""Damage to pictures, measured materials, and meshes of text or plain bytes."""

from __future__ import annotations

import random
import struct

from tests.fuzzing.files import Files, Holed
from tests.fuzzing.mutations import NUMBERS, damaged, retold

__all__ = ["HEADER", "WHOLE", "lines", "measured", "plain"]

WHOLE = 12 + 3 * 8 * 90 * 90 * 180  # bytes of a MERL file
HEADER = struct.pack("<iii", 90, 90, 180)


def plain(files: Files, rng: random.Random) -> Files:
    """Damage to the bytes of a file."""
    (name, data), *_ = files.items()
    assert isinstance(data, bytes)
    if rng.random() < 0.3:  # a size in the header
        place = rng.randrange(max(min(len(data), 400) - 4, 1))
        number = int(max(min(rng.choice(NUMBERS[:12]), 2**32 - 1), 0))
        word = struct.pack(rng.choice("<>") + "I", number)
        return {name: data[:place] + word + data[place + 4 :]}
    return {name: damaged(data, rng)}


def lines(files: Files, rng: random.Random) -> Files:
    """Damage to a file that is text, or begins as text."""
    (name, data), *_ = files.items()
    assert isinstance(data, bytes)
    if rng.random() < 0.3:
        return {name: damaged(data, rng)}
    return files | {name: retold(data, rng)}


def measured(files: Files, rng: random.Random) -> Files:
    """Damage to a MERL file, mostly to its header or size: the rest is 35 MB of numbers."""
    (name, _), *_ = files.items()
    size, header = WHOLE, HEADER
    where = rng.randrange(12, WHOLE - 8)
    if rng.random() < 0.005:
        number = struct.pack("<d", rng.choice([-1.0, 1.0, 1e29, 1e31, float("nan"), float("inf")]))
        return {name: Holed(WHOLE, {0: HEADER, where - where % 8 + 4: number})}
    if rng.random() < 0.5:
        header = damaged(header, rng)
    if header == HEADER or rng.random() < 0.5:
        size = rng.choice([0, 4, 12, rng.randrange(WHOLE), WHOLE - 1, WHOLE + 1, 10**12])
    return {name: Holed(size, {0: header[:size]} if size else {})}
