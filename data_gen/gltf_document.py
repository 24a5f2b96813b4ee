"""The container of a glTF 2.0 file [1]: its JSON, read with type checks, and its binary chunk.

The JSON is read by hand rather than through a schema library: a damaged file must end in one line
that names the place, never in a traceback of the library's or in a default silently filled in.

[1] glTF 2.0 specification, Khronos Group; "GLB File Format" for the binary container.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from prtnet import files
from prtnet.arrays import FloatArray
from prtnet.errors import PrtnetError

__all__ = ["MOST_BYTES", "Document", "Element", "parse", "read_bytes"]

MAGIC = b"glTF"
JSON_CHUNK, BINARY_CHUNK = 0x4E4F534A, 0x004E4942
MOST_BYTES = 2**32 - 1  # of a .glb, by its own header
LARGEST = float(np.finfo(np.float32).max)
ADVICE = "the file is damaged; export it again"

# Required extensions that do not change where the vertices are, and one that is implemented.
HARMLESS = (
    "KHR_mesh_quantization",
    "KHR_materials_",
    "KHR_texture_",
    "EXT_texture_",
    "KHR_lights_",
)


@dataclass(frozen=True, eq=False)
class Element:
    """A JSON object and its place in the file.

    Attributes:
        path: the file, for messages.
        where: the place, such as ``meshes[2].primitives[0]``.
        value: the object.
    """

    path: Path
    where: str
    value: dict[str, Any]

    def __contains__(self, key: str) -> bool:
        return key in self.value

    def fail(self, message: str, advice: str = ADVICE) -> NoReturn:
        """Raise the ``PrtnetError`` that says so about this place."""
        where = f"{self.where}: " if self.where else ""
        raise PrtnetError(self.path, f"{where}{message}; {advice}")

    def integer(self, key: str, default: int | None = None, limit: int | None = None) -> int:
        """A non-negative integer, below ``limit`` if given."""
        value = self.value.get(key, default)
        if value is None:
            self.fail(f"'{key}' is missing")
        return self._integer(key, value, limit)

    def integers(self, key: str, limit: int) -> list[int]:
        """A list of non-negative integers below ``limit``; empty where the key is absent."""
        return [self._integer(key, value, limit) for value in self._list(key)]

    def _integer(self, key: str, value: Any, limit: int | None) -> int:
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            self.fail(f"'{key}' must be a whole number, zero or more")
        if limit is not None and value >= limit:
            self.fail(f"'{key}' is {value} but there are only {limit}")
        return value

    def floats(self, key: str, size: int | None = None) -> FloatArray | None:
        """A list of finite numbers, of the given length if any; None where the key is absent."""
        if key not in self.value:
            return None
        values = self._list(key)
        if size is not None and len(values) != size:
            self.fail(f"'{key}' must hold {size} numbers")
        numbers = np.empty(len(values))
        for slot, value in enumerate(values):
            try:
                number = float(value) if isinstance(value, int | float) else math.nan
            except OverflowError:
                number = math.inf
            # Anything a float32 cannot hold could only turn into infinities later.
            if not abs(number) < LARGEST or isinstance(value, bool):
                self.fail(f"'{key}' must hold finite numbers")
            numbers[slot] = number
        return numbers

    def flag(self, key: str) -> bool:
        """A boolean; false where the key is absent."""
        value = self.value.get(key, False)
        if not isinstance(value, bool):
            self.fail(f"'{key}' must be true or false")
        return value

    def text(self, key: str, default: str = "") -> str:
        """A string that can be printed; ``default`` where the key is absent or empty."""
        value = self.value.get(key, default)
        if not isinstance(value, str):
            self.fail(f"'{key}' must be a string")
        return value.encode("utf-8", "replace").decode() or default  # JSON allows lone surrogates

    def texts(self, key: str) -> list[str]:
        """A list of strings; empty where the key is absent."""
        values = self._list(key)
        if not all(isinstance(value, str) for value in values):
            self.fail(f"'{key}' must hold strings")
        return values

    def child(self, key: str) -> Element | None:
        """The object under ``key``; None where the key is absent."""
        return None if key not in self.value else self._element(self.value[key], key)

    def required(self, key: str) -> Element:
        """The object under ``key``."""
        return self.child(key) or self.fail(f"'{key}' is missing")

    def children(self, key: str) -> list[Element]:
        """The objects listed under ``key``; empty where the key is absent."""
        return [self._element(v, f"{key}[{i}]") for i, v in enumerate(self._list(key))]

    def _element(self, value: Any, key: str) -> Element:
        where = f"{self.where}.{key}" if self.where else key
        if not isinstance(value, dict):
            raise PrtnetError(self.path, f"{where}: must be a JSON object; {ADVICE}")
        return Element(self.path, where, value)

    def _list(self, key: str) -> list[Any]:
        value = self.value.get(key, [])
        if not isinstance(value, list):
            self.fail(f"'{key}' must be a list")
        return value


@dataclass(frozen=True, eq=False)
class Document:
    """A glTF file taken apart.

    Attributes:
        path: the file.
        root: the whole JSON.
        binary: the binary chunk of a ``.glb``; None where there is none.
    """

    path: Path
    root: Element
    binary: memoryview | None
    _lists: dict[str, list[Element]] = field(default_factory=dict, repr=False)

    def list(self, key: str) -> list[Element]:
        """A top-level list of objects: nodes, meshes, accessors, …"""
        if key not in self._lists:
            self._lists[key] = self.root.children(key)
        return self._lists[key]


def read_bytes(path: Path) -> bytes:
    """A regular file's bytes.

    Raises:
        PrtnetError: it does not exist or cannot be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise PrtnetError(path, "is not a file; give a .glb, .gltf or .npz scene")
        data = files.read_bytes(path, MOST_BYTES)
    except OSError as error:
        reason = error.strerror or str(error)
        raise PrtnetError(path, f"cannot be read ({reason}); check the path") from error
    if data is None:
        raise PrtnetError(path, f"has over {MOST_BYTES} bytes; export it in parts")
    return data


