"""Numbers of a glTF file: buffers, buffer views and accessors [1, section 3.6].

Every size is checked against the bytes that are there before anything is allocated.

[1] glTF 2.0 specification, Khronos Group.
"""

from __future__ import annotations

import base64
import binascii
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from data_gen.gltf_document import Document, Element, read_bytes
from prtnet.arrays import FloatArray, IntArray
from prtnet.errors import PrtnetError

__all__ = ["Buffers"]

COMPONENTS: dict[int, np.dtype[Any]] = {
    5120: np.dtype("<i1"),
    5121: np.dtype("<u1"),
    5122: np.dtype("<i2"),
    5123: np.dtype("<u2"),
    5125: np.dtype("<u4"),
    5126: np.dtype("<f4"),
}
LONGEST = 1024  # characters of the name of a buffer
SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Buffers:
    """Reads accessors of one document.

    Args:
        document: the file; buffers outside it are loaded when first used.
    """

    def __init__(self, document: Document) -> None:
        self.document = document
        self._accessors = document.list("accessors")
        self._views = document.list("bufferViews")
        self._buffers = document.list("buffers")
        self._loaded: dict[int, memoryview] = {}

    def external(self) -> list[memoryview]:
        """The bytes of the buffers in files of their own, in the order of ``buffers``."""
        uris = [buffer.text("uri") for buffer in self._buffers]
        outside = (i for i, uri in enumerate(uris) if uri and not uri.startswith("data:"))
        return [self._buffer(index) for index in outside]

    def count(self, element: Element, key: str) -> int:
        """Number of elements, one or more, of the accessor that ``element`` names under ``key``."""
        return self._count(self._accessor(element, key))

    def floats(
        self, element: Element, key: str, kind: str, *, integers_normalised: bool = False
    ) -> FloatArray:
        """An accessor as finite float64 numbers, (count, size of ``kind``).

        Args:
            element: where the accessor is named.
            key: under which key.
            kind: the ``type`` it must have.
            integers_normalised: integers map to [0, 1] or [-1, 1] even where the file forgot to
                say so; the specification asks for it everywhere but in quantised vertices.
        """
        accessor = self._accessor(element, key)
        raw = self._elements(accessor, kind)
        if raw.dtype.kind == "f":
            if not np.isfinite(raw).all():
                accessor.fail("holds numbers that are not finite")
            return raw.astype(np.float64)
        values = raw.astype(np.float64)
        if integers_normalised or accessor.flag("normalized"):
            values = np.maximum(values / np.iinfo(raw.dtype).max, -1.0)
        return values

    def integers(self, element: Element, key: str, kind: str) -> IntArray:
        """An accessor as non-negative integers, (count, size of ``kind``) int64."""
        accessor = self._accessor(element, key)
        raw = self._elements(accessor, kind)
        if raw.dtype.kind != "u":
            accessor.fail("must hold unsigned integers")
        return raw.astype(np.int64)

    def _accessor(self, element: Element, key: str) -> Element:
        return self._accessors[element.integer(key, limit=len(self._accessors))]

    @staticmethod
    def _count(accessor: Element) -> int:
        return accessor.integer("count") or accessor.fail("'count' must be one or more")

    def _elements(self, element: Element, kind: str) -> NDArray[Any]:
        found = element.text("type")
        if found != kind:
            element.fail(f"must be of type {kind}, not '{found}'")
        count, size = self._count(element), SIZES[kind]
        dtype = self._component(element)
        if "bufferView" in element:
            values = self._read(element, count, size, dtype)
        else:  # zeros; no honest mesh has more vertices than bytes
            total = sum(buffer.integer("byteLength") for buffer in self._buffers)
            if count > total:
                element.fail(f"claims {count} elements but the file holds {total} bytes")
            values = np.zeros((count, size), dtype)
        sparse = element.child("sparse")
        return values if sparse is None else self._substitute(sparse, values)

    def _substitute(self, sparse: Element, values: NDArray[Any]) -> NDArray[Any]:
        """Overwrite the elements a sparse accessor lists."""
        count = sparse.integer("count", limit=len(values) + 1)
        where, what = sparse.required("indices"), sparse.required("values")
        dtype = self._component(where)
        if dtype.kind != "u":
            where.fail("must hold unsigned integers")
        values = values.copy()
        if count > 0:
            slots = self._read(where, count, 1, dtype)[:, 0]
            if slots.max() >= len(values):
                where.fail(f"index {slots.max()} but there are only {len(values)} elements")
            values[slots] = self._read(what, count, values.shape[1], values.dtype)
        return values

    @staticmethod
    def _component(element: Element) -> np.dtype[Any]:
        code = element.integer("componentType")
        if code not in COMPONENTS:
            element.fail(f"unknown component type {code}")
        return COMPONENTS[code]

    def _read(self, element: Element, count: int, size: int, dtype: np.dtype[Any]) -> NDArray[Any]:
        """A view (count, size) into a buffer, as ``element`` places it in its buffer view."""
        view = self._views[element.integer("bufferView", limit=len(self._views))]
        start, length = view.integer("byteOffset", 0), view.integer("byteLength")
        data = self._buffer(view.integer("buffer", limit=len(self._buffers)))
        if start + length > len(data):
            view.fail(f"reaches byte {start + length} of a buffer of {len(data)}")
        width = size * dtype.itemsize
        stride = view.integer("byteStride", 0) or width
        offset = element.integer("byteOffset", 0)
        if stride < width:
            view.fail(f"'byteStride' is {stride} but an element takes {width} bytes")
        if offset + stride * (count - 1) + width > length:
            element.fail(f"its {count} elements do not fit a buffer view of {length} bytes")
        return np.ndarray(
            (count, size), dtype, data, start + offset, strides=(stride, dtype.itemsize)
        )

    def _buffer(self, index: int) -> memoryview:
        if index not in self._loaded:
            element = self._buffers[index]
            data = self._bytes(element, index)
            length = element.integer("byteLength")
            if length > len(data):
                element.fail(f"has {len(data)} of its {length} bytes")
            self._loaded[index] = data[:length]
        return self._loaded[index]

    def _bytes(self, element: Element, index: int) -> memoryview:
        uri = element.text("uri")
        if not uri:
            if index == 0 and self.document.binary is not None:
                return self.document.binary
            element.fail("has no data", "export it again, without compressed geometry")
        if uri.startswith("data:"):
            try:
                header, _, text = uri.partition(",")
                if not header.endswith(";base64"):
                    element.fail("its data: address is not base64")
                return memoryview(base64.b64decode(text, validate=True))
            except (binascii.Error, ValueError) as error:
                raise PrtnetError(
                    element.path, f"{element.where}: its base64 is damaged; export it again"
                ) from error
        name = unquote(uri)
        if (
            "://" in name
            or "\0" in name
            or len(name) > LONGEST
            or not inside(element.path.parent, name)
        ):
            element.fail(
                "is not in a file beside this one", "put its buffers into its folder first"
            )
        return memoryview(read_bytes(element.path.parent / name))


def inside(folder: Path, name: str) -> bool:
    """Whether a name, its symbolic links followed, is one of something in a folder."""
    try:
        return (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # links in a circle
        return False
