from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prtnet.components import BITS, coding, from_bytes, leading_bits, to_bytes

ORDER = 3


def some(count=12, slots=5, seed=0, scale=1.0):
    rng = np.random.default_rng(seed)
    size = ORDER**2
    basis = rng.normal(size=(count, slots, size)) * np.linspace(1.0, 0.2, size) * scale
    bits, orders = rng.choice([4, 8], count), rng.integers(1, ORDER + 1, count)
    basis = basis.reshape(count, slots * size).astype(np.float32)
    return basis, coding(basis, size, bits, orders)


@given(count=st.integers(0, 9), slots=st.integers(1, 4), seed=st.integers(0, 99))
def test_what_was_decoded_is_coded_alike(count, slots, seed):
    basis, how = some(count, slots, seed, scale=10.0 ** (seed % 9 - 4))
    coded = how.encode(basis)
    again = how.encode(coded.array())
    assert np.array_equal(again.values, coded.values)
    assert np.array_equal(again.scale, coded.scale)
    assert np.array_equal(again.array(), coded.array())
    back = from_bytes(to_bytes(coded), coded.scale, how, slots)
    assert np.array_equal(back.values, coded.values)


def test_integers_fill_their_bits_and_end_with_the_bands():
    basis, how = some()
    coded = how.encode(basis)
    largest = np.abs(coded.values).max(axis=1)
    assert largest.tolist() == [BITS[bits] for bits in how.bits]
    shaped = coded.values.reshape(len(how), -1, ORDER**2)
    for row, order in zip(shaped, how.orders, strict=True):
        assert not row[:, order**2 :].any()
        assert row[:, : order**2].any()


@pytest.mark.parametrize(("bits", "most"), [(4, 0.13), (8, 0.01)])
def test_rounding_is_as_small_as_the_bits_allow(bits, most):
    basis, _ = some(count=40, slots=50)
    coded = coding(basis, ORDER**2, np.full(40, bits)).encode(basis)
    error = np.linalg.norm(coded.array() - basis) / np.linalg.norm(basis)
    assert most / 4 < error < most


def test_a_shared_profile_and_a_clipped_range_lower_the_error():
    basis, _ = some(count=40, slots=50)
    how = coding(basis, ORDER**2, np.full(40, 4))
    flat = dataclasses.replace(how, profile=np.ones(ORDER**2, dtype=np.float32))
    step = np.abs(basis).max(axis=1, keepdims=True) / BITS[4]
    plain = np.rint(basis / step) * step
    errors = [np.linalg.norm(a - basis) for a in (*(h.encode(basis).array() for h in (how, flat)),
                                                  plain)]  # fmt: skip
    assert errors[0] < 0.9 * errors[1] < 0.9 * errors[2]


def test_bytes_are_half_a_component_or_one_each():
    basis, how = some()
    orders = how.orders.astype(int)
    width = 5 * orders**2
    expected = np.where(how.bits == 4, -(-width // 2), width).sum()
    assert len(to_bytes(how.encode(basis))) == expected


def test_bytes_that_do_not_fit_are_told():
    basis, how = some()
    coded = how.encode(basis)
    data = to_bytes(coded)
    for wrong in (data[:-1], np.append(data, data[:1]), data[:0]):
        with pytest.raises(ValueError, match=r"does not fit|is shorter"):
            from_bytes(wrong, coded.scale, how, 5)
    with pytest.raises(ValueError, match="does not fit"):
        from_bytes(data, coded.scale[1:], how, 5)


def test_components_of_zeros_and_of_extremes_stay_finite():
    basis = np.zeros((4, ORDER**2), dtype=np.float32)
    basis[1], basis[2, 0], basis[3] = 1e30, 1e-30, np.finfo(np.float32).tiny
    how = coding(basis, ORDER**2, np.array([4, 8, 4, 8]))
    array = how.encode(basis).array()
    assert np.isfinite(array).all()
    assert not array[0].any()


def test_what_explains_much_has_eight_bits():
    energy = np.array([1e4, 150.0, 6.0, *20 * [1.0], 0.0])
    assert leading_bits(energy).tolist() == [8, 8, *22 * [4]]
    energy[-2] = 1e-9  # one that brings nothing changes nothing
    assert leading_bits(energy).tolist() == [8, 8, *22 * [4]]
    assert leading_bits(np.zeros(3)).tolist() == [4, 4, 4]
    assert leading_bits(np.zeros(0)).tolist() == []


def test_classes_take_each_component_once():
    _, how = some(count=30)
    rows = np.concatenate([rows for *_, rows in how.classes()])
    assert sorted(rows.tolist()) == list(range(30))
