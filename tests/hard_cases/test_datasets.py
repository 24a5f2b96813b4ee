"""Datasets with holes, flipped bits and absurd headers: none is read as if it were whole."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from prtnet.dataset import HEADERS, Dataset
from prtnet.errors import PrtnetError
from tests.hard_cases.measured import refuses, says
from tests.prtnet.test_dataset import whole, write

ARRAYS = 17


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "set.zarr").path


def chunks(path: Path) -> list[Path]:
    """Files of numbers of all arrays."""
    found = [file for file in path.rglob("*") if file.is_file() and file.name != "zarr.json"]
    assert len({file.relative_to(path).parts[0] for file in found}) == ARRAYS
    return found


def edit(path: Path, array: str, **changes: object) -> None:
    """Change an array's header as if it had been written so."""
    for header, news in ((path / array / "zarr.json", changes), (path / "zarr.json", {})):
        content = json.loads(header.read_text()) | news
        content["attributes"].pop(HEADERS, None)
        header.write_text(json.dumps(content))


def read(path: Path) -> None:
    """All of it."""
    data = Dataset.open(path)
    for name in data._arrays:
        data.read(name)


def test_every_file_that_is_gone_is_told(path: Path) -> None:
    for file in chunks(path):
        held = file.read_bytes()
        file.unlink()
        with refuses() as caught:
            read(path)
        assert f"'{file.relative_to(path).parts[0]}' is not whole" in caught.value.message
        file.write_bytes(held)
    read(path)


def test_a_flipped_bit_in_any_file_is_told(path: Path) -> None:
    rng = np.random.default_rng(5)
    for file in chunks(path):
        held = bytearray(file.read_bytes())
        held[rng.integers(len(held))] ^= 1 << rng.integers(8)
        sound = file.read_bytes()
        file.write_bytes(held)
        with pytest.raises(PrtnetError, match=f"'{file.relative_to(path).parts[0]}' is damaged"):
            read(path)
        file.write_bytes(sound)
    read(path)


def test_ten_thousand_holes_take_no_time(path: Path) -> None:
    """Zarr would look for each of them."""
    grid = {"name": "regular", "configuration": {"chunk_shape": [6]}}
    edit(path, "receiver_side", shape=[65536], chunk_grid=grid)
    with refuses() as caught:
        read(path)
    says(caught.value.message, "'receiver_side' is not whole")


def test_what_fills_holes_may_overflow_where_there_are_none(path: Path) -> None:
    edit(path, "visibility", fill_value=1e300)
    np.testing.assert_array_equal(Dataset.open(path).visibility[:], whole().visibility)
