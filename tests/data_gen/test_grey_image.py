from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from data_gen.grey_image import read_grey
from prtnet.errors import PrtnetError


def complaint(path: Path, texels: tuple[int, int] | None = None) -> str:
    with pytest.raises(PrtnetError) as caught:
        read_grey(path, texels)
    assert "\n" not in str(caught.value)
    return caught.value.message


def write_exr(path: Path, grey: np.ndarray) -> Path:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": grey.astype(np.float32)}).write(str(path))
    return path


def test_bytes_with_the_bottom_row_first(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(np.array([[0, 255], [51, 102]], dtype=np.uint8)).save(path)
    np.testing.assert_allclose(read_grey(path), [[0.2, 0.4], [0.0, 1.0]])


def test_sixteen_bits_and_floats(tmp_path: Path) -> None:
    deep = tmp_path / "a.png"
    Image.fromarray(np.array([[0, 65535, 257]], dtype=np.uint16)).save(deep)
    np.testing.assert_allclose(read_grey(deep), [[0, 1, 257 / 65535]])
    real = tmp_path / "a.tif"
    Image.fromarray(np.array([[-2.5, 7.25]], dtype=np.float32)).save(real)
    np.testing.assert_array_equal(read_grey(real), [[-2.5, 7.25]])
    light = write_exr(tmp_path / "a.exr", np.array([[0.5, -np.inf]]))
    np.testing.assert_allclose(read_grey(light), [[0.5, -np.inf]], rtol=1e-6)


def test_whole_numbers_beyond_sixteen_bits_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    Image.fromarray(np.array([[0, 70000]], dtype=np.int32)).save(path)
    assert "beyond 16 bits" in complaint(path)


def test_colours_and_palettes_become_grey(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(np.array([[[0, 255, 0, 9]]], dtype=np.uint8)).save(path)
    np.testing.assert_allclose(read_grey(path), [[0.7152]])
    Image.new("P", (3, 2), 0).save(path)
    assert read_grey(path).shape == (2, 3)


def test_fewer_and_more_texels(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(np.array([[0, 255], [0, 255]], dtype=np.uint8)).save(path)
    np.testing.assert_allclose(read_grey(path, (1, 1)), [[0.5]], atol=1e-6)
    assert read_grey(path, (8, 4)).shape == (4, 8)
    np.testing.assert_array_equal(read_grey(path, (2, 2)), read_grey(path))


def test_numbers_that_are_none(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    assert "2 values that are not numbers" in complaint(
        write_exr(path, np.array([[np.nan, 1], [1, np.nan]]))
    )
    assert "upwards" in complaint(write_exr(path, np.array([[np.inf, 1]])))
    assert "no finite height" in complaint(write_exr(path, np.array([[-np.inf, -np.inf]])))
    assert "cannot be resampled" in complaint(write_exr(path, np.array([[-np.inf, 1]])), (1, 1))
    Image.fromarray(np.array([[np.nan]], dtype=np.float32)).save(tmp_path / "a.tif")
    assert "1 values" in complaint(tmp_path / "a.tif")


def test_files_that_are_no_pictures(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    assert "cannot be read" in complaint(path)
    path.write_bytes(b"")
    assert "no picture" in complaint(path)
    Image.fromarray(np.zeros((64, 64), dtype=np.uint8)).save(path)
    path.write_bytes(path.read_bytes()[:60])
    assert "cannot be read" in complaint(path)


def test_too_many_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.png"
    Image.fromarray(np.zeros((64, 64), dtype=np.uint8)).save(path)
    monkeypatch.setattr("data_gen.grey_image.LARGEST", 4000)
    assert "too many pixels" in complaint(path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 1000)
    assert "too many pixels" in complaint(path)


def test_a_part_that_claims_gigabytes_takes_no_room(tmp_path: Path) -> None:
    """What is there of it is read: it holds the whole picture."""
    path = tmp_path / "a.png"
    Image.fromarray(np.full((6, 8), 51, dtype=np.uint8)).save(path)
    bytes_ = path.read_bytes()
    at = bytes_.index(b"IDAT") - 4
    path.write_bytes(bytes_[:at] + (2**31 + 5).to_bytes(4, "big") + bytes_[at + 4 :])
    tracemalloc.start()
    try:
        np.testing.assert_allclose(read_grey(path), np.full((6, 8), 0.2))
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()
