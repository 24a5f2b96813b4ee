from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet.storage import MOST, Packing, pack, quantise, rounded, unpack

OFFSET = np.array([3.5, 0.0, 0.0], dtype=np.float32)
PACKINGS = {
    "one scale a row": Packing("int8"),
    "one scale a coefficient": Packing("int8", axis=(0, 1), period=3, offset=OFFSET),
    "a scale for each row and coefficient": Packing("int8", period=3),
    "halves": Packing("float16", axis=(0, 1)),
    "halves with an offset": Packing("float16", axis=(0, 1), period=3, offset=OFFSET),
}


def table(seed=0, magnitude=1.0):
    rng = np.random.default_rng(seed)
    return (magnitude * rng.normal(size=(7, 12)) * rng.uniform(0.1, 9, (7, 1))).astype(np.float32)


@pytest.mark.parametrize("packing", PACKINGS.values(), ids=PACKINGS)
@given(st.integers(0, 50), st.sampled_from([1e-6, 1.0, 1e6]))
def test_what_was_read_back_is_stored_the_same(packing, seed, magnitude):
    once = quantise(table(seed, magnitude), packing)
    twice = quantise(once.array(), packing)
    assert np.array_equal(twice.array(), once.array())
    if packing.kind == "int8":
        assert np.array_equal(twice.values, once.values)
        assert np.array_equal(twice.scale, once.scale)


def test_coarse_scales_survive_the_rounding_of_the_values():
    rng = np.random.default_rng(0)
    array = (rng.normal(size=(20_000, 12)) * rng.uniform(0.01, 9, (20_000, 1))).astype(np.float32)
    packing = Packing("int8", period=3, offset=OFFSET)
    once = quantise(array, packing)
    assert np.array_equal(quantise(once.array(), packing).scale, once.scale)


def test_eight_bits_err_by_half_a_step_of_their_row():
    array = table()
    stored = quantise(array, Packing("int8"))
    assert stored.values.dtype == np.int8
    assert stored.scale.shape == (7, 1)
    assert np.abs(stored.values).max(axis=1).tolist() == [MOST] * 7
    step = np.abs(array).max(axis=1, keepdims=True) / MOST
    error = np.abs(stored.array() - array) / step
    assert 0.3 < error.max() < 0.57  # the largest value of a row also bears its scale's rounding


def test_a_scale_for_every_coefficient_follows_its_own_size():
    array = table() * np.tile([1.0, 1e-3, 1e-6], 4).astype(np.float32)
    stored = quantise(array, Packing("int8", axis=(0, 1), period=3))
    assert stored.scale.shape == (1, 3)
    error = (stored.array() - array).reshape(-1, 3)
    size = np.abs(array.reshape(-1, 3)).max(axis=0)
    assert (np.abs(error).max(axis=0) < 0.6 * size / MOST).all()


def test_deviations_from_an_offset_are_finer_than_the_values():
    array = np.tile(OFFSET, (5, 4)) + 0.01 * table()[:5]
    plain = rounded(array, Packing("int8", axis=(0, 1), period=3))
    finer = rounded(array, Packing("int8", axis=(0, 1), period=3, offset=OFFSET))
    assert np.abs(finer - array).max() < 0.2 * np.abs(plain - array).max()
    still = np.tile(OFFSET, (2, 4))
    assert np.array_equal(rounded(still, PACKINGS["one scale a coefficient"]), still)


def test_halves_reach_any_magnitude():
    for magnitude in (1e-30, 1.0, 1e30):
        array = table(magnitude=magnitude)
        stored = quantise(array, Packing("float16", axis=(0, 1)))
        assert stored.values.dtype == np.float16
        assert np.abs(stored.array() / array - 1.0).max() < 2.0**-10


def test_zeros_and_empty_arrays_stay():
    for packing in PACKINGS.values():
        for shape in ((3, 6), (0, 6)):
            array = np.zeros(shape, dtype=np.float32)
            if packing.offset is not None:
                array = array + np.tile(packing.offset, 2)
            assert np.array_equal(rounded(array, packing), array)


def test_packed_arrays_come_back_and_others_are_left_alone():
    arrays = {"a": table(), "b": np.arange(4), "c": table(1)}
    packings = {
        "a": PACKINGS["one scale a coefficient"],
        "c": Packing("float32"),
        "d": Packing("int8"),
    }
    packed = pack(arrays, packings)
    assert set(packed) == {"a", "b", "c", "scale.a", "offset.a"}
    plain = unpack(packed)
    assert set(plain) == {"a", "b", "c"}
    assert np.array_equal(plain["a"], rounded(arrays["a"], packings["a"]))
    assert plain["c"] is arrays["c"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scale.a", np.ones((1, 5), np.float32)),
        ("scale.a", np.ones(3, np.float32)),
        ("scale.a", np.ones((2, 3), np.float32)),
        ("scale.a", np.ones((1, 0), np.float32)),
        ("offset.a", np.ones(2, np.float32)),
        ("scale.z", np.ones((1, 3), np.float32)),
    ],
)
def test_scales_that_do_not_fit_are_told(name, value):
    packed = pack({"a": table()}, {"a": PACKINGS["one scale a coefficient"]})
    with pytest.raises(ValueError):  # noqa: PT011 - NumPy says some of it
        unpack(packed | {name: value})


@pytest.mark.parametrize(
    ("values", "dtype"),
    [([0, 255], np.uint8), ([-1, 255], np.int16), ([0, 256], np.int16), ([0, 40000], np.int32)],
)
def test_indices_take_the_bytes_they_need(values, dtype):
    arrays = {"index": np.array(values, dtype=np.int32), "none": np.zeros((0, 2), dtype=np.int32)}
    packed = pack(arrays, {})
    assert packed["index"].dtype == dtype
    back = unpack(packed)
    assert back["index"].dtype == back["none"].dtype == np.int32
    assert back["index"].tolist() == values
