from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from prtnet.dataset import MADE_WITH, POSE_ARRAYS, Dataset
from prtnet.dataset_repair import DatasetRepair
from prtnet.errors import PrtnetError
from tests.prtnet.test_dataset import ATTRIBUTES, BLOCK, POSES, filled, fixed, writer

MADE = {MADE_WITH: {"prtnet": "0"}}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return filled(writer(tmp_path_factory.mktemp("original") / "set.zarr", **MADE)).finish()


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "set.zarr"))


def contents(path: Path) -> dict[str, bytes]:
    return {str(f.relative_to(path)): f.read_bytes() for f in path.rglob("*") if f.is_file()}


def flip(file: Path, byte: int, bit: int = 0) -> None:
    data = bytearray(file.read_bytes())
    data[byte % len(data)] ^= 1 << bit
    file.write_bytes(data)


def repair(path: Path, **attributes: object) -> list[str]:
    book = DatasetRepair(path, {**ATTRIBUTES, **MADE, **attributes}, fixed(), POSES, BLOCK)
    filled(book).finish()
    return book.mended


def read_all(path: Path) -> None:
    dataset = Dataset.open(path)
    for name in POSE_ARRAYS:
        dataset.read(name)


def test_a_sound_dataset_is_left_alone(path: Path) -> None:
    before = {file: file.stat().st_mtime_ns for file in path.rglob("*")}
    assert repair(path) == []
    assert {file: file.stat().st_mtime_ns for file in path.rglob("*")} == before
    assert list(path.parent.iterdir()) == [path]


def test_a_flipped_bit_in_any_file_is_found_named_and_mended(path: Path, original: Path) -> None:
    """Or means nothing: a header's blank, or the word that its checksums are under."""
    rng = np.random.default_rng(0)
    for name, data in contents(original).items():
        flip(path / name, int(rng.integers(len(data))), int(rng.integers(8)))
        with pytest.raises(PrtnetError, match="--repair") as caught:
            read_all(path)
        array, *where = Path(name).parts
        assert array in str(caught.value)
        if len(where) > 1 and array in POSE_ARRAYS:
            assert f"in block {where[1]};" in str(caught.value)
            assert repair(path) == [f"block {where[1]} of {array}"]
        else:
            assert repair(path) == [name]
        assert contents(path) == contents(original)


def test_every_bit_of_the_groups_header_counts(path: Path, original: Path) -> None:
    """What is still read after a flip is read as it was."""
    known = Dataset.open(path).attributes
    rng = np.random.default_rng(1)
    size, told = len((path / "zarr.json").read_bytes()), []
    for byte in rng.choice(size, 150, replace=False).tolist():
        flip(path / "zarr.json", byte, int(rng.integers(8)))
        try:
            assert Dataset.open(path).attributes == known
        except PrtnetError as error:
            told.append(error.message)
        shutil.copyfile(original / "zarr.json", path / "zarr.json")
    assert len(told) > 75
    assert all("zarr.json" in message for message in told)


def test_missing_files_are_made_again(path: Path, original: Path) -> None:
    for name in ("normals/c/2/0/0", "rest_pose/c/0", "time/zarr.json"):
        (path / name).unlink()
    shutil.rmtree(path / "sources")
    (path / "clip/c/.0.partial").write_text("left by a run that was killed")
    assert set(repair(path)) == {
        "rest_pose/c/0", "time/zarr.json", "sources/zarr.json", "block 2 of normals",
        *(f"block {number} of sources" for number in range(3)),
    }  # fmt: skip
    assert contents(path) == contents(original)


def test_several_damaged_blocks_are_named_at_once(path: Path) -> None:
    for block in (0, 2):
        flip(path / f"pose/c/{block}/0", 5)
    with pytest.raises(PrtnetError, match="'pose' is damaged in block 0, 2; repeat"):
        Dataset.open(path).read("pose")


def test_other_options_are_refused(path: Path) -> None:
    flip(path / "pose/c/0/0", 5)
    before = contents(path)
    with pytest.raises(PrtnetError, match="was made with rays 64; repeat the command line"):
        repair(path, rays=65)
    flip(path / "zarr.json", 40)
    with pytest.raises(PrtnetError, match="with other options, or too much is damaged"):
        repair(path, rays=65)
    flip(path / "zarr.json", 40)
    assert contents(path) == before
    assert list(path.parent.iterdir()) == [path]


def test_nothing_to_repair(tmp_path: Path) -> None:
    with pytest.raises(PrtnetError, match="is no dataset to repair; leave out --repair"):
        repair(tmp_path / "none.zarr")
