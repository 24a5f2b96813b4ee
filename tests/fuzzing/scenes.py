"""Damage to glTF files: either chunk, the JSON, and where buffers are said to be."""

from __future__ import annotations

import json
import random
import struct

from tests.fuzzing.files import Files, Link
from tests.fuzzing.mutations import altered_json, damaged, json_text, mutate_json
from tests.gltf_builder import unpack

__all__ = ["URIS", "gltf"]

URIS = [
    "../outside.bin", "%2e%2e/outside.bin", "in/../../outside.bin", "in.bin/../../outside.bin",
    "./../case/../outside.bin", "link.bin", "links/outside.bin", "in.bin", "./in.bin", "in",
    ".", "..",    "/etc/hostname", "//localhost/x", "file:///etc/hostname", "http://localhost:9/x.bin",
    "ftp://localhost/x", "HTTPS://localhost/x.bin", "data:;base64,", "data:,x", "x" * 5000,
    "a\0b",    "%00", "%ff%fe", "in.bin?x", "\\\\host\\x", "C:\\x", "~/x", "scene.gltf",
    "/dev/zero", "/dev/stdin",
]  # fmt: skip
LINKS: Files = {"link.bin": Link("../outside.bin"), "links": Link("..")}


def gltf(files: Files, rng: random.Random) -> Files:
    """Damage to a scene: of one file, or with its buffer in another."""
    (name, data), *rest = files.items()
    assert isinstance(data, bytes)
    if not rest:
        return {name: glb(data, rng)}
    match rng.randrange(4):
        case 0:
            return files | {name: altered_json(data.decode(), rng).encode("utf-8", "replace")}
        case 1:
            other, content = rest[0]
            assert isinstance(content, bytes)
            return files | {other: damaged(content, rng)}
        case _:
            document = json.loads(data)
            for buffer in document["buffers"]:
                buffer["uri"] = rng.choice(URIS)
            return (
                {name: json.dumps(document).encode()}
                | files
                | LINKS
                | {name: json.dumps(document).encode()}
            )


def glb(data: bytes, rng: random.Random) -> bytes:
    """A damaged copy of a ``.glb``."""
    kind = rng.randrange(10)
    if kind <= 1:
        return damaged(data, rng)
    document, body = unpack(data)
    text = json.dumps(document)
    if kind <= 4:
        body = damaged(body, rng)
    else:
        for _ in range(rng.choice([1, 1, 1, 2, 3])):
            mutate_json(document, rng)
        text = json_text(document)
    told = text.encode("utf-8", "replace")
    told += b" " * (-len(told) % 4)
    body += bytes(-len(body) % 4)
    inner = struct.pack("<II", len(told), 0x4E4F534A) + told
    inner += struct.pack("<II", len(body), 0x004E4942) + body
    return b"glTF" + struct.pack("<II", 2, 12 + len(inner)) + inner
