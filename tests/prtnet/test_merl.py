from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet.brdf import GGX, mirrored
from prtnet.errors import PrtnetError
from prtnet.merl import SCALE, SHAPE, bins, read_merl
from tests.prtnet.test_brdf import up

MATERIAL = GGX(diffuse=(0.1, 0.2, 0.3), specular=0.5, roughness=0.4)


def centres(rows):
    """Light and view in the middle of some bins; the inverse of ``bins``."""
    half_index, index, turn = np.unravel_index(rows, SHAPE)
    theta_half = ((half_index + 0.5) / SHAPE[0]) ** 2 * math.pi / 2.0
    theta, phi = (index + 0.5) / SHAPE[1] * math.pi / 2.0, (turn + 0.5) / SHAPE[2] * math.pi
    x, y, z = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
    half = np.stack([np.sin(theta_half), np.zeros(len(rows)), np.cos(theta_half)], axis=-1)
    c, s = half[:, 2], half[:, 0]
    light = np.stack([c * x + s * z, y, -s * x + c * z], axis=-1)
    return light, 2.0 * (light * half).sum(axis=1, keepdims=True) * half - light


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    """A file of an analytic BRDF, −1 where a direction is below the horizon."""
    path = tmp_path_factory.mktemp("merl") / "made.binary"
    size = math.prod(SHAPE)
    planes = np.empty((3, size))
    for start in range(0, size, 1 << 18):
        rows = np.arange(start, min(start + (1 << 18), size))
        light, view = centres(rows)
        value = MATERIAL(light, view)
        value[(light[:, 2] <= 0) | (view[:, 2] <= 0)] = -1.0
        planes[:, rows] = (value / SCALE).T
    with open(path, "wb") as stream:
        stream.write(np.array(SHAPE, dtype="<i4").tobytes())
        stream.write(planes.astype("<f8").tobytes())
    return path


def test_every_bin_is_found_again():
    rows = np.random.default_rng(0).integers(0, math.prod(SHAPE), 4000)
    light, view = centres(rows)
    assert np.array_equal(np.ravel_multi_index(bins(light, view), SHAPE), rows)


def test_a_measured_material_is_the_one_that_was_measured(file):
    measured = read_merl(file)
    light, view = up(4000, low=0.3), up(4000, seed=1, low=0.3)
    light[:1000] = mirrored(view[:1000])
    exact, got = MATERIAL(light, view), measured(light, view)
    assert np.abs(got - exact).max() < 0.1 * exact.max()
    assert np.linalg.norm(got - exact) < 0.02 * np.linalg.norm(exact)
    assert got == pytest.approx(measured(view, light), rel=0.2, abs=0.02)
    assert not measured(light, -view).any()
    assert (measured.table >= 0.0).all()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d[:-8], "bytes, not"),
        (lambda d: d + b"12345678", "bytes, not"),
        (lambda d: d[:6], "is no MERL"),
        (lambda d: np.array([90, 90, 90], "<i4").tobytes() + d[12:], "is no MERL"),
        (lambda d: d[:20] + np.array([np.nan], "<f8").tobytes() + d[28:], "no surface has"),
        (lambda d: d[:20] + np.array([1e300], "<f8").tobytes() + d[28:], "no surface has"),
    ],
)
def test_damaged_files_are_told(change, told, file, tmp_path):
    path = tmp_path / "damaged.binary"
    path.write_bytes(change(file.read_bytes()))
    with pytest.raises(PrtnetError, match=told):
        read_merl(path)
    with pytest.raises(PrtnetError, match="does not exist"):
        read_merl(tmp_path / "nothing.binary")
