from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import safetensors.numpy

from prtnet.all_frequency import AllFrequencyField, Segment
from prtnet.all_frequency_file import facts, load_fields, reached, save_fields, sizes
from prtnet.array_file import ALL_FREQUENCY
from prtnet.errors import PrtnetError
from prtnet.sparse_columns import decode, encode
from prtnet.transfer import TransferField
from tests.all_frequency import ball, random_field


def same(one: Any, other: Any) -> None:
    for part in dataclasses.fields(one):
        a, b = getattr(one, part.name), getattr(other, part.name)
        if dataclasses.is_dataclass(a):
            same(a, b)
        elif isinstance(a, np.ndarray):
            assert a.dtype == b.dtype
            np.testing.assert_array_equal(a, b)
        elif part.name == "segments":
            for mine, theirs in zip(a, b, strict=True):
                same(mine, theirs)
        else:
            assert a == b


def test_a_file_is_what_was_saved(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    fields = (random_field(0), random_field(1, ball(0), rows=1, terms=2, clusters=2))
    save_fields(path, fields)
    again = load_fields(path)
    for one, other in zip(fields, again, strict=True):
        same(one, other)
    assert json.loads(json.dumps(facts(again))) == facts(fields)


def test_fields_of_a_file_share_their_light(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    for fields in ([], [random_field(0), random_field(0, size=4)]):
        with pytest.raises(ValueError, match="share one size"):
            save_fields(path, fields)
    assert not path.exists()


def test_sizes_are_what_is_in_the_file(tmp_path: Path) -> None:
    """Counted number by number, and beside the file itself."""
    field = random_field(2, rows=2, size=16, terms=4, clusters=3)
    found = sizes(field)
    assert found["raw"] == 42 * 2 * 6 * 16 * 16 * 4
    numbers = sum(np.count_nonzero(decode(one.representatives)) for one in field.segments)
    blocks = sum(len(one.scale) > 0 for one in field.segments)  # of 256 rows, of 128 columns
    assert found["representatives"] == 3 * numbers + 2 * 128 * blocks
    pairs = sum(len(one.vertices) for one in field.segments)
    assert reached(field) == pairs / (24 * 42)
    assert found["weights"] == 2 * 4 * pairs
    used = sum(3 * 4 - 3 for one in field.segments if one.clusters)  # the last has one term
    assert found["clustered"] == 4 * (128 * used + 4 * pairs)
    assert found["view"] == 2 * 64 * 3 * 4
    parts = ("representatives", "weights", "clusters", "view")
    assert found["total"] == sum(found[name] for name in parts)
    path = tmp_path / "a.safetensors"
    save_fields(path, [field])
    mesh = sum(a.nbytes for a in (field.surface.positions, field.surface.faces)) + 2 * 42 * 12
    header = int.from_bytes(path.read_bytes()[:8], "little")
    assert path.stat().st_size == 8 + header + mesh + found["total"]


@dataclasses.dataclass
class Parts:
    header: dict[str, Any]
    arrays: dict[str, Any]


Change = Callable[[Parts], object]


def spoiled(path: Path, change: Change) -> str:
    """What is said of a file whose header and arrays were changed."""
    save_fields(path, [random_field(3, reached=1.0)])
    with safetensors.safe_open(path, framework="numpy") as file:
        header = json.loads(file.metadata()[ALL_FREQUENCY])
    parts = Parts(header, safetensors.numpy.load_file(path))
    change(parts)
    told = {ALL_FREQUENCY: json.dumps(parts.header)}
    path.write_bytes(safetensors.numpy.save(parts.arrays, told))
    with pytest.raises(PrtnetError) as caught:
        load_fields(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return caught.value.message


def halve(name: str) -> Change:
    def change(parts: Parts) -> None:
        parts.arrays[name] = parts.arrays[name][: len(parts.arrays[name]) // 2].copy()

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: f.header.update(format_version=9), "has format version 9"),
        (lambda f: f.header.update(size=6), "faces of 6 texels"),
        (lambda f: f.header.update(size="wide"), "wide"),
        (lambda f: f.header.update(fields=[]), "holds none"),
        (lambda f: f.header.update(fields=3), "int"),
        (lambda f: f.header["fields"][0].update(steps=[1.0]), "1 steps, not 24"),
        (lambda f: f.header["fields"][0]["steps"].__setitem__(4, -1.0), "segment 4: step is -1"),
        (lambda f: f.arrays.pop("0.view"), "view"),
        (lambda f: f.arrays.pop("0.23.values"), "values"),
        (lambda f: f.arrays.pop("0.positions"), "positions"),
        (halve("0.5.weights"), "segment 5: weights do not fit"),
        (halve("0.5.rows"), "segment 5: counts do not fit the values"),
        (halve("0.5.counts"), "segment 5: counts do not fit the blocks"),
        (halve("0.5.starts"), "segment 5: starts"),
        (lambda f: f.arrays["0.5.vertices"].fill(7), "segment 5: vertices come twice"),
        (
            lambda f: f.arrays.update({"0.5.vertices": f.arrays["0.5.vertices"][:, None]}),
            "segment 5: vertices have shape",
        ),
        (lambda f: f.arrays["0.5.rows"].fill(3), "segment 5: rows of a column do not ascend"),
        (lambda f: f.arrays["0.5.rows"].__iadd__(100), "segment 5"),
        (lambda f: f.arrays["0.5.scale"].fill(np.nan), "segment 5: scale"),
        (
            lambda f: f.arrays.update({"0.5.scale": f.arrays["0.5.scale"].astype(np.float64)}),
            "float64",
        ),
        (lambda f: f.arrays["0.faces"].fill(999), "faces name vertices that are not there"),
    ],
)
def test_spoiled_files_are_told_in_one_line(change: Change, said: str, tmp_path: Path) -> None:
    assert said in spoiled(tmp_path / "a.safetensors", change)


def test_files_of_another_kind(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    matte = TransferField(np.ones((42, 1, 4), dtype=np.float32), ball())
    matte.save(path)
    with pytest.raises(PrtnetError, match="is a prtnet transfer field, not a field of all-freq"):
        load_fields(path)


def test_an_empty_segment_is_stored(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    field = random_field(0, reached=0.0)
    save_fields(path, [field])
    same(load_fields(path)[0], field)
    assert sizes(field)["representatives"] == 0
    assert reached(field) == 0.0


def test_a_number_beyond_the_last_row(tmp_path: Path) -> None:
    field = random_field(0, reached=1.0)
    one = field.segments[2]
    taller = encode(np.ones((256, one.representatives.shape[1]), dtype=np.int16))
    spoilt = dataclasses.replace(taller, shape=one.representatives.shape)
    segments = list(field.segments)
    segments[2] = Segment(**{**vars(one), "representatives": spoilt})
    with pytest.raises(ValueError, match="segment 2: a number lies beyond the last row"):
        AllFrequencyField(field.surface, tuple(segments), field.view, field.size)
