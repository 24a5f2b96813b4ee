"""Datasets with holes, flipped bits and absurd headers: none is read as if it were whole."""

from __future__ import annotations

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prtnet.dataset import HEADERS, POSE_ARRAYS, Dataset
from prtnet.dataset_repair import DatasetRepair
from prtnet.errors import PrtnetError
from tests.fuzzing.array_files import checksummed
from tests.fuzzing.watch import bounded
from tests.hard_cases.measured import refuses, says
from tests.prtnet.test_dataset import (
    ATTRIBUTES,
    BLOCK,
    POSES,
    filled,
    fixed,
    part,
    whole,
    write,
    writer,
)
from tests.prtnet.test_dataset_repair import contents

ARRAYS = 17


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "set.zarr").path


def chunks(path: Path) -> list[Path]:
    """Files of numbers of all arrays."""
    found = [path / name for name in sorted(contents(path)) if not name.endswith("zarr.json")]
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


def test_a_half_written_one_that_is_damaged_is_begun_anew(path: Path) -> None:
    """A flipped bit anywhere; of a block that block is written again, of all else everything."""
    good, rng, seen = contents(path), np.random.default_rng(6), 0
    for file in [*good, "mark"]:
        book = writer(path)
        book.write(1, part(whole(), book.span(1)))
        assert writer(path).missing() == [0, 2]
        damaged = book._started if file == "mark" else book.partial / file
        if not damaged.exists():
            continue  # of a block that is not written yet
        held = bytearray(damaged.read_bytes())
        held[rng.integers(len(held))] ^= 1 << rng.integers(8)
        damaged.write_bytes(held)
        again = writer(path)
        by_pose = file.split("/")[0] in POSE_ARRAYS and not file.endswith("zarr.json")
        assert again.resumed == by_pose
        assert again.missing() == [0, 1, 2]
        assert contents(filled(again).finish()) == good
        seen += 1
    assert seen == 1 + 1 + ARRAYS + 9 + len(POSE_ARRAYS)


