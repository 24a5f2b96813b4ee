"""Damage to files of arrays: safetensors, ``.npz`` archives and Zarr groups."""

from __future__ import annotations

import ast
import contextlib
import hashlib
import io
import json
import random
import struct
import warnings
import zipfile
from pathlib import Path
from typing import Any

import google_crc32c
import numpy as np
import safetensors.numpy
from numcodecs import Blosc

from prtnet.dataset import HEADERS, MADE_WITH, SELF
from tests.fuzzing.files import Files, Link
from tests.fuzzing.mutations import NUMBERS, altered_json, damaged, odd_array

__all__ = ["npz", "safetensors_file", "zarr_group"]

BOMB = 8  # million vertices
BLOSC = Blosc(cname="lz4", clevel=1, shuffle=Blosc.SHUFFLE)


def safetensors_file(files: Files, rng: random.Random) -> Files:
    """Damage to the one file of a case: its bytes, its table, its own header, or an array."""
    (name, data), *_ = files.items()
    assert isinstance(data, bytes)
    length = struct.unpack_from("<Q", data)[0]
    text, body = data[8 : 8 + length], data[8 + length :]
    kind = rng.randrange(10)
    if kind == 0:
        return {name: damaged(data, rng)}
    if kind == 1:
        size = rng.choice([0, 1, length - 1, length + 1, len(data), 2**27, 2**40, 2**64 - 1])
        return {name: struct.pack("<Q", size) + data[8:]}
    table = json.loads(text)
    if kind <= 3:
        if rng.random() < 0.2:  # two arrays change places
            one, other = rng.sample(sorted(table.keys() - {"__metadata__"}), 2)
            key = rng.choice(["data_offsets", "dtype", "shape"])
            table[one][key], table[other][key] = table[other][key], table[one][key]
            text = json.dumps(table).encode()
        else:
            told = table.pop("__metadata__")
            changed = altered_json(json.dumps(table), rng)
            text = changed.encode("utf-8", "replace")
            if changed.startswith("{") and rng.random() < 0.9:
                rest = text[1:] if text == b"{}" else b"," + text[1:]
                text = b'{"__metadata__":' + json.dumps(told).encode() + rest
        return {name: struct.pack("<Q", len(text)) + text + body}
    told = table["__metadata__"]
    if kind <= 5:
        told = {key: altered_json(words, rng) for key, words in told.items()}
        text = json.dumps(table | {"__metadata__": told}).encode()
        return {name: struct.pack("<Q", len(text)) + text + body}
    arrays = odd_arrays(safetensors.numpy.load(data), rng)
    solid = {key: np.require(array, requirements="C") for key, array in arrays.items()}
    return {name: safetensors.numpy.save(solid, told)}


def odd_arrays(arrays: dict[str, Any], rng: random.Random) -> dict[str, Any]:
    """Arrays of which some are odd, missing, or under another's name."""
    arrays = dict(arrays)
    for _ in range(rng.choice([1, 1, 1, 2])):
        if not arrays:
            return arrays
        name, other = rng.choice(sorted(arrays)), rng.choice(sorted(arrays))
        match rng.randrange(10):
            case 0:
                del arrays[name]
            case 1:
                arrays[name] = arrays[other]
            case 2:
                arrays[rng.choice(["x", "features.x", "regressor.x", "0.x"])] = arrays[name]
            case _:
                arrays[name] = odd_array(arrays[name], rng)
    return arrays


class Opener:
    """What a pickle would run; it never may."""

    def __reduce__(self) -> tuple[Any, ...]:
        return open, ("../outside.bin",)


def npy(array: Any, rng: random.Random) -> bytes:
    """An ``.npy``, its header damaged now and then."""
    file = io.BytesIO()
    np.lib.format.write_array(file, array)  # objects are pickled
    data = file.getvalue()
    if rng.random() < 0.5:
        return data
    start = 10
    length = struct.unpack_from("<H", data, 8)[0]
    header = data[start : start + length].decode()
    told = ast.literal_eval(header)
    shape = list(told["shape"])
    match rng.randrange(6):
        case 0 if shape:
            shape[rng.randrange(len(shape))] = rng.choice(NUMBERS[:13])
            told["shape"] = tuple(shape)
        case 1:
            told["descr"] = rng.choice(
                ["|O", "<f4", ">f8", "<U9", "<M8[s]", "|V0", "<f2", "<c16", 7]
            )
        case 2:
            told["fortran_order"] = True
        case 3:
            del told[rng.choice(sorted(told))]
        case 4:
            told["shape"] = tuple([1] * rng.choice([30, 70]) + shape)
    text = repr(told).encode() + b"\n"
    if rng.random() < 0.2:
        text = damaged(text, rng)
    return data[:8] + struct.pack("<H", len(text) & 0xFFFF) + text + data[start + length :]


def bomb(archive: zipfile.ZipFile) -> None:
    """Positions of zeros that unpack to a thousand times what they take."""
    entry = zipfile.ZipInfo("positions.npy")
    entry.compress_type = zipfile.ZIP_DEFLATED
    header = {"descr": "<f4", "fortran_order": False, "shape": (1, BOMB << 20, 3)}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # another entry has that name
        with archive.open(entry, "w") as file:
            np.lib.format.write_array_header_1_0(file, header)
            for _ in range(12 * BOMB):
                file.write(bytes(1 << 20))


