from __future__ import annotations

import contextlib
import json
import os
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from prtnet.dataset import (
    FORMAT_VERSION,
    HEADERS,
    POSE_ARRAYS,
    SAMPLED,
    Block,
    Dataset,
)
from prtnet.dataset_writer import MARKERS, DatasetWriter
from prtnet.errors import PrtnetError

POSES, RECEIVERS, ORDER, JOINTS, BLOCK = 10, 6, 2, 2, 4
ATTRIBUTES = {
    "order": ORDER,
    "rays": 64,
    "seed": 3,
    "two_sided": False,
    "scene_kind": "skinned",
    "scene_name": "thing",
    "scene_sha256": "a" * 64,
    "mesh_sha256": "b" * 64,
    "clip_names": ["walk", "run", SAMPLED],
    "held_out": ["run"],
    "joint_names": ["hip", "knee"],
    "morph_count": 0,
}


def fixed() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(1)
    return {
        "faces": np.array([[0, 1, 2], [3, 4, 5]], dtype=np.int32),
        "receiver_of_vertex": np.arange(RECEIVERS, dtype=np.int32),
        "receiver_side": np.ones(RECEIVERS, dtype=np.int8),
        "rest_positions": rng.normal(size=(RECEIVERS, 3)).astype(np.float32),
        "rest_normals": rng.normal(size=(RECEIVERS, 3)).astype(np.float32),
        "rest_tangents": rng.normal(size=(RECEIVERS, 3)).astype(np.float32),
        "rest_pose": rng.normal(size=12 * JOINTS).astype(np.float32),
        "joint_weights": np.zeros((RECEIVERS, JOINTS), dtype=np.float32),
        "joint_parents": np.array([-1, 0], dtype=np.int32),
    }


def whole() -> Block:
    rng = np.random.default_rng(2)
    clip = np.array([0, 0, 0, 0, 0, 1, 1, 1, 2, 2], dtype=np.int32)

    def vectors() -> np.ndarray:
        return rng.normal(size=(POSES, RECEIVERS, 3)).astype(np.float32)

    return Block(
        visibility=rng.normal(size=(POSES, RECEIVERS, ORDER**2)).astype(np.float32),
        pose=rng.normal(size=(POSES, 12 * JOINTS)).astype(np.float32),
        positions=vectors(),
        normals=vectors(),
        tangents=vectors(),
        clip=clip,
        time=np.linspace(0, 1, POSES, dtype=np.float32),
        sources=np.eye(3, dtype=bool)[clip],
    )


def part(block: Block, span: slice) -> Block:
    return Block(**{name: getattr(block, name)[span] for name in POSE_ARRAYS})


def writer(path: Path, **attributes: object) -> DatasetWriter:
    return DatasetWriter(path, {**ATTRIBUTES, **attributes}, fixed(), POSES, BLOCK)


def write(path: Path, **attributes: object) -> Dataset:
    return Dataset.open(filled(writer(path, **attributes)).finish())


def filled(book: DatasetWriter) -> DatasetWriter:
    """With all blocks that were missing."""
    for block in book.missing():
        book.write(block, part(whole(), book.span(block)))
    return book


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return write(tmp_path / "set.zarr")


def test_what_is_written_is_read(dataset: Dataset) -> None:
    for name in POSE_ARRAYS:
        stored, expected = dataset.read(name), getattr(whole(), name)
        assert stored.dtype == expected.dtype
        np.testing.assert_array_equal(stored, expected)
    for name, expected in fixed().items():
        np.testing.assert_array_equal(getattr(dataset, name), expected)
        assert getattr(dataset, name).dtype == expected.dtype
    for name, value in ATTRIBUTES.items():
        assert getattr(dataset, name) == value
    assert dataset.attributes["format_version"] == FORMAT_VERSION
    assert len(dataset) == POSES
    assert dataset.pose_size == 12 * JOINTS


def test_rows_are_read_by_number_slice_list_and_mask(dataset: Dataset) -> None:
    expected = whole().visibility
    mask = np.arange(POSES) % 3 == 0
    for index in (3, -1, slice(3, 9), slice(None, None, 2), np.array([7, 1, 1]), [0, 9], mask):
        np.testing.assert_array_equal(dataset.visibility[index], expected[index])


def test_poses_of_held_out_and_training_clips(dataset: Dataset) -> None:
    np.testing.assert_array_equal(dataset.held_out_poses(), [5, 6, 7])
    np.testing.assert_array_equal(dataset.training_poses(), [0, 1, 2, 3, 4, 8, 9])
    np.testing.assert_array_equal(dataset.poses_of(SAMPLED), [8, 9])


