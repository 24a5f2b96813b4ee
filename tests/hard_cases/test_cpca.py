"""Points that clusters and subspaces have too few of, or too much alike."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from prtnet.all_frequency import check_segment
from prtnet.haar import unhaar
from tests.all_frequency import dense_segment
from tests.hard_cases.measured import at_most, below, close, equal, finite
from tests.training.test_all_frequency import compressed, raw_segment
from tests.training.test_cpca import rebuilt
from training.all_frequency import CompressConfig
from training.cpca import (
    CpcaConfig,
    Subspaces,
    alternate,
    clustered_components,
    lost,
    nearest,
    subspaces,
)

ROUNDED = {"float32": 2e-6, "float64": 1e-14}  # of the energy


def points_of(count: int, dims: int, rank: int, seed: int, dtype: str = "float32") -> np.ndarray:
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(count, rank)) @ rng.normal(size=(rank, dims))).astype(dtype)


def all_clusters(points: np.ndarray, config: CpcaConfig) -> float:
    """The error; whatever is asked for, no cluster is empty and all is finite."""
    found = clustered_components(points, config)
    some = points.any(axis=1)
    count = min(config.clusters, int(some.sum()))
    assert set(found.label[some]) == set(range(count))
    equal(found.label[~some], -1)
    assert found.axes.shape[0] == count
    for array in (found.axes, found.values, found.weights):
        finite(array)
    missed = np.square(rebuilt(found) - points).sum()
    energy = np.square(points.astype(np.float64)).sum()
    close(found.error * energy, missed, 1e-3, 1e-6 * energy)
    return found.error


def left_of(points: np.ndarray, clusters: int, terms: int, affine: bool = False) -> float:
    """The share that clusters leave which are sought without a sketch, in the points' precision."""
    signal = torch.as_tensor(points)[:, None]

    def fit(label: torch.Tensor) -> Subspaces:
        return subspaces(signal, label, clusters, terms, affine)

    label = alternate(signal, torch.arange(len(points)) % clusters, fit, nearest, 12)
    assert len(label.unique()) == clusters
    found = fit(label)
    left = lost(signal, found)
    assert found.values.dtype == found.axes.dtype == left.dtype == signal.dtype
    for numbers in (found.values, found.axes, left):
        finite(numbers)
    energy = signal.double().square().sum()
    return float(left.gather(1, label[:, None]).double().sum().abs() / energy)


@given(
    st.integers(0, 12),
    st.integers(1, 9),
    st.integers(1, 5),
    st.integers(1, 20),
    st.integers(0, 6),
    st.booleans(),
    st.integers(0, 5),
)
@settings(max_examples=60)
def test_any_numbers_of_anything(
    count: int, dims: int, rank: int, clusters: int, terms: int, affine: bool, seed: int
) -> None:
    all_clusters(points_of(count, dims, rank, seed), CpcaConfig(clusters, terms, affine))


def test_fewer_points_than_clusters() -> None:
    """Each is its own cluster, exactly."""
    below(all_clusters(points_of(5, 40, 5, 0), CpcaConfig(30, 16)), 1e-9)
    below(all_clusters(points_of(5, 40, 5, 0), CpcaConfig(30, 1)), 1e-9)


@pytest.mark.parametrize("terms", [1, 16])
def test_as_many_points_as_clusters(terms: int, dtype: str) -> None:
    at_most(left_of(points_of(5, 40, 5, 0, dtype), 5, terms), ROUNDED[dtype])


@pytest.mark.parametrize("affine", [False, True])
def test_identical_points(affine: bool, dtype: str) -> None:
    points = np.tile(points_of(1, 300, 1, 1, dtype), (500, 1))
    below(all_clusters(points, CpcaConfig(7, 4, affine)), 1e-9)
    at_most(left_of(points, 7, 4, affine), ROUNDED[dtype])
    # Nearly all of them identical.
    points[:3] = points_of(3, 300, 3, 2, dtype)
    below(all_clusters(points, CpcaConfig(7, 4, affine)), 1e-9)
    at_most(left_of(points, 7, 4, affine), ROUNDED[dtype])


def test_points_that_are_multiples_of_each_other(dtype: str) -> None:
    points = np.outer(np.linspace(-1.0, 1.0, 101), points_of(1, 300, 1, 3)).astype(dtype)
    below(all_clusters(points, CpcaConfig(3, 5)), 1e-9)  # one of them is zero
    at_most(left_of(points, 3, 5), ROUNDED[dtype])


