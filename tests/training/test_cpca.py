from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from prtnet.cores import computing_threads
from training.cpca import (
    Components,
    CpcaConfig,
    Subspaces,
    alternate,
    clustered_components,
    lost,
    nearest,
    principal,
    scattered,
    sketch,
    steps,
    subspaces,
)


def planes(
    points: int = 240, groups: int = 4, dims: int = 30, rank: int = 3, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Points on a few subspaces, around a direction of each, and which of them each is on."""
    rng = np.random.default_rng(seed)
    group = rng.permutation(np.arange(points) % groups)
    bases = rng.normal(size=(groups, rank, dims))
    part = rng.normal(size=(points, rank)) + 3.0 * (np.arange(rank) == 0)
    found = np.einsum("vk,vkd->vd", part, bases[group])
    return found.astype(np.float32), group


def slowly_lost(signal: np.ndarray, found: Subspaces) -> np.ndarray:
    """Every point's every vector less its projection on every subspace."""
    result = np.zeros((len(signal), len(found.axes)))
    for v, c in itertools.product(range(len(signal)), range(len(found.axes))):
        axes = found.axes[c].double().numpy()
        mean = 0.0 if found.mean is None else found.mean[c].double().numpy()
        for vector in signal[v].astype(np.float64) - mean:
            result[v, c] += np.square(vector - axes.T @ (axes @ vector)).sum()
    return result


def rebuilt(found: Components) -> np.ndarray:
    """Points as sums of components, one by one."""
    result = np.zeros((len(found.label), found.axes.shape[2]))
    for point, cluster in enumerate(found.label):
        if cluster >= 0:
            result[point] = found.weights[point] @ found.axes[cluster]
            if found.mean is not None:
                result[point] += found.mean[cluster]
    return result


@given(
    st.integers(1, 12), st.integers(1, 12), st.integers(0, 14), st.integers(1, 6), st.integers(0, 9)
)
@settings(max_examples=40)
def test_eigenvectors_are_those_of_the_singular_value_decomposition(
    rows: int, width: int, most: int, rank: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(rows, rank)) @ rng.normal(size=(rank, width))
    values, axes = principal(torch.as_tensor(matrix), most)
    _, singular, right = np.linalg.svd(matrix)
    count = min(most, rank, rows, width)
    assert values.shape == (count,)
    assert axes.shape == (count, width)
    np.testing.assert_allclose(values, singular[:count] ** 2, rtol=1e-6)
    np.testing.assert_allclose(axes @ axes.T, np.eye(count), atol=1e-6)
    kept = axes.T @ axes
    gap = count == len(singular) or count == 0 or singular[count - 1] > 1.01 * singular[count]
    if gap:
        want = right[:count].T @ right[:count]
        np.testing.assert_allclose(kept, want, atol=1e-4)


@pytest.mark.parametrize("affine", [False, True])
@pytest.mark.parametrize("vectors", [1, 3])
def test_what_is_lost_is_what_a_projection_leaves(affine: bool, vectors: int) -> None:
    rng = np.random.default_rng(1)
    signal = (rng.normal(size=(40, vectors, 7)) + 2.0).astype(np.float32)
    label = torch.as_tensor(np.arange(40) % 3)
    found = subspaces(torch.as_tensor(signal), label, 3, 2, affine)
    got = lost(torch.as_tensor(signal), found)
    np.testing.assert_allclose(got, slowly_lost(signal, found), rtol=1e-4, atol=1e-3)
    # Of all subspaces of a cluster's points this one leaves least.
    rows = signal[label == 1].reshape(-1, 7).astype(np.float64)
    rows = rows - rows.mean(axis=0) if affine else rows
    rest = np.square(np.linalg.svd(rows)[1][2:]).sum()
    assert float(got[label == 1, 1].sum()) == pytest.approx(rest, rel=1e-4)


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    signal = torch.as_tensor(planes()[0])[:, None]
    found = subspaces(signal, torch.arange(240) % 4, 4, 2)
    whole = lost(signal, found)
    monkeypatch.setattr("training.cpca.BLOCK", 100)
    np.testing.assert_allclose(lost(signal, found), whole, rtol=1e-5, atol=1e-4)


@pytest.fixture
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.usefixtures("one_thread")
@pytest.mark.parametrize("affine", [False, True])
def test_no_byte_depends_on_the_number_of_threads(
    monkeypatch: pytest.MonkeyPatch, affine: bool
) -> None:
    """Each piece is one's; they are more than there are threads."""
    monkeypatch.setattr("training.cpca.BLOCK", 1000)
    monkeypatch.setattr("training.cpca.POINTS", 50)
    rng = np.random.default_rng(0)
    points = (rng.normal(size=(300, 90)) @ rng.normal(size=(90, 90))).astype(np.float32)
    config = CpcaConfig(6, 3, affine)
    alone = vars(clustered_components(points, config))
    asked: list[int] = []
    for threads in (2, 5):
        with computing_threads(threads) as pool:

            def each(work: Callable[[Any], Any], pieces: Iterable[Any]) -> Iterable[Any]:
                listed = list(pieces)
                asked.append(len(listed))
                return pool.map(work, listed)

            shared = vars(clustered_components(points, config, each))
        for name, value in alone.items():
            np.testing.assert_array_equal(shared[name], value, err_msg=name)
    assert {2, 4, 6} <= set(asked)  # blocks, clusters


@pytest.mark.parametrize("affine", [False, True])
def test_subspaces_are_found_again(affine: bool) -> None:
    points, group = planes()
    if affine:
        points = points + 20.0 * np.eye(4, 30, dtype=np.float32)[group]
    found = clustered_components(points, CpcaConfig(4, 3, affine, rounds=40, seed=1))
    assert found.error < 1e-4
    for cluster in range(4):
        assert len(set(group[found.label == cluster])) == 1


@pytest.mark.parametrize("affine", [False, True])
def test_error_and_weights_are_those_of_the_points(affine: bool) -> None:
    rng = np.random.default_rng(3)
    points = (rng.normal(size=(300, 40)) * 0.8 ** np.arange(40) + 0.3).astype(np.float32)
    points[::7] = 0.0
    found = clustered_components(points, CpcaConfig(6, 5, affine))
    missed = np.square(rebuilt(found) - points).sum()
    energy = np.square(points.astype(np.float64)).sum()
    assert found.energy == pytest.approx(energy, rel=1e-5)
    assert found.error == pytest.approx(missed / energy, rel=1e-4)
    assert (found.label[::7] == -1).all()
    assert (np.delete(found.label, np.s_[::7]) >= 0).all()
    assert not found.weights[::7].any()
    # The error is what eigenvalues leave of the energy.
    if not affine:
        assert found.error == pytest.approx(1.0 - found.values.sum() / energy, rel=1e-3)


def test_clusters_lose_less_than_one_subspace_and_than_k_means() -> None:
    points, _ = planes(seed=5)
    one = clustered_components(points, CpcaConfig(1, 3)).error
    means = clustered_components(points, CpcaConfig(4, 0, affine=True)).error
    four = clustered_components(points, CpcaConfig(4, 3)).error
    assert four < 0.2 * one
    assert four < 0.2 * means


def test_one_cluster_is_plain_principal_components() -> None:
    points, _ = planes(seed=6)
    values = np.linalg.svd(points.astype(np.float64))[1] ** 2
    found = clustered_components(points, CpcaConfig(1, 4))
    assert found.error == pytest.approx(values[4:].sum() / values.sum(), rel=1e-4)
    np.testing.assert_allclose(found.values[0], values[:4], rtol=1e-4)


def test_rounds_never_lose_more() -> None:
    signal = torch.as_tensor(np.random.default_rng(8).normal(size=(200, 1, 10)), dtype=torch.float)
    start = torch.arange(200) % 5

    def total(label: torch.Tensor) -> float:
        left = lost(signal, subspaces(signal, label, 5, 2))
        return float(left.gather(1, label[:, None]).sum())

    def fit(label: torch.Tensor) -> Subspaces:
        return subspaces(signal, label, 5, 2)

    totals = [total(alternate(signal, start, fit, nearest, rounds)) for rounds in (1, 2, 4, 8, 30)]
    assert totals == sorted(totals, reverse=True)
    assert totals[-1] < 0.9 * totals[0]

    # An assignment that is worse is not taken.
    def shuffled(left: torch.Tensor) -> torch.Tensor:
        return torch.zeros(len(left), dtype=torch.int64)

    best = alternate(signal, start, fit, nearest, 30)
    assert torch.equal(alternate(signal, best, fit, shuffled, 5), best)


def test_the_same_seed_gives_the_same_clusters() -> None:
    points = np.random.default_rng(9).normal(size=(300, 60)).astype(np.float32)
    one, same, other = (
        clustered_components(points, CpcaConfig(5, 2, seed=seed)) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(one.label, same.label)
    np.testing.assert_array_equal(one.axes, same.axes)
    assert not np.array_equal(one.label, other.label)


def test_nobody_is_left_alone_to_fill_a_cluster() -> None:
    """Two clusters would be empty: they get the two that are worst off, not the only one of 3."""
    left = torch.tensor([[1.0, 9, 9, 9], [2.0, 9, 9, 9], [0.5, 9, 9, 9], [9, 9, 9, 8.0]])
    assert nearest(left).tolist() == [2, 1, 0, 3]
    assert nearest(torch.zeros(5, 3)).bincount(minlength=3).min() >= 1


def test_a_sketch_holds_what_leads() -> None:
    rng = np.random.default_rng(2)
    wide = rng.normal(size=(100, 8)) @ rng.normal(size=(8, 90))
    points = torch.as_tensor(wide + 1e-3 * rng.normal(size=wide.shape))
    found = sketch(points, 12, 0)
    assert found.shape == (100, 12)
    kept = torch.square(found).sum() / torch.square(points).sum()
    assert 1.0 - 1e-5 < float(kept) <= 1.0 + 1e-12
    assert sketch(points, 90, 0) is points


def test_points_to_start_from_are_far_apart_and_different() -> None:
    points, group = planes(rank=1)
    for seed in range(5):
        chosen = scattered(torch.as_tensor(points + 0.0), 4, seed).tolist()
        assert len(set(chosen)) == 4
        assert len(set(group[chosen])) >= 3
    assert sorted(scattered(torch.ones(6, 2), 6, 0).tolist()) == list(range(6))


def test_numbers_of_terms_double() -> None:
    assert [steps(n) for n in (0, 1, 3, 16)] == [[0], [0, 1], [0, 1, 2, 3], [0, 1, 2, 4, 8, 16]]


def test_counts_cut_axes() -> None:
    signal = torch.as_tensor(planes()[0])[:, None]
    found = subspaces(signal, torch.arange(240) % 3, 3, 3).kept(np.array([0, 2, 1]))
    assert found.axes.shape == (3, 2, 30)
    assert [int((one != 0).any(dim=1).sum()) for one in found.axes] == [0, 2, 1]
    assert (found.values > 0).sum(dim=1).tolist() == [0, 2, 1]


@pytest.mark.parametrize("change", [{"clusters": 0}, {"terms": -1}, {"rounds": 0}])
def test_impossible_configurations(change: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="at least one cluster"):
        CpcaConfig(**{"clusters": 2, **change})


def test_points_that_are_not_finite() -> None:
    with pytest.raises(ValueError, match="not finite"):
        clustered_components(np.full((4, 3), np.nan, dtype=np.float32), CpcaConfig(2))