def npz(files: Files, rng: random.Random) -> Files:
    """Damage to an archive: its bytes, sizes, entries, headers, or an array."""
    (name, data), *_ = files.items()
    assert isinstance(data, bytes)
    if rng.random() < 0.25:
        return {name: damaged(data, rng)}
    with np.load(io.BytesIO(data)) as archive:
        arrays = odd_arrays(dict(archive), rng)
    file = io.BytesIO()
    how = rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
    with zipfile.ZipFile(file, "w", how) as archive:
        for key, array in arrays.items():
            if rng.random() < 0.05:
                array = np.array([Opener()], dtype=object)
            place = rng.choice([f"{key}.npy"] * 9 + [f"../{key}.npy"])
            archive.writestr(place, npy(array, rng))
            if rng.random() < 0.05:
                with_another(archive, place, array)
        if rng.random() < 0.0005:
            bomb(archive)
    found = file.getvalue()
    if rng.random() < 0.2:  # another size in the directory
        place = found.rindex(b"PK\1\2") + rng.choice([8, 10, 20, 24, 42])
        found = (
            found[:place]
            + struct.pack("<I", rng.choice([0, 1, 2**31, 2**32 - 1]))
            + found[place + 4 :]
        )
    return {name: found}


def with_another(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    """A second entry of the same name."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        archive.writestr(name, npy(array, random.Random(0)))


def zarr_group(files: Files, rng: random.Random) -> Files:
    """Damage to the folder of a dataset, with its checksums as they were, right, or left out."""
    found, root = dict(files), next(iter(files))
    headers = [name for name in files if name.endswith("zarr.json")]
    chunks = [name for name in files if not name.endswith("zarr.json")]
    match rng.randrange(10):
        case 0:
            name = rng.choice(list(files))
            found[name] = damaged(bytes_of(files[name]), rng)
        case 1:
            del found[rng.choice(list(files)[1:])]
        case 2:
            found[rng.choice(list(files)[1:])] = Link(
                rng.choice(["../" * 9 + "etc/hostname", "/dev/zero"])
            )
        case 3 | 4:
            name = rng.choice(headers)
            text = altered_json(bytes_of(files[name]).decode(), rng)
            found[name] = text.encode("utf-8", "replace")
        case 5:  # a chunk whose checksum is right
            name = rng.choice(chunks)
            data = damaged(bytes_of(files[name])[:-4], rng)
            if rng.random() < 0.5:  # other sizes in Blosc's header
                size = rng.choice([0, 1, 2**20, 2**31 - 1, 2**32 - 1])
                at = rng.choice([4, 8, 12])
                data = data[:at] + struct.pack("<I", size) + data[at + 4 :]
            found[name] = checksummed(data)
        case 6:  # headers that the group's own header holds as well
            texts = [
                f'"{name.split("/")[1]}": {altered_json(bytes_of(files[name]).decode(), rng)}'
                for name in headers[1:]
            ]
            whole = bytes_of(files[root]).decode().rstrip()
            told = f'"kind": "inline", "must_understand": false, "metadata": {{{", ".join(texts)}}}'
            text = f'{whole[:-1]}, "consolidated_metadata": {{{told}}}}}'
            found[root] = text.encode("utf-8", "replace")
        case _:
            # Of what is half written some have no chunk yet.
            there = [name.split("/")[1] for name in headers[1:]]
            there = [a for a in there if any(f"/{a}/c/0" in name for name in chunks)]
            array = rng.choice(there)
            found = {name: content for name, content in files.items() if f"/{array}/" not in name}
            found |= rewritten(files, root, array, rng)
    if rng.random() < 0.8:
        # Some have no JSON, or no object, there any more.
        with contextlib.suppress(ValueError, TypeError, AttributeError, KeyError, RecursionError):
            found[root] = signed(found, root, rng.random() < 0.5)
    return found


def bytes_of(content: object) -> bytes:
    """The content of a plain file."""
    assert isinstance(content, bytes)
    return content


def rewritten(files: Files, root: str, name: str, rng: random.Random) -> Files:
    """The files of an array of a group, of its first chunk, after odd things happened to it."""
    folder = f"{Path(root).parent}/{name}"
    header = json.loads(bytes_of(files[f"{folder}/zarr.json"]))
    shape = header["chunk_grid"]["configuration"]["chunk_shape"]
    first = f"{folder}/c" + "/0" * len(shape)
    data = BLOSC.decode(bytes_of(files[first])[:-4])
    odd = odd_array(np.frombuffer(data, header["data_type"]).reshape(shape), rng)
    data = BLOSC.encode(np.ascontiguousarray(odd).reshape(-1)) if odd.size else b""
    header["shape"] = list(odd.shape)
    header["chunk_grid"]["configuration"]["chunk_shape"] = [max(size, 1) for size in odd.shape]
    header["data_type"] = odd.dtype.name
    header["fill_value"] = False if odd.dtype == bool else 0
    found: Files = {f"{folder}/zarr.json": json.dumps(header).encode()}
    if odd.size:
        found[f"{folder}/c" + "/0" * odd.ndim] = checksummed(data)
    return found


def checksummed(data: bytes) -> bytes:
    """With its CRC-32C behind it."""
    return data + struct.pack("<I", google_crc32c.value(data))


def signed(files: Files, root: str, old: bool) -> bytes:
    """The header of a group with checksums of what its headers are now; an old one has none."""
    document = json.loads(bytes_of(files[root]))
    told = dict(document["attributes"])
    told.pop(HEADERS, None)
    if old:
        told.pop(MADE_WITH, None)
    else:
        links = {name for name, content in files.items() if not isinstance(content, bytes)}
        sums = {
            name.split("/")[1]: hashlib.sha256(bytes_of(files[name])).hexdigest()
            for name in files
            if name.count("/") == 2 and name.endswith("zarr.json") and name not in links
        }
        own = hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()
        told[HEADERS] = {**sums, SELF: own}
    return json.dumps(document | {"attributes": told}).encode()