def test_more_terms_than_the_rank(dtype: str) -> None:
    points = points_of(400, 300, 3, 4, dtype)
    found = clustered_components(points, CpcaConfig(2, 16))
    below(found.error, 1e-9)
    at_most((np.linalg.norm(found.axes, axis=2) > 0.5).sum(axis=1).max(), 3)
    below(all_clusters(points, CpcaConfig(2, 400)), 1e-9)
    at_most(left_of(points, 2, 16), ROUNDED[dtype])
    at_most(left_of(points, 2, 400), ROUNDED[dtype])


def test_nothing_but_zeros() -> None:
    found = clustered_components(np.zeros((9, 4), dtype=np.float32), CpcaConfig(3))
    assert found.error == 0.0
    equal(found.label, -1)
    assert len(found.axes) == 0


def test_one_giant_among_dwarfs(dtype: str) -> None:
    points = 1e-6 * points_of(300, 50, 20, 5, dtype)
    points[7] *= 1e9
    below(all_clusters(points, CpcaConfig(4, 2)), 1e-6)
    at_most(left_of(points, 4, 2), ROUNDED[dtype])


@pytest.mark.parametrize("share", [-1.0, 1.0])
def test_units_do_not_matter_to_subspaces(share: float, dtype: str) -> None:
    """As long as their squares are numbers."""
    points = points_of(200, 30, 20, 6, dtype)
    size = np.dtype(dtype).type({"float32": 1e15, "float64": 1e140}[dtype] ** share)
    found, wanted = left_of(size * points, 4, 3), left_of(points, 4, 3)
    close(found, wanted, {"float32": 1e-3, "float64": 1e-12}[dtype])


@pytest.mark.parametrize("size", [1e-18, 1e15])
def test_units_do_not_matter(size: float) -> None:
    points = points_of(200, 30, 20, 6)
    one, other = (
        clustered_components(times * points, CpcaConfig(4, 3)) for times in (1.0, np.float32(size))
    )
    close(other.error, one.error, 0.05)


def test_16_bits_hold_a_giant_and_its_dwarfs() -> None:
    """A vertex a million times as bright as the others saturates nothing and drowns nobody."""
    raw = raw_segment(0)
    shines = np.flatnonzero(raw.any(axis=(1, 2)))[0]
    raw[shines] *= 1e6
    segment, lost = compressed(raw, CompressConfig(6, 30, 0.0))
    values = segment.representatives.values
    assert np.abs(values.astype(int)).max() == 32767  # every representative uses all its bits
    assert np.abs(segment.weights.astype(int)).max() == 32767
    back = unhaar(dense_segment(segment, len(raw)).reshape(len(raw), 2, 4, 4)).reshape(raw.shape)
    below(np.abs(back[shines] - raw[shines]).max(), 1e-4 * raw[shines].max())
    below(lost.errors()["stored"], 1e-8)
    others = np.delete(np.arange(len(raw)), shines)
    missed = np.square(back[others] - raw[others]).sum() / np.square(raw[others]).sum()
    below(missed, 0.05)


@pytest.mark.parametrize("size", [1e-12, 1e12])
def test_16_bits_of_any_unit(size: float) -> None:
    raw = raw_segment(1)
    one, other = (
        compressed(times * raw, CompressConfig(6, 30))[1].errors()
        for times in (np.float32(1.0), np.float32(size))
    )
    close(other["stored"], one["stored"], 0.05)


def test_a_vertex_that_sees_nothing_and_one_that_sees_all() -> None:
    raw = raw_segment(2)
    raw[0], raw[1] = 0.0, 1.0
    segment, _ = compressed(raw, CompressConfig(6, 30, 0.002))
    back = unhaar(dense_segment(segment, len(raw)).reshape(len(raw), 2, 4, 4)).reshape(raw.shape)
    assert 0 not in segment.vertices
    below(np.abs(back[1] - 1.0).max(), 0.2)


@pytest.mark.parametrize("reached", [0, 1, 3])
def test_a_segment_that_reaches_next_to_nobody(reached: int) -> None:
    raw = raw_segment(3)
    some = np.flatnonzero(raw.any(axis=(1, 2)))
    raw[some[reached:]] = 0.0
    segment, lost = compressed(raw, CompressConfig(16, 200, 0.0))
    check_segment(segment, len(raw), 32)
    assert segment.clusters == min(reached, 1)
    below(lost.errors()["stored"], 1e-8)