@pytest.mark.parametrize("what", ["gone", "empty", "half", "a folder", "huge"])
def test_blocks_that_did_not_reach_the_disk_are_written_again(path: Path, what: str) -> None:
    """Their markers did, when power was lost."""
    good, book = contents(path), writer(path)
    for block in range(2):
        book.write(block, part(whole(), book.span(block)))
    file = book.partial / "normals/c/1/0/0"
    data = file.read_bytes()
    file.unlink()
    match what:
        case "empty" | "half":
            file.write_bytes(data[: len(data) // 2] if what == "half" else b"")
        case "a folder":
            file.mkdir()
        case "huge":
            file.write_bytes(data)
            os.truncate(file, 10**12)
    again = writer(path)
    assert again.resumed
    assert again.missing() == [1, 2]
    assert contents(filled(again).finish()) == good


@pytest.mark.parametrize("file", ["zarr.json", "pose/zarr.json", "faces/c/0/0", "time/c/0"])
def test_files_of_a_terabyte_are_not_read(path: Path, file: str) -> None:
    good = contents(path)
    os.truncate(path / file, 10**12)
    with bounded(1 << 30):
        with refuses() as caught:
            read(path)
        says(caught.value.message, "is damaged")
        says(caught.value.message, "--repair")
        assert not isinstance(caught.value.__cause__, MemoryError)
        book = DatasetRepair(path, ATTRIBUTES, fixed(), POSES, BLOCK)
        assert contents(filled(book).finish()) == good


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes here")
@pytest.mark.parametrize("file", ["zarr.json", "pose/zarr.json", "faces/c/0/0", "time/c/0"])
def test_pipes_are_not_waited_for(path: Path, file: str) -> None:
    good = contents(path)
    (path / file).unlink()
    os.mkfifo(path / file)
    with refuses() as caught:
        read(path)
    says(caught.value.message, "--repair")
    book = DatasetRepair(path, ATTRIBUTES, fixed(), POSES, BLOCK)
    assert contents(filled(book).finish()) == good


@pytest.mark.parametrize("what", ["huge header", "a folder for a mark"])
def test_half_written_ones_of_another_kind_are_begun_anew(path: Path, what: str) -> None:
    good, book = contents(path), writer(path)
    book.write(1, part(whole(), book.span(1)))
    if what == "huge header":
        os.truncate(book.partial / "pose/zarr.json", 10**12)
    else:
        book._started.unlink()
        book._started.mkdir()
    again = writer(path)
    assert not again.resumed
    assert contents(filled(again).finish()) == good


def test_a_block_that_a_disk_cannot_read_is_named(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good, file = contents(path), path / "pose/c/1/0"
    sound = file.read_bytes()
    opened = open

    def broken(name: Any, *rest: Any, **named: Any) -> Any:
        if Path(str(name)) == file and not mended:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return opened(name, *rest, **named)

    mended: list[bool] = []
    monkeypatch.setattr("builtins.open", broken)
    with refuses() as caught:
        read(path)
    says(caught.value.message, "array 'pose' is damaged in block 1")
    book = DatasetRepair(path, ATTRIBUTES, fixed(), POSES, BLOCK)
    assert book.missing() == [1]
    mended.append(True)
    assert contents(filled(book).finish()) == good
    assert file.read_bytes() == sound


def test_a_block_packed_twice_is_not_unpacked(path: Path) -> None:
    """The inner one may claim anything."""
    codecs = json.loads((path / "pose/zarr.json").read_text())["codecs"]
    assert [one["name"] for one in codecs] == ["bytes", "blosc", "crc32c"]
    edit(path, "pose", codecs=[codecs[0], codecs[1], codecs[1], codecs[2]])
    with refuses() as caught:
        Dataset.open(path)
    says(caught.value.message, "BloscCodec, BloscCodec")


def test_blocks_that_claim_to_unpack_to_gigabytes_are_not(path: Path) -> None:
    """With a checksum that is right: Blosc would take the memory first."""
    good, file = contents(path), path / "pose/c/1/0"
    data = file.read_bytes()[:-4]
    file.write_bytes(checksummed(data[:4] + (2**31 - 1).to_bytes(4, "little") + data[8:]))
    with bounded(1 << 30):
        with refuses() as caught:
            read(path)
        says(caught.value.message, "array 'pose' is damaged in block 1")
        assert not isinstance(caught.value.__cause__, MemoryError)
        book = DatasetRepair(path, ATTRIBUTES, fixed(), POSES, BLOCK)
        assert contents(filled(book).finish()) == good


def test_a_half_written_one_with_a_link_is_refused(path: Path, tmp_path: Path) -> None:
    book = writer(path)
    shutil.move(book.partial / "time", tmp_path / "elsewhere")
    (book.partial / "time").symlink_to(tmp_path / "elsewhere")
    with refuses() as caught:
        writer(path)
    says(caught.value.message, "time is a link to something outside")


def test_a_folder_in_the_place_of_a_file_is_mended(path: Path) -> None:
    good = contents(path)
    (path / "time/c/0").unlink()
    (path / "time/c/0").mkdir()
    (path / "time/c/0/0").write_bytes(b"1")
    book = DatasetRepair(path, ATTRIBUTES, fixed(), POSES, BLOCK)
    assert contents(filled(book).finish()) == good


def test_ten_thousand_holes_are_not_looked_for(path: Path) -> None:
    """Zarr would look for each of them, which takes seconds."""
    grid = {"name": "regular", "configuration": {"chunk_shape": [6]}}
    edit(path, "receiver_side", shape=[65536], chunk_grid=grid)
    with refuses() as caught:
        read(path)
    says(caught.value.message, "'receiver_side' is not whole")


def test_what_fills_holes_may_overflow_where_there_are_none(path: Path) -> None:
    edit(path, "visibility", fill_value=1e300)
    np.testing.assert_array_equal(Dataset.open(path).visibility[:], whole().visibility)