def test_a_point_cache_has_no_joints(tmp_path: Path) -> None:
    arrays = {name: value for name, value in fixed().items() if not name.startswith("joint")}
    attributes = {**ATTRIBUTES, "scene_kind": "point_cache"}
    book = DatasetWriter(tmp_path / "set.zarr", attributes, arrays, POSES, POSES)
    book.write(0, whole())
    opened = Dataset.open(book.finish())
    assert opened.joint_weights is None
    assert opened.joint_parents is None


def test_nothing_stands_under_the_final_name_until_it_is_whole(tmp_path: Path) -> None:
    book = writer(tmp_path / "set.zarr")
    book.write(0, part(whole(), book.span(0)))
    assert not (tmp_path / "set.zarr").exists()
    assert book.missing() == [1, 2]


class Held:
    """A block whose arrays are given once something else has happened."""

    def __init__(self, block: Block, awaited: threading.Event) -> None:
        self.block, self.asked, self.awaited = block, threading.Event(), awaited

    def __getattr__(self, name: str) -> object:
        self.asked.set()
        assert self.awaited.wait(60)
        return getattr(self.block, name)


def test_a_thread_that_ends_changes_nothing_for_one_that_still_writes(tmp_path: Path) -> None:
    """Zarr leaves chunks of zeros out, unless it is told for the array itself."""
    book = writer(tmp_path / "set.zarr")
    zeros = Block(**{name: np.zeros_like(getattr(whole(), name)) for name in POSE_ARRAYS})
    ended = threading.Event()
    late: Any = Held(part(zeros, book.span(1)), ended)
    early: Any = Held(part(zeros, book.span(0)), late.asked)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(book.write, 0, early)
        assert early.asked.wait(60)
        second = pool.submit(book.write, 1, late)
        first.result()
        ended.set()
        second.result()
    book.write(2, part(zeros, book.span(2)))
    assert len(Dataset.open(book.finish())) == POSES


def test_an_equal_writer_goes_on(tmp_path: Path) -> None:
    first = writer(tmp_path / "set.zarr")
    first.write(1, part(whole(), first.span(1)))
    second = writer(tmp_path / "set.zarr")
    assert second.resumed
    assert second.missing() == [0, 2]
    for block in (2, 0):
        second.write(block, part(whole(), second.span(block)))
    np.testing.assert_array_equal(Dataset.open(second.finish()).read("pose"), whole().pose)
    assert [path.name for path in tmp_path.iterdir()] == ["set.zarr"]


@pytest.mark.parametrize("change", [{"rays": 65}, {"scene_sha256": "c" * 64}, {"seed": 4}])
def test_another_writer_starts_over(tmp_path: Path, change: dict[str, object]) -> None:
    first = writer(tmp_path / "set.zarr")
    first.write(1, part(whole(), first.span(1)))
    second = writer(tmp_path / "set.zarr", **change)
    assert not second.resumed
    assert second.missing() == [0, 1, 2]


def test_another_mesh_starts_over(tmp_path: Path) -> None:
    writer(tmp_path / "set.zarr").write(0, part(whole(), slice(0, 4)))
    arrays = fixed()
    arrays["rest_tangents"] = -arrays["rest_tangents"]
    assert not DatasetWriter(tmp_path / "set.zarr", ATTRIBUTES, arrays, POSES, BLOCK).resumed


def test_a_new_dataset_replaces_the_old(tmp_path: Path) -> None:
    write(tmp_path / "set.zarr")
    shutil.rmtree(tmp_path / "set.zarr" / "visibility")
    assert len(write(tmp_path / "set.zarr")) == POSES


class Killed(BaseException):
    """No error: the process is gone."""


@pytest.mark.parametrize("old", [False, True])
@pytest.mark.parametrize("survived", range(5))
def test_a_run_killed_while_it_finishes_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, survived: int, old: bool
) -> None:
    """After so many renames and deletions nothing happens any more, not even in handlers."""
    path = tmp_path / "set.zarr"
    if old:
        write(path, rays=1)
    book = filled(writer(path))
    left = iter(range(survived))

    def mortal(step: Callable[..., None]) -> Callable[..., None]:
        def tried(*arguments: Path) -> None:
            if next(left, None) is None:
                raise Killed
            step(*arguments)

        return tried

    with monkeypatch.context() as patch, contextlib.suppress(Killed):
        patch.setattr("prtnet.files.os.replace", mortal(os.replace))
        patch.setattr("prtnet.files.shutil.rmtree", mortal(shutil.rmtree))
        book.finish()
    placed = path.exists() and Dataset.open(path).rays == ATTRIBUTES["rays"]
    kept = {Dataset.open(folder).rays for folder in tmp_path.iterdir()}
    assert placed or not old or 1 in kept
    assert placed or writer(path).missing() == []
    assert write(path).rays == ATTRIBUTES["rays"]  # and the same command line mends it all
    assert [folder.name for folder in tmp_path.iterdir()] == ["set.zarr"]
    assert not (path / MARKERS).exists()


