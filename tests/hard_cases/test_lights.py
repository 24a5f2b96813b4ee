"""Lights at their worst: black, blinding, a single bright texel, damaged files, numbers missing."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from prtnet import sh
from prtnet.environment import Environment, environment
from prtnet.equirectangular import Picture
from prtnet.errors import PrtnetError
from prtnet.exr import read_exr
from prtnet.light import load_light
from prtnet.zh import relative_error
from prtnet.zh_fit import fit_lobes
from tests.hard_cases.measured import above, below, close, equal, finite, refuses, says
from tests.prtnet.test_exr import PICTURE, refused, write
from tests.prtnet.test_hdr import encode, flat


def sun(row: int, peak: float = 70_000.0) -> np.ndarray:
    texels = np.zeros((64, 128, 3), np.float32)
    texels[row, 40] = peak
    return texels


@pytest.mark.parametrize("row", [0, 20, 63])
@pytest.mark.parametrize("suffix", ["exr", "hdr"])
def test_a_sun_of_one_texel_has_its_energy(tmp_path, row, suffix):
    path = tmp_path / f"sun.{suffix}"
    if suffix == "exr":
        write(path, {"RGB": sun(row)})
    else:
        path.write_bytes(flat(encode(sun(row))))
    light, cut = load_light(path), 1e-6 if suffix == "exr" else 1 / 128
    # Its solid angle: the width 2π/W times the difference of cos θ of its edges.
    upper, lower = (math.cos(math.pi * edge / 64) for edge in (row, row + 1))
    energy = 70_000 * (2 * math.pi / 128) * (upper - lower)
    close(light[0] * math.sqrt(4 * math.pi), energy, rtol=cut)
    # As a point light: energy · y(s) at the texel's middle.
    theta, phi = math.pi * (row + 0.5) / 64, 2 * math.pi * 40.5 / 128
    s = [-math.sin(theta) * math.cos(phi), math.cos(theta), -math.sin(theta) * math.sin(phi)]
    point = energy * sh.evaluate(np.array(s), 4)
    close(light[:, 1], point, atol=0.03 * np.abs(point).max())
    close(environment(path).radiance(np.array([s])), 70_000, rtol=cut)
    # One lobe holds what is round.
    lobes = fit_lobes(light.T, 1)
    below(relative_error(light.T, lobes), 0.01)
    close(lobes.axes[:, 0], [s] * 3, atol=0.03)


def test_a_black_picture_is_black(tmp_path):
    write(tmp_path / "night.exr", {"RGB": np.zeros((8, 16, 3), np.float32)})
    night = environment(tmp_path / "night.exr")
    equal(night.harmonics(4), 0)
    equal(night.radiance(sh.fibonacci_sphere(20)), 0)
    equal(fit_lobes(load_light(tmp_path / "night.exr").T).coefficients, 0)


@pytest.mark.parametrize(("bad", "name"), [(np.nan, "nan"), (np.inf, "inf"), (-np.inf, "-inf")])
def test_the_first_bad_texel_is_named(tmp_path, bad, name):
    texels = np.ones((8, 16, 3), np.float32)
    texels[2, 5, 1] = texels[2, 9, 0] = texels[6, 0, 2] = bad
    write(tmp_path / "bad.exr", {"RGB": texels})
    with refuses() as caught:
        environment(tmp_path / "bad.exr")
    says(str(caught.value), f"holds {name} in row 2, column 5")


def test_light_beyond_what_can_be_computed_with(tmp_path):
    write(tmp_path / "nova.exr", {"RGB": np.full((8, 16, 3), 1e31, np.float32)})
    with refuses(match="too bright"):
        environment(tmp_path / "nova.exr")


def test_a_picture_of_two_texels():
    texels = np.array([[[1.0, 0, 0], [0, 1, 0]]])
    light = Environment(Picture(texels))
    close(light.harmonics(1)[0, :2], math.sqrt(math.pi), rtol=1e-12)
    finite(light.radiance(np.array([[0.0, 1, 0], [0, -1, 0], [1, 0, 0]])))


def test_files_that_are_something_else(tmp_path):
    path = tmp_path / "x.exr"
    for data in (b"", b"abc", b"#?RADIANCE\n", b"\x89PNG\r\n"):
        path.write_bytes(data)
        says(refused(path), "not an OpenEXR")
    says(refused(tmp_path), "cannot be read")
    path.write_bytes(b"\x76\x2f\x31\x01" + b"x" * 100)
    says(refused(path), "damaged")


def test_files_cut_short(tmp_path):
    data = write(tmp_path / "whole.exr", {"RGB": PICTURE}).read_bytes()
    path = tmp_path / "cut.exr"
    for length in range(4, len(data), 37):
        path.write_bytes(data[:length])
        says(refused(path), "damaged or cut short")


def test_gigantic_pictures_are_refused_before_they_are_read(tmp_path):
    data = write(tmp_path / "whole.exr", {"RGB": PICTURE}).read_bytes()
    start = data.index(b"dataWindow\0box2i\0") + 17 + 4
    size = struct.pack("<4i", 0, 0, (1 << 29) - 1, (1 << 28) - 1)
    path = tmp_path / "large.exr"
    path.write_bytes(data[:start] + size + data[start + 16 :])
    says(refused(path), "at most 11585x5792")


def test_flipped_bytes_give_a_picture_or_an_error(tmp_path):
    data = write(tmp_path / "whole.exr", {"RGB": PICTURE}).read_bytes()
    rng = np.random.default_rng(0)
    path, read = tmp_path / "flipped.exr", 0
    for _ in range(300):
        broken = bytearray(data)
        for place in rng.integers(4, len(data), 2):
            broken[place] = rng.integers(256)
        path.write_bytes(broken)
        try:
            assert read_exr(path).ndim == 3
            read += 1
        except PrtnetError:
            continue
    above(read, 0)
    below(read, 300)
