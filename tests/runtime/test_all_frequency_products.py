"""Fast products and sums against the reference: full and sparse columns, all of a light or some."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prtnet.all_frequency import AllFrequencyField
from prtnet.cube_map import segment_coefficients
from prtnet.sparse_columns import decode, encode
from runtime import all_frequency_products
from runtime.all_frequency import gathered, transformed
from runtime.all_frequency_products import Products, Sums, vertex_runs
from tests.all_frequency import no_segment, random_field
from tests.runtime.test_all_frequency import random_light


def wavelets(rows: int, **options) -> AllFrequencyField:
    """A random field whose columns are emptier the finer their wavelets are."""
    field = random_field(rows=rows, **options)
    width = (field.size // 2) ** 2
    segments = []
    for number, one in enumerate(field.segments):
        dense = decode(one.representatives)
        place = np.arange(dense.shape[1]) % width
        drawn = np.random.default_rng(number).random(dense.shape)
        dense[drawn < place / width] = 0
        dense[:, place == 0] = 7  # of a full column
        dense[:, place == width - 1] = 0  # and an empty one
        segments.append(dataclasses.replace(one, representatives=encode(dense)))
    return dataclasses.replace(field, segments=tuple(segments))


def close(got: np.ndarray, want: np.ndarray) -> None:
    assert got.dtype == np.float32
    np.testing.assert_allclose(got, want, rtol=1e-4, atol=2e-6 * np.abs(want).max())


def kept(light: np.ndarray, share: float) -> np.ndarray:
    """The largest coefficients of a light, of a share of all, the others zero."""
    size = np.abs(light).max(axis=2)
    return light * (size > np.quantile(size, 1.0 - share))[..., None]


@pytest.mark.parametrize("full", [0.0, 0.2, 2.0], ids=["full", "both", "sparse"])
@pytest.mark.parametrize(("rows", "size", "terms"), [(3, 8, 4), (1, 4, 1), (2, 16, 3)])
@pytest.mark.parametrize("share", [1.0, 0.5, 0.1, 0.005, 0.0])
def test_products_are_those_of_the_reference(rows, size, terms, full, share, monkeypatch):
    monkeypatch.setattr(all_frequency_products, "FULL", full)
    field = wavelets(rows, seed=rows, size=size, terms=terms)
    light = segment_coefficients(random_light(size))
    light = light if share == 1.0 else kept(light, share)
    close(Products(field)(light), transformed(field, light))


def test_columns_are_divided_by_how_full_they_are(monkeypatch):
    monkeypatch.setattr(all_frequency_products, "FULL", 0.2)
    found = Products(wavelets(3, seed=3))
    assert any(len(one.places) for one in found.full)
    assert found.sparse.nnz
    width = found.sparse.shape[1] // 24
    for number, one in enumerate(found.full):
        assert not np.isin(found.sparse.indices, number * width + one.places).any()


def test_a_light_may_change_in_any_order():
    field = wavelets(3)
    products = Products(field)
    light = segment_coefficients(random_light(field.size))
    some = kept(light, 0.1)
    for each in (light, some, np.zeros_like(light), light, some):
        close(products(each), transformed(field, each))


def test_only_lit_columns_are_read(monkeypatch):
    """Were the others read, a zero of the light would not undo what is no number."""
    monkeypatch.setattr(all_frequency_products, "FULL", 0.2)
    field = wavelets(2)
    light = np.zeros_like(segment_coefficients(random_light(field.size)))
    light[7, [0, 3, 9]] = 1.0
    products = Products(field)
    dark = ~light.any(axis=2)
    for known, one in zip(dark, products.full, strict=True):
        one.numbers[np.flatnonzero(known[one.places])] = np.nan
    products.sparse.data[dark.ravel()[products.sparse.indices]] = np.nan
    close(products(light), transformed(field, light))


@pytest.mark.parametrize(("rows", "terms"), [(3, 4), (1, 1), (10, 16)])
def test_sums_are_those_of_the_reference(rows, terms):
    field = random_field(rows, rows=rows, terms=terms)
    products = transformed(field, segment_coefficients(random_light(field.size)))
    close(Sums(field)(products.astype(np.float32)), gathered(field, products))


def test_segments_may_have_numbers_of_terms_of_their_own():
    few, many = random_field(5, terms=2), random_field(6, terms=5)
    segments = few.segments[:20] + many.segments[20:]
    field = dataclasses.replace(many, segments=segments)
    products = transformed(field, segment_coefficients(random_light(field.size)))
    close(Sums(field)(products.astype(np.float32)), gathered(field, products))


def test_runs_name_what_reaches_each_vertex():
    field = random_field(9, terms=2)
    runs = vertex_runs(field)
    assert runs.starts[-1] == sum(len(one.vertices) for one in field.segments)
    for vertex in range(len(field)):
        reached = [one for one in field.segments if vertex in one.vertices]
        assert runs.starts[vertex + 1] - runs.starts[vertex] == len(reached)
        for place, one in zip(range(runs.starts[vertex], runs.starts[-1]), reached, strict=False):
            own = int(np.flatnonzero(one.vertices == vertex)[0])
            np.testing.assert_array_equal(runs.weights[place], one.weights[own])


def test_a_field_that_no_light_reaches_is_black():
    field = random_field()
    empty = no_segment(field.rows * (field.size // 2) ** 2, 4)
    field = dataclasses.replace(field, segments=(empty,) * 24)
    products = Products(field)(segment_coefficients(random_light(field.size)))
    assert products.shape == (0, field.rows, 3)
    assert not Sums(field)(products).any()
