from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from prtnet.errors import PrtnetError
from prtnet.exr import read_exr

PICTURE = np.random.default_rng(0).uniform(0, 40, (6, 12, 3)).astype(np.float32)


def write(path: Path, channels: dict[str, Any], **header: Any) -> Path:
    # The library writes memory as it lies, whatever the strides.
    whole = {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, whole).write(str(path))
    return path


def refused(path: Path) -> str:
    with pytest.raises(PrtnetError) as caught:
        read_exr(path)
    assert caught.value.subject == str(path)
    return caught.value.message


@pytest.mark.parametrize("compression", ["NO", "ZIP", "PIZ", "RLE"])
def test_what_was_written_comes_back(tmp_path, compression):
    kind = getattr(OpenEXR, f"{compression}_COMPRESSION")
    path = write(tmp_path / "a.exr", {"RGB": PICTURE}, compression=kind)
    read = read_exr(path)
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, PICTURE)


def test_half_floats_and_further_channels(tmp_path):
    half = PICTURE.astype(np.float16)
    rgba = np.concatenate([half, np.zeros((6, 12, 1), np.float16)], axis=-1)
    depth = np.ones((6, 12), np.uint32)
    read = read_exr(write(tmp_path / "a.exr", {"RGBA": rgba, "Z": depth}))
    assert read.dtype == np.float32
    np.testing.assert_array_equal(read, half.astype(np.float32))


def test_luminance_is_grey(tmp_path):
    read = read_exr(write(tmp_path / "a.exr", {"Y": PICTURE[..., 0]}))
    np.testing.assert_array_equal(read, PICTURE[..., :1].repeat(3, axis=-1))


def test_the_first_part_counts(tmp_path):
    parts = [
        OpenEXR.Part({"name": name, "type": OpenEXR.scanlineimage}, {"RGB": pixels})
        for name, pixels in (("one", PICTURE), ("two", PICTURE + 1))
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr"), PICTURE)


def test_tiles(tmp_path):
    tiles = OpenEXR.TileDescription()
    path = write(tmp_path / "a.exr", {"RGB": PICTURE}, type=OpenEXR.tiledimage, tiles=tiles)
    np.testing.assert_array_equal(read_exr(path), PICTURE)


def test_channels_that_are_missing_are_named(tmp_path):
    plane = PICTURE[..., 0]
    message = refused(write(tmp_path / "a.exr", {"R": plane, "B": plane}))
    assert "no channel G (it has B, R)" in message
    assert "no channel R" in refused(write(tmp_path / "b.exr", {"diffuse.R": plane}))
    # Luminance with chroma is colour in another form.
    chroma = {"Y": plane, "RY": plane, "BY": plane}
    assert "no channel R (it has BY, RY, Y)" in refused(write(tmp_path / "c.exr", chroma))


def test_whole_numbers_are_no_radiance(tmp_path):
    whole = np.ones((6, 12, 3), np.uint32)
    assert "whole numbers" in refused(write(tmp_path / "a.exr", {"RGB": whole}))


def test_cropped_pictures_are_refused(tmp_path):
    window = (np.array([0, 0], np.int32), np.array([23, 11], np.int32))
    message = refused(write(tmp_path / "a.exr", {"RGB": PICTURE}, displayWindow=window))
    assert "cropped" in message


def test_channels_of_fewer_pixels_are_refused(tmp_path):
    path = write(tmp_path / "a.exr", {"RGB": PICTURE})
    data = path.read_bytes()
    # In the list of channels: name, type 2 (float), four bytes, then the sampling along x and y.
    whole = b"G\0" + struct.pack("<4i", 2, 0, 1, 1)
    assert data.count(whole) == 1
    path.write_bytes(data.replace(whole, b"G\0" + struct.pack("<4i", 2, 0, 2, 1)))
    assert "fewer pixels" in refused(path)
