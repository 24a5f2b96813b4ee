from __future__ import annotations

from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from prtnet.errors import PrtnetError
from prtnet.hdr import read_hdr

HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def encode(linear: np.ndarray) -> np.ndarray:
    """RGBE bytes (H, W, 4) by the definition: mantissas over a common power of two."""
    exponent = np.frexp(linear.max(axis=-1))[1]
    mantissa = np.floor(linear * np.ldexp(256.0, -exponent)[..., None])
    return np.concatenate([mantissa, exponent[..., None] + 128], axis=-1).astype(np.uint8)


def flat(rgbe: np.ndarray, resolution: str = "-Y {} +X {}") -> bytes:
    return HEADER + resolution.format(*rgbe.shape[:2]).encode() + b"\n" + rgbe.tobytes()


def coded(rgbe: np.ndarray) -> bytes:
    """Run-length code with runs and literals of every length up to the largest."""
    out = HEADER + b"-Y %d +X %d\n" % rgbe.shape[:2]
    for row in rgbe:
        out += b"\2\2" + len(row).to_bytes(2, "big")
        for plane in row.T:
            start = 0
            while start < len(plane):
                same = start + 1
                while same < len(plane) and plane[same] == plane[start] and same - start < 127:
                    same += 1
                if same - start > 1:
                    out += bytes([128 + same - start, plane[start]])
                else:
                    same = min(start + 128, len(plane))
                    out += bytes([same - start]) + plane[start:same].tobytes()
                start = same
    return out


def save(folder: Path, data: bytes) -> Path:
    path = folder / "light.hdr"
    path.write_bytes(data)
    return path


@pytest.fixture
def linear() -> np.ndarray:
    rng = np.random.default_rng(3)
    picture = np.exp(rng.normal(0, 4, (5, 300, 1))) * rng.uniform(0.5, 1, (5, 300, 3))
    picture[:, 40:250] = [0.5, 0.25, 4.0]  # long runs
    return picture


@pytest.mark.parametrize("write", [flat, coded])
def test_both_codes_give_the_picture_back(tmp_path, linear, write):
    read = read_hdr(save(tmp_path, write(encode(linear))))
    assert read.dtype == np.float32
    # A mantissa has eight bits, cut off: off by less than one of 128 in the brightest channel.
    assert (np.abs(read - linear).max(-1) <= linear.max(-1) / 128).all()
    assert np.array_equal(read[:, 40:250], np.broadcast_to([0.5, 0.25, 4.0], (5, 210, 3)))


def test_exponent_zero_is_black(tmp_path):
    rgbe = np.full((1, 2, 4), 200, dtype=np.uint8)
    rgbe[0, 0, 3] = 0
    read = read_hdr(save(tmp_path, flat(rgbe)))
    assert np.array_equal(read[0, 0], [0, 0, 0])
    assert np.array_equal(read[0, 1], [200 * 2.0**64] * 3)


def test_the_sign_of_the_resolution_says_where_the_first_pixel_is(tmp_path, linear):
    rgbe = encode(linear)
    upright = read_hdr(save(tmp_path, flat(rgbe)))
    assert np.array_equal(read_hdr(save(tmp_path, flat(rgbe, "+Y {} +X {}"))), upright[::-1])
    assert np.array_equal(read_hdr(save(tmp_path, flat(rgbe, "-Y {} -X {}"))), upright[:, ::-1])


def test_exposures_are_taken_out(tmp_path, linear):
    data = flat(encode(linear))
    exposed = data.replace(b"FORMAT", b"EXPOSURE=4\nEXPOSURE= 0.5\nFORMAT")
    plain = read_hdr(save(tmp_path, data))
    assert np.array_equal(read_hdr(save(tmp_path, exposed)), plain / 2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: b"#!RADIANCE" + d[10:], "not a Radiance"),
        (lambda d: d[:0], "not a Radiance"),
        (lambda d: d[:30], "height"),
        (lambda d: d[:-1], "ends before"),
        (lambda d: d.replace(b"-Y 5 +X 300", b"+X 300 -Y 5"), "height"),
        (lambda d: d.replace(b"-Y 5", b"-Y 0"), "at least one pixel"),
        (lambda d: d.replace(b"-Y 5", b"-Y 999999").replace(b"+X 300", b"+X 999999"), "at most"),
        (lambda d: d.replace(b"32-bit_rle_rgbe", b"32-bit_rle_xyze"), "not in RGB"),
        (lambda d: d.replace(b"FORMAT", b"EXPOSURE=0\nFORMAT"), "EXPOSURE"),
        (lambda d: d.replace(b"FORMAT", b"EXPOSURE=nan\nFORMAT"), "EXPOSURE"),
        (lambda d: d.replace(b"FORMAT", b"EXPOSURE=bright\nFORMAT"), "EXPOSURE"),
    ],
)
@pytest.mark.parametrize("write", [flat, coded])
def test_damage_is_told_in_one_line(tmp_path, linear, write, change, message):
    with pytest.raises(PrtnetError, match=message):
        read_hdr(save(tmp_path, change(write(encode(linear)))))


@pytest.mark.parametrize("run", [b"\x01\x05\x00", bytes([128 + 12, 7])])
def test_a_run_that_is_empty_or_crosses_components_is_damage(tmp_path, run):
    row = b"\2\2\0\x09" + run + bytes([137, 1]) * 4
    with pytest.raises(PrtnetError, match="damaged"):
        read_hdr(save(tmp_path, HEADER + b"-Y 1 +X 9\n" + row))


def test_the_old_run_length_code_is_refused(tmp_path):
    rgbe = np.array([[[9, 200, 9, 128], [1, 1, 1, 1]]], dtype=np.uint8)
    with pytest.raises(PrtnetError, match="before 1991"):
        read_hdr(save(tmp_path, flat(rgbe)))


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(PrtnetError, match="cannot be read"):
        read_hdr(tmp_path / "none.hdr")


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_bytes_whatever_crash_it(tmp_path, linear, data):
    whole = bytearray(coded(encode(linear[:, :, :])))
    for _ in range(data.draw(st.integers(0, 8))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(whole)))
    try:
        read = read_hdr(save(tmp_path, bytes(whole[:end])))
    except PrtnetError:
        return
    assert read.ndim == 3
    assert (read >= 0).all()