def edit(path: Path, **attributes: object) -> None:
    """Attributes as a dataset without checksums of its headers has them; None for none."""
    header = path / "zarr.json"
    content = json.loads(header.read_text())
    every = content["attributes"] | attributes | {HEADERS: None}
    content["attributes"] = {n: value for n, value in every.items() if value is not None}
    header.write_text(json.dumps(content))


def test_a_dataset_without_checksums_of_its_headers_is_read(dataset: Dataset) -> None:
    edit(dataset.path)
    np.testing.assert_array_equal(Dataset.open(dataset.path).poses[:], whole().pose)


def test_datasets_of_old_leave_chunks_of_zeros_out(dataset: Dataset) -> None:
    edit(dataset.path)
    (dataset.path / "rest_pose/c/0").unlink()
    assert not Dataset.open(dataset.path).rest_pose.any()


def complaint(path: Path) -> str:
    with pytest.raises(PrtnetError) as caught:
        Dataset.open(path)
    return str(caught.value)


def test_what_is_no_dataset(tmp_path: Path) -> None:
    assert "does not exist" in complaint(tmp_path / "missing.zarr")
    (tmp_path / "file").write_text("hello")
    assert "is not a dataset" in complaint(tmp_path / "file")
    (tmp_path / "folder").mkdir()
    assert "is not a dataset" in complaint(tmp_path / "folder")
    zarr.create_group(str(tmp_path / "other.zarr"), zarr_format=3)
    assert "is not a dataset" in complaint(tmp_path / "other.zarr")
    zarr.create_array(str(tmp_path / "array.zarr"), shape=(3,), dtype="f4")
    assert "is not a dataset" in complaint(tmp_path / "array.zarr")
    (tmp_path / "other.zarr" / "zarr.json").write_text("{")
    assert "is not a dataset" in complaint(tmp_path / "other.zarr")


def test_a_complaint_is_no_longer_than_a_line_can_be(dataset: Dataset) -> None:
    edit(dataset.path, format_version=list(range(1000)))
    assert len(complaint(dataset.path)) < 1500
    assert complaint(dataset.path).endswith("generate it again")


def test_another_format_version(dataset: Dataset) -> None:
    edit(dataset.path, format_version=FORMAT_VERSION + 1)
    assert f"of another format version ({FORMAT_VERSION + 1}" in complaint(dataset.path)


@pytest.mark.parametrize("name", ["visibility", "sources", "rest_pose", "joint_weights"])
def test_a_missing_array(dataset: Dataset, name: str) -> None:
    shutil.rmtree(dataset.path / name)
    assert name in complaint(dataset.path)


def test_a_missing_attribute(dataset: Dataset) -> None:
    edit(dataset.path, held_out=None)
    assert "held_out" in complaint(dataset.path)


@pytest.mark.parametrize("chunk", ["visibility/c/1/0/0", "clip/c/0", "rest_positions/c/0/0"])
def test_a_missing_chunk(dataset: Dataset, chunk: str) -> None:
    (dataset.path / chunk).unlink()
    assert "is not whole" in complaint(dataset.path)


def test_a_truncated_chunk(dataset: Dataset) -> None:
    chunk = dataset.path / "visibility/c/1/0/0"
    chunk.write_bytes(chunk.read_bytes()[:-10])
    rows = Dataset.open(dataset.path).visibility
    np.testing.assert_array_equal(rows[:4], whole().visibility[:4])
    with pytest.raises(PrtnetError, match="'visibility' is damaged in block 1;"):
        rows[4:8]


def test_a_truncated_chunk_of_what_no_pose_changes(dataset: Dataset) -> None:
    chunk = dataset.path / "rest_pose/c/0"
    chunk.write_bytes(chunk.read_bytes()[:-4])
    assert "'rest_pose' is damaged" in complaint(dataset.path)


def test_folders_that_are_no_datasets_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.png").write_text("cat")
    (tmp_path / "file").write_text("text")
    for path in (tmp_path / "photos", tmp_path / "file", tmp_path):
        with pytest.raises(PrtnetError, match="exists and is not a dataset"):
            writer(path)
    assert (tmp_path / "photos" / "cat.png").read_text() == "cat"


def test_a_folder_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(PrtnetError, match="cannot be written"):
        writer(tmp_path / "no" / "set.zarr")