def parse(path: Path, data: bytes) -> Document:
    """Take apart a ``.glb`` or ``.gltf`` file, told apart by content.

    Raises:
        PrtnetError: it is neither, is damaged, or requires an extension that is not supported.
    """
    text, binary = split_chunks(path, data) if data[:4] == MAGIC else (memoryview(data), None)
    try:
        value = json.loads(bytes(text).decode("utf-8-sig"))
    except (ValueError, RecursionError) as error:
        message = " ".join(str(error).split())[:120]
        raise PrtnetError(path, f"its JSON cannot be read ({message}); {ADVICE}") from error
    if not isinstance(value, dict):
        raise PrtnetError(path, f"its JSON is not an object; {ADVICE}")
    document = Document(path, Element(path, "", value), binary)
    check_supported(document)
    return document


def split_chunks(path: Path, data: bytes) -> tuple[memoryview, memoryview | None]:
    """The JSON and the binary chunk of a ``.glb``."""
    cut = f"is cut short or not a whole .glb; {ADVICE}"
    if len(data) < 20:
        raise PrtnetError(path, cut)
    version, length, json_length, kind = struct.unpack_from("<IIII", data, 4)
    if version != 2:
        raise PrtnetError(path, f"is glTF version {version}; convert it to glTF 2.0")
    if length > len(data) or 20 + json_length > length or kind != JSON_CHUNK:
        raise PrtnetError(path, cut)
    view = memoryview(data)[:length]
    text, start = view[20 : 20 + json_length], 20 + json_length
    if start + 8 > length:
        return text, None
    binary_length, kind = struct.unpack_from("<II", view, start)
    if start + 8 + binary_length > length:
        raise PrtnetError(path, cut)
    return text, view[start + 8 : start + 8 + binary_length] if kind == BINARY_CHUNK else None


def check_supported(document: Document) -> None:
    """Refuse files of another version, and those whose geometry needs an unknown extension."""
    root = document.root
    asset = root.child("asset")
    if asset is None or not asset.text("version").startswith("2."):
        raise PrtnetError(document.path, "is not glTF 2.0; convert it to glTF 2.0")
    for name in root.texts("extensionsRequired"):
        if not name.startswith(HARMLESS):
            raise PrtnetError(
                document.path,
                f"requires the extension {name}, which is not supported; export it without "
                "(compressed geometry must be decompressed)",
            )
