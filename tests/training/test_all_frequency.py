from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prtnet.all_frequency import SEGMENTS, AllFrequencyField, Segment, check_segment
from prtnet.all_frequency_file import sizes
from prtnet.haar import unhaar
from prtnet.sparse_columns import decode
from tests.all_frequency import ball, dense_segment
from training.all_frequency import (
    CompressConfig,
    Losses,
    below,
    best_weights,
    clustered,
    compress,
    fitted,
    limit,
    rounded,
    sparse_wavelets,
    turned,
)
from training.cpca import CpcaConfig, clustered_components


def raw_segment(
    seed: int, points: int = 162, rows: int = 2, side: int = 4, noise: float = 0.02
) -> np.ndarray:
    """Transfer like that of a ball: bright where it faces the light, a soft edge, some dark."""
    rng = np.random.default_rng(seed)
    place = rng.normal(size=(points, 3))
    place /= np.linalg.norm(place, axis=1, keepdims=True)
    towards = rng.normal(size=(rows, side * side, 3))
    found = np.maximum(np.einsum("pi,rci->prc", place, towards), 0.0) ** 1.5
    found *= 1.0 + noise * rng.normal(size=found.shape)
    found[place[:, 2] < -0.3] = 0.0
    return found.astype(np.float32)


def compressed(raw: np.ndarray, config: CompressConfig) -> tuple[Segment, Losses]:
    """One segment as it is stored, and what that loses."""
    found = clustered(raw, config)
    kept, left = sparse_wavelets([found], config.error)
    segment, stored = fitted(raw, found, kept[0])
    return segment, Losses(found.energy, found.lost, found.lost + left[0], stored)


def field_of(config: CompressConfig, rows: int = 2) -> tuple[AllFrequencyField, list[np.ndarray]]:
    raw = [raw_segment(k, rows=rows) for k in range(SEGMENTS)]
    raw[5][:] = 0.0
    view = np.ones((rows, 16, 3), dtype=np.float32)
    return compress(lambda: iter(raw), ball(2), view, 8, config, {"source": "made"}), raw


def test_the_error_told_is_the_error_of_what_is_stored() -> None:
    field, raw = field_of(CompressConfig(4, 40, 0.01))
    missed = energy = 0.0
    for segment, one in zip(field.segments, raw, strict=True):
        back = unhaar(dense_segment(segment, 162).reshape(162, 2, 4, 4)).reshape(one.shape)
        missed += np.square(back - one).sum()
        energy += np.square(one.astype(np.float64)).sum()
        dark = ~one.any(axis=(1, 2))
        assert set(segment.vertices) == set(np.flatnonzero(~dark))
        assert not back[dark].any()
    told = field.metadata["squared_error"]
    assert told["stored"] == pytest.approx(missed / energy, rel=1e-3)
    assert told["clustered"] < told["thresholded"]
    assert told["stored"] < 1.001 * told["thresholded"]
    assert len(field.metadata["squared_error_of_segments"]) == 24
    assert field.metadata["source"] == "made"
    assert field.segments[5].clusters == 0


@pytest.mark.parametrize("error", [0.01, 0.02, 0.05])
def test_numbers_are_left_out_until_the_error_asked_for_is_reached(error: float) -> None:
    raw = raw_segment(1)
    segment, lost = compressed(raw, CompressConfig(6, 30, error))
    check_segment(segment, 162, 32)
    told = lost.errors()
    assert told["clustered"] < 0.8 * error
    assert 0.5 * error < told["stored"] <= error
    more, _ = compressed(raw, CompressConfig(6, 30, 2.0 * error))
    assert len(more.representatives.values) < len(segment.representatives.values)


def test_where_clusters_leave_no_room_little_more_is_lost() -> None:
    _, lost = compressed(raw_segment(2, noise=0.5), CompressConfig(2, 80, 1e-4))
    told = lost.errors()
    assert told["clustered"] > 1e-3
    assert 1.05 * told["clustered"] < told["thresholded"] <= 1.1001 * told["clustered"]


def test_exact_representatives_lose_what_the_clusters_lose() -> None:
    """Leaving out next to nothing: what is left is rounding of 16 bits."""
    raw = raw_segment(3)
    _, lost = compressed(raw, CompressConfig(32, 80, 0.0))
    assert lost.errors()["clustered"] < 1e-9
    assert lost.errors()["stored"] < 1e-7
    config = CompressConfig(3, 40, 0.0)
    found = clustered_components(raw.reshape(162, -1), CpcaConfig(config.clusters(110), 3))
    told = compressed(raw, config)[1].errors()
    assert told["stored"] <= 1.11 * found.error


@given(st.integers(0, 30), st.floats(0.0, 400.0))
@settings(max_examples=40)
def test_the_limit_is_that_of_the_sorted_numbers(seed: int, room: float) -> None:
    rng = np.random.default_rng(seed)
    wavelets = [rng.normal(size=(2, 3, 10 + k)).astype(np.float32) for k in range(3)]
    square = np.sort(np.concatenate([one.ravel() for one in wavelets]).astype(np.float64) ** 2)
    least = limit(wavelets, room)
    count = sum(int((np.abs(one) <= least).sum()) for one in wavelets)
    assert sum(below(one, least) for one in wavelets) <= room
    assert count == np.searchsorted(np.cumsum(square), room, side="right")


