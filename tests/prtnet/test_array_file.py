from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy

from prtnet.array_file import MODEL, TRANSFER, header_key, read_arrays, write_arrays
from prtnet.errors import PrtnetError
from tests.fuzzing.watch import bounded


def complaint(path: Path, key: str) -> str:
    with pytest.raises(PrtnetError) as caught:
        read_arrays(path, key)
    assert "\n" not in str(caught.value)
    return caught.value.message


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    across = np.arange(6, dtype=np.float32).reshape(2, 3).T  # not contiguous
    write_arrays(path, {"is": "ours"}, {"across": across}, TRANSFER)
    header, arrays = read_arrays(path, TRANSFER)
    assert header == {"is": "ours"}
    np.testing.assert_array_equal(arrays["across"], across)
    assert header_key(path) == TRANSFER


def test_seconds_are_not_written(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    header = {"seconds": {"fit": 1.0}, "fit": {"error": 0.5, "seconds": 2.0}, "fits": [1]}
    write_arrays(path, header, {"a": np.zeros(1)}, TRANSFER)
    assert read_arrays(path, TRANSFER)[0] == {"fit": {"error": 0.5}, "fits": [1]}


def test_other_kinds_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    write_arrays(path, {"is": "ours"}, {"a": np.zeros(1)}, TRANSFER)
    assert "is a prtnet transfer field, not a model; train one first" in complaint(path, MODEL)
    safetensors.numpy.save_file({"a": np.zeros(1)}, path)
    assert "no prtnet transfer field; bake one first" in complaint(path, TRANSFER)
    assert header_key(path) is None


@pytest.mark.parametrize("text", ["no json", "[1]", "1"])
def test_header_that_is_none(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.safetensors"
    path.write_bytes(safetensors.numpy.save({"a": np.zeros(1)}, {TRANSFER: text}))
    assert "safetensors file" in complaint(path, TRANSFER)


def test_damaged_and_missing(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    assert "does not exist" in complaint(path, TRANSFER)
    path.write_bytes(b"\xff" * 40)
    assert "damaged" in complaint(path, TRANSFER)
    assert header_key(path) is None


@pytest.mark.parametrize("change", [-1, 1, 10**12])
def test_files_that_are_longer_or_shorter_than_their_arrays_are_not_mapped(
    tmp_path: Path, change: int
) -> None:
    path = tmp_path / "a.safetensors"
    write_arrays(path, {"is": "ours"}, {"a": np.zeros(5)}, TRANSFER)
    size = path.stat().st_size
    os.truncate(path, size + change)
    with bounded(1 << 30):
        assert f"{size + change} bytes, where its arrays take {size}" in complaint(path, TRANSFER)
        assert header_key(path) is None


@pytest.mark.parametrize("length", [2**40, 99_999_999])
def test_headers_that_claim_to_be_long_are_not_read(tmp_path: Path, length: int) -> None:
    path = tmp_path / "a.safetensors"
    path.write_bytes(length.to_bytes(8, "little") + b"{}")
    with bounded(1 << 30):
        assert f"a header of {length} bytes" in complaint(path, TRANSFER)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes here")
def test_pipes_are_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.safetensors")
    assert header_key(tmp_path / "a.safetensors") is None
