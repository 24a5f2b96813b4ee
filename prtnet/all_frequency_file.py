"""Files of all-frequency fields, and what every part of one takes: "All-Frequency", table 1.

A file holds an object and what else stands in the same light, such as the ground, each a field of
its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment, SparseColumns
from prtnet.array_file import ALL_FREQUENCY, read_arrays, write_arrays
from prtnet.sparse_columns import byte_count
from prtnet.transfer import Surface, layout_facts, layout_from, layout_parts, whole

__all__ = [
    "FORMAT_VERSION",
    "facts",
    "load_fields",
    "reached",
    "save_fields",
    "sizes",
]

FORMAT_VERSION = 1
OWN = ("vertices", "starts", "weights", "scale")  # arrays of a segment
SPARSE = ("counts", "rows", "values")  # arrays of its representatives
FLOAT = 4  # bytes of a number of raw transfer


def save_fields(path: str | Path, fields: Sequence[AllFrequencyField]) -> None:
    """Write one ``.safetensors`` file of fields that share their light, an object first.

    Raises:
        PrtnetError: it cannot be written.
        ValueError: there is none, or their cube maps are not of the same size.
    """
    if len({one.size for one in fields}) != 1:
        raise ValueError("fields of a file share one size of cube maps")
    arrays: dict[str, Any] = {}
    for number, one in enumerate(fields):
        own = layout_parts(one.surface)[1] | {"view": one.view}
        for place, segment in enumerate(one.segments):
            parts = {name: getattr(segment, name) for name in OWN}
            parts |= {name: getattr(segment.representatives, name) for name in SPARSE}
            own |= {f"{place}.{name}": array for name, array in parts.items()}
        arrays |= {f"{number}.{name}": array for name, array in own.items()}
    header = {
        "format_version": FORMAT_VERSION,
        "size": fields[0].size,
        "fields": [
            {"metadata": dict(one.metadata), "steps": [float(each.step) for each in one.segments]}
            for one in fields
        ],
    }
    write_arrays(path, header, arrays, ALL_FREQUENCY)


def load_fields(path: str | Path) -> tuple[AllFrequencyField, ...]:
    """Read such a file.

    Raises:
        PrtnetError: it is missing, damaged, of another kind or of another format version.
    """
    header, arrays = read_arrays(path, ALL_FREQUENCY)
    with whole(path, header, FORMAT_VERSION, "field of all-frequency transfer"):
        size, told = int(header["size"]), list(header["fields"])
        if not told:
            raise ValueError("it holds none")
        return tuple(
            field_from(one, under(arrays, number), size) for number, one in enumerate(told)
        )


def under(arrays: Mapping[str, Any], number: int) -> dict[str, Any]:
    """Arrays whose names begin with a number, without it."""
    start = f"{number}."
    return {n.removeprefix(start): array for n, array in arrays.items() if n.startswith(start)}


def field_from(told: Mapping[str, Any], arrays: Mapping[str, Any], size: int) -> AllFrequencyField:
    """A field of its part of a header and its arrays; ``whole`` reports what they lack."""
    surface = layout_from({"layout": "mesh"}, arrays)
    assert isinstance(surface, Surface)
    view = arrays["view"]
    columns = len(view) * (size // 2) ** 2
    steps = [float(step) for step in told["steps"]]
    if len(steps) != SEGMENTS:
        raise ValueError(f"there are {len(steps)} steps, not {SEGMENTS}")
    segments = tuple(segment_from(under(arrays, k), columns, steps[k]) for k in range(SEGMENTS))
    return AllFrequencyField(surface, segments, view, size, dict(told.get("metadata", {})))


def segment_from(arrays: Mapping[str, Any], columns: int, step: float) -> Segment:
    """A segment of its arrays."""
    own = {name: arrays[name] for name in OWN}
    shape = (int(arrays["scale"].size), columns)
    sparse = SparseColumns(**{name: arrays[name] for name in SPARSE}, shape=shape)
    return Segment(**own, representatives=sparse, step=step)


def reached(field: AllFrequencyField) -> float:
    """The share ω of pairs of a vertex and a segment whose transfer is not zero."""
    return sum(len(one.vertices) for one in field.segments) / (SEGMENTS * len(field))


def sizes(field: AllFrequencyField) -> dict[str, int]:
    """Bytes of each stage and each part, after "All-Frequency", table 1.

    ``raw`` is the transfer of all vertices as float32; ``clustered`` what the representatives that
    are used and the weights would take as float32; then what is stored: ``representatives``,
    ``weights``, ``clusters`` (which vertices, their scales) and ``view``, in all ``total``. The
    mesh itself is in none of them.
    """
    parts = [segment_sizes(one) for one in field.segments]
    found = {name: sum(part[name] for part in parts) for name in parts[0]}
    raw = FLOAT * len(field) * SEGMENTS * field.rows * (field.size // 2) ** 2
    found = {"raw": raw, **found, "view": field.view.nbytes}
    stored = ("representatives", "weights", "clusters", "view")
    return {**found, "total": sum(found[name] for name in stored)}


def segment_sizes(one: Segment) -> dict[str, int]:
    """Bytes of what a segment holds and is made of, see :func:`sizes`."""
    used = int(np.count_nonzero(one.scale))
    return {
        "clustered": FLOAT * (used * one.representatives.shape[1] + one.weights.size),
        "representatives": byte_count(one.representatives),
        "weights": one.weights.nbytes,
        "clusters": one.vertices.nbytes + one.starts.nbytes + one.scale.nbytes,
    }


def facts(fields: Sequence[AllFrequencyField]) -> dict[str, Any]:
    """What there is to say about the fields of a file, as JSON can hold it."""
    told: dict[str, Any] = {"cube_map": fields[0].size}
    for number, one in enumerate(fields):
        own = {
            **layout_facts(one.surface),
            "points": len(one),
            "rows": one.rows,
            "reached": reached(one),
            "clusters": sum(each.clusters for each in one.segments),
            "sizes": sizes(one),
            **one.metadata,
        }
        told |= own if number == 0 else {f"beside_{number}": own}
    return told
