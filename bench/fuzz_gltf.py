"""Mutated glTF files against the reader: every one must end in a scene or in one line of error.

    python bench/fuzz_gltf.py [CASES [SEED]] [--write]

A mutation damages bytes of either chunk, cuts the file, or changes a value of the JSON. A file
that is still read must also give a finite pose, receivers and a description, or refuse in one line.
"""

from __future__ import annotations

import collections
import json
import random
import resource
import struct
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse

from data_gen.gltf_writer import write_glb
from data_gen.readers import read_scene
from data_gen.scene_info import describe
from prtnet.animation import Channel, Clip, Rig
from prtnet.errors import PrtnetError
from prtnet.scene import SkinnedScene

DEFAULTS = (5000, 0)  # cases, seed
MEMORY = 4 * 2**30  # bytes of address space; more is a failure
NUMBERS = [-1, 0, 1, 2, 3, 255, 65536, 2**31, 2**32, 2**63, 10**30, 10**400, 0.5, -0.25, 1e-40]
NUMBERS += [3.4e38, -1e38, 1e308, float("inf"), float("nan")]
VALUES = [
    *NUMBERS,
    True,
    None,
    "",
    "x",
    "VEC3",
    "\ud800",
    [],
    {},
    [0],
    [[]],
    [-1, 99],
    [{}],
    [1e38],
]
WORDS = [b"\xff\xff\xff\xff", b"\x00\x00\xc0\x7f", b"\x00\x00\x80\x7f", b"\xff\xff\x7f\x7f"]
WORDS += [b"\x00\x00\x00\x00", b"\x00\x00\x00\x80", b"\x01\x00\x00\x00"]


def small_scene(flat: bool = False) -> SkinnedScene:
    """Two tetrahedra on a chain of three nodes, with two morph targets and two clips."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    positions = np.concatenate([corners, corners + np.float32(1)])
    faces = np.concatenate([faces, faces + 4])
    weights = np.full((8, 2), 0.5)
    weights[0] = 1.0, 0.0
    if flat:
        weights, positions = weights[faces.ravel()], positions[faces.ravel()]
        faces = np.arange(24).reshape(-1, 3)
    count = len(positions)
    times = np.array([0.0, 0.5, 1.0])
    turn = np.array([[0, 0, 0, 1], [0, 0, 0.6, 0.8], [0, 0, 0, 1]])
    channels = (
        Channel(1, "rotation", times, turn),
        Channel(2, "translation", times, np.ones((3, 3, 3)), "CUBICSPLINE"),
        Channel(0, "weights", times, np.array([[0, 1], [1, 0], [0, 0.5]]), "STEP"),
    )
    rig = Rig(
        ("root", "low", "high"), np.array([-1, 0, 1]), np.ones((3, 3)),
        np.tile([0.0, 0, 0, 1], (3, 1)), np.ones((3, 3)), np.tile(np.eye(4), (3, 1, 1)),
        np.array([0.0, 0.25]), {0: slice(0, 2)},
    )  # fmt: skip
    offsets = np.linspace(-1, 1, 2 * count * 3, dtype=np.float32).reshape(2, count, 3)
    return SkinnedScene(
        "small", None, "", faces.astype(np.int32),
        (Clip("one", 0.0, 1.0, channels), Clip("two", 0.0, 1.0, channels[:1])), rig,
        np.array([1, 2]), np.array([0, 1]), np.tile(np.eye(4)[:3], (2, 1, 1)),
        scipy.sparse.csr_array(weights), positions,
        None if flat else np.tile(np.float32([0, 1, 0]), (count, 1)), offsets, 0 * offsets,
    )  # fmt: skip


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
    container, key = rng.choice(everywhere)
    match rng.randrange(5):
        case 0:
            del container[key]
        case 1:  # a value from elsewhere
            other, other_key = rng.choice(everywhere)
            container[key] = json.loads(json.dumps(other[other_key]))
        case 2 if isinstance(container[key], int | float):
            container[key] += rng.choice([-1, 1, 2, 4, 100])
        case 3 if isinstance(container, list):
            container.append(json.loads(json.dumps(container[key])))
        case _:
            container[key] = rng.choice(VALUES)


def mutated(glb: bytes, rng: random.Random) -> bytes:
    """A damaged copy of a ``.glb``."""
    kind = rng.randrange(10)
    if kind == 0:
        return glb[: rng.randrange(len(glb))]
    length = struct.unpack_from("<I", glb, 12)[0]
    text, data = bytearray(glb[20 : 20 + length]), bytearray(glb[28 + length :])
    if kind == 1:
        whole = bytearray(glb)
        whole[rng.randrange(len(whole))] = rng.randrange(256)
        return bytes(whole)
    if kind == 2:
        text[rng.randrange(len(text))] ^= 1 << rng.randrange(8)
    elif kind <= 4:
        for _ in range(rng.choice([1, 1, 8])):
            start = 4 * rng.randrange(len(data) // 4)
            data[start : start + 4] = rng.choice(WORDS)
    elif kind == 5:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    else:
        document = json.loads(bytes(text))
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            if places(document):
                mutate_json(document, rng)
        text = bytearray(json.dumps(document).encode())
        text += b" " * (-len(text) % 4)
    body = struct.pack("<II", len(text), 0x4E4F534A) + text
    body += struct.pack("<II", len(data), 0x004E4942) + data
    return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body


def outcome(path: Path) -> str:
    """What became of a file, in a few words. Anything but ``PrtnetError`` passes through."""
    try:
        scene = read_scene(path)
    except PrtnetError:
        return "refused"
    try:
        describe(scene)
        for clip in scene.clips:
            geometry = scene.geometry(scene.poses(clip, clip.times(count=3)))
            assert np.isfinite(geometry.positions).all()
            length = np.linalg.norm(geometry.normals.astype(float), axis=-1)
            assert np.abs(length - 1.0).max(initial=0.0) < 1e-5
    except PrtnetError:
        return "read, but its poses refused"
    return "read"


def main() -> None:
    from tables import publish  # here, as the tests import this module from elsewhere

    numbers = [int(word) for word in sys.argv[1:] if word != "--write"]
    cases, seed = (*numbers, *DEFAULTS[len(numbers) :])
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    warnings.simplefilter("error")
    counts: collections.Counter[str] = collections.Counter()
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mutated.glb"
        originals = []
        for flat in (False, True):
            write_glb(small_scene(flat), path)
            originals.append(path.read_bytes())
        for case in range(cases):
            rng = random.Random(f"{seed} {case}")
            data = mutated(rng.choice(originals), rng)
            path.write_bytes(data)
            try:
                counts[outcome(path)] += 1
            except Exception as error:
                counts[f"FAILED: {type(error).__name__}"] += 1
                print(f"case {case}: {type(error).__name__}: {error}")
    note = f"{cases} mutated files, seed {seed}, {time.perf_counter() - start:.0f} s."
    publish("fuzz", ["outcome", "files"], counts.most_common(), note)
    sys.exit(any(what.startswith("FAILED") for what in counts))


if __name__ == "__main__":
    main()
