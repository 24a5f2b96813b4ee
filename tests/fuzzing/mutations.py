"""Damage to bytes, text, JSON and arrays: what every format's own damage is made of."""

from __future__ import annotations

import copy
import json
import random
import re
from typing import Any

import numpy as np

__all__ = ["altered_json", "damaged", "json_text", "mutate_json", "odd_array", "retold"]

NUMBERS = [-1, 0, 1, 2, 3, 255, 65536, 2**31, 2**32, 2**63, 10**12, 10**30, 10**400, 0.5, -0.25]
NUMBERS += [1e-40, 3.4e38, -1e38, 1e308, float("inf"), float("nan")]
VALUES = [
    *NUMBERS, True, None, "", "x", "VEC3", "\ud800", "../outside", "http://localhost/x",
    "/etc/passwd", [], {}, [0], [[]], [-1, 99], [{}], [1e38],
]  # fmt: skip
WORDS = [b"\xff\xff\xff\xff", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f", b"\xff\xff\x7f\x7f"]
WORDS += [b"\x00\x00\x00\x00", b"\x00\x00\x00\x80", b"\x01\x00\x00\x00", b"\x00\x10\xa5\xd4"]
ODD = [0, 1, -1, 2, 127, -128, 255, 32767, 65535, 2**31 - 1, -(2**31), 10**12, 1e-40, 1e30, -3e38]
ODD += [1e300, float("inf"), float("-inf"), float("nan")]
TYPES = ["f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "?"]
NUMBER = re.compile(rb"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
DEEP = "\0deep"  # where a text of JSON is nested
TWICE = "\0twice "  # before a key that comes twice
NESTED = 50_000  # levels: any parser that recurs is out of stack


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Bytes cut, flipped, overwritten, doubled or left out."""
    if not data:
        return bytes([rng.randrange(256)])
    found = bytearray(data)
    for _ in range(rng.choice([1, 1, 1, 2, 8])):
        # Half of the damage is near the beginning, where headers are.
        place = rng.randrange(min(len(found), rng.choice([64, len(found)])))
        match rng.randrange(8):
            case 0:
                return bytes(found[:place])
            case 1 | 2:
                found[place] ^= 1 << rng.randrange(8)
            case 3:
                found[place] = rng.randrange(256)
            case 4 | 5:
                place -= place % 4
                word = rng.choice(WORDS)
                found[place : place + 4] = word[: len(found) - place]
            case 6:
                size = rng.choice([1, 4, 64])
                found[place:place] = found[place : place + size]
            case _ if len(found) > 8:
                del found[place : place + rng.choice([1, 4])]
    return bytes(found)


def places(value: Any) -> list[tuple[Any, Any]]:
    """Every container of a JSON tree with every key in it."""
    found = []
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in items:
        found.append((value, key))
        if isinstance(inner, dict | list):
            found += places(inner)
    return found


def mutate_json(document: dict[str, Any], rng: random.Random) -> None:
    """Change one value of a JSON document in place."""
    everywhere = places(document)
    if not everywhere:
        return
    container, key = rng.choice(everywhere)
    match rng.randrange(7):
        case 0:
            del container[key]
        case 1:  # a value from elsewhere
            other, other_key = rng.choice(everywhere)
            container[key] = copy.deepcopy(other[other_key])
        case 2 if isinstance(container[key], int | float):
            container[key] += rng.choice([-1, 1, 2, 4, 100])
        case 3 if isinstance(container, list):
            container.append(copy.deepcopy(container[key]))
        case 4 if isinstance(container, dict) and rng.random() < 0.3:
            container[TWICE + key] = copy.deepcopy(rng.choice(VALUES))
        case 5 if rng.random() < 0.1:
            container[key] = DEEP
        case _:
            container[key] = copy.deepcopy(rng.choice(VALUES))


def json_text(document: Any, **options: Any) -> str:
    """A mutated document as text, with the nesting and the doubled keys that no object has."""
    text = json.dumps(document, **options)
    text = text.replace(json.dumps(TWICE)[:-1], '"')
    return text.replace(json.dumps(DEEP), "[" * NESTED + "]" * NESTED)


def altered_json(text: str, rng: random.Random, **options: Any) -> str:
    """A JSON text with a few values changed."""
    document = json.loads(text)
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        mutate_json(document, rng)
    return json_text(document, **options)


def retold(text: bytes, rng: random.Random) -> bytes:
    """A text of lines and numbers with some of them changed, doubled or left out."""
    for _ in range(rng.choice([1, 1, 2, 5])):
        lines = text.split(b"\n")
        place, other = rng.randrange(len(lines)), rng.randrange(len(lines))
        match rng.randrange(6):
            case 0:
                del lines[place]
            case 1:
                lines.insert(other, lines[place])
            case 2:
                lines[place], lines[other] = lines[other], lines[place]
            case 3:
                lines[place] = lines[place] * (2 if len(text) > 10_000 else rng.choice([2, 200]))
            case _:
                spans = [found.span() for found in NUMBER.finditer(lines[place])]
                if spans:
                    start, end = rng.choice(spans)
                    number = str(rng.choice(NUMBERS)).encode()
                    lines[place] = lines[place][:start] + number + lines[place][end:]
        text = b"\n".join(lines)
    return text


def odd_array(array: Any, rng: random.Random) -> Any:
    """An array of another type, shape or content."""
    match rng.randrange(9):
        case 0:
            with np.errstate(all="ignore"):
                return array.astype(rng.choice(TYPES))
        case 1 if array.ndim:
            axis = rng.randrange(array.ndim)
            return np.take(array, np.arange(max(array.shape[axis] - rng.choice([1, 2]), 0)), axis)
        case 2 if array.ndim and array.size:
            axis = rng.randrange(array.ndim)
            return np.concatenate([array, np.take(array, [0], axis)], axis)
        case 3:
            return array.reshape(rng.choice([(-1,), (1, *array.shape), (*array.shape, 1)]))
        case 4:
            return np.ascontiguousarray(array.T)
        case 5:
            return np.zeros((0, *array.shape[1:]), array.dtype)
        case _:
            return with_odd_values(array, rng)


def with_odd_values(array: Any, rng: random.Random) -> Any:
    """An array with some numbers, or all, that its type holds and its meaning may not."""
    found = array.copy()
    flat = found.reshape(-1)
    value = rng.choice(ODD)
    if found.dtype.kind in "iu":
        if not np.isfinite(value):
            value = 7
        span = np.iinfo(found.dtype)
        value = min(max(int(value), span.min), span.max)
    with np.errstate(over="ignore"):
        if rng.random() < 0.2:
            flat[:] = value
        elif flat.size:
            for _ in range(rng.choice([1, 1, 5])):
                flat[rng.randrange(flat.size)] = value
    return found