def test_one_limit_holds_for_all_segments() -> None:
    """Together they lose what is asked for; the noisy one more, and the smooth one less."""
    raw = [raw_segment(1, noise=0.01), raw_segment(2, noise=0.1)]
    found = [clustered(one, CompressConfig(6, 30)) for one in raw]
    kept, left = sparse_wavelets(found, 0.02)
    energy, lost = (sum(getattr(one, name) for one in found) for name in ("energy", "lost"))
    assert lost + sum(left) == pytest.approx(0.02 * energy, rel=0.02)
    errors = [(one.lost + gone) / one.energy for one, gone in zip(found, left, strict=True)]
    assert errors[0] < 0.018 < 0.022 < errors[1]
    smallest = [np.abs(one[one != 0.0]).min() for one in kept]
    assert max(smallest) < 1.2 * min(smallest)


def test_turned_representatives_make_the_same_sums_of_fewer_numbers() -> None:
    rng = np.random.default_rng(10)
    sparse = rng.normal(size=(3, 4, 60)) * (rng.random((3, 4, 60)) < 0.2)
    mixed, _ = np.linalg.qr(rng.normal(size=(3, 4, 4)))
    wavelets = (mixed @ sparse + 0.01 * rng.normal(size=sparse.shape)).astype(np.float32)
    found = turned(wavelets, limit([wavelets], 0.5))
    same = np.swapaxes(found, 1, 2) @ found
    np.testing.assert_allclose(same, np.swapaxes(wavelets, 1, 2) @ wavelets, atol=1e-4)
    before, after = (int((np.abs(one) > limit([one], 0.5)).sum()) for one in (wavelets, found))
    assert after < 0.85 * before
    assert turned(wavelets[:0], 0.1).shape == (0, 4, 60)


def test_every_turn_brings_representatives_nearer_to_what_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Squares of what is left out, and the limit's square for each number kept, never grow."""
    wavelets = np.random.default_rng(11).normal(size=(2, 5, 80)).astype(np.float32)
    least = limit([wavelets], 20.0)
    costs = []
    for turns in (0, 1, 2, 5, 20):
        monkeypatch.setattr("training.all_frequency.TURNS", turns)
        found = turned(wavelets, least)
        costs.append(float(np.minimum(np.square(found), least**2).sum()))
    assert costs == sorted(costs, reverse=True)
    assert costs[-1] < 0.98 * costs[0]


def test_weights_are_the_least_squares() -> None:
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(4, 20)).astype(np.float32)
    points = rng.normal(size=(9, 20)).astype(np.float32)
    want = np.linalg.lstsq(rows.T.astype(np.float64), points.T.astype(np.float64), rcond=None)[0].T
    np.testing.assert_allclose(best_weights(points, rows), want, atol=1e-5)
    rows[2] = 0.0  # all left out
    assert not best_weights(points, rows)[:, 2].any()


def test_weights_of_16_bits() -> None:
    weights = np.random.default_rng(6).normal(size=(50, 3)) * [1e-6, 1.0, 0.0]
    whole, scale = rounded(weights)
    assert whole.dtype == np.int16
    assert scale.dtype == np.float32
    missed = np.abs(whole * scale - weights).max(axis=0)
    assert (missed <= 0.51 * np.abs(weights).max(axis=0) / 32767).all()
    assert scale[2] == 0.0
    assert np.abs(whole.astype(int)).max() == 32767


def test_fitting_weights_anew_pays() -> None:
    """What is stored errs less than the representatives' own weights would."""
    raw = raw_segment(7, noise=0.1)
    _, lost = compressed(raw, CompressConfig(6, 30, 0.05))
    told = lost.errors()
    assert told["stored"] < 0.999 * told["thresholded"]


def test_the_same_seed_gives_the_same_field() -> None:
    one, other = (compressed(raw_segment(8), CompressConfig(4, 40))[0] for _ in range(2))
    np.testing.assert_array_equal(one.weights, other.weights)
    np.testing.assert_array_equal(decode(one.representatives), decode(other.representatives))


def test_more_of_anything_is_better() -> None:
    """More terms and smaller clusters lose less; a larger error takes fewer bytes."""
    errors = [
        field_of(CompressConfig(*given, error=0.0))[0].metadata["squared_error"]["stored"]
        for given in ((2, 60), (4, 60), (4, 20))
    ]
    assert errors == sorted(errors, reverse=True)
    totals = [sizes(field_of(CompressConfig(4, 40, e))[0])["total"] for e in (0.01, 0.03, 0.1)]
    assert all(less > more for less, more in itertools.pairwise(totals))


def test_arrays_that_do_not_fit() -> None:
    raw = [raw_segment(k) for k in range(3)]
    view = np.ones((2, 16, 3), dtype=np.float32)
    with pytest.raises(ValueError, match="3 segments, not 24"):
        compress(lambda: iter(raw), ball(2), view, 8, CompressConfig())
    with pytest.raises(ValueError, match=r"shape \(162, 2, 16\), expected \(162, 2, 64\)"):
        compress(lambda: iter(raw), ball(2), view, 16, CompressConfig())
    for change in ({"terms": 0}, {"points_per_cluster": 0}, {"error": 1.0}, {"error": -0.1}):
        with pytest.raises(ValueError, match="start at 1"):
            dataclasses.replace(CompressConfig(), **change)
