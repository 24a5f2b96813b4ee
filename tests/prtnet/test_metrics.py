from __future__ import annotations

import numpy as np
import pytest

from prtnet.metrics import CoherenceSum, ErrorSum, relative_rms


def test_blocks_add_up_to_the_whole():
    rng = np.random.default_rng(0)
    truth, predicted = rng.normal(size=(2, 7, 5, 4)).astype(np.float32)
    total, other = ErrorSum(), ErrorSum()
    total.add(predicted[:3], truth[:3])
    other.add(predicted[3:], truth[3:])
    total.merge(other)
    expected = np.sqrt(((predicted - truth) ** 2).sum() / (truth**2).sum())
    assert total.rms() == pytest.approx(expected, rel=1e-6)
    assert relative_rms(predicted, truth) == pytest.approx(expected, rel=1e-6)
    each = np.sqrt(((predicted - truth) ** 2).sum((0, 2)) / (truth**2).sum((0, 2)))
    assert np.allclose(total.relative(), each, rtol=1e-6)
    assert total.summary()["max"] == pytest.approx(each.max(), rel=1e-6)
    assert total.summary()["p99"] <= total.summary()["max"]


def test_exact_is_zero_and_nothing_is_an_error():
    truth = np.ones((1, 2, 4))
    assert relative_rms(truth, truth) == 0.0
    assert relative_rms(np.zeros_like(truth), truth) == pytest.approx(1.0)
    with pytest.raises(ValueError, match="no poses"):
        ErrorSum().rms()
    with pytest.raises(ValueError, match="no poses"):
        ErrorSum().relative()
    empty = ErrorSum()
    empty.merge(ErrorSum())
    assert empty.error is None


def coherence(predicted, truth, cuts=()):
    total = CoherenceSum()
    for block in zip(np.split(predicted, cuts), np.split(truth, cuts), strict=True):
        total.add(*block)
    return total.value()


def test_coherence_is_the_same_in_any_blocks():
    truth, predicted = np.random.default_rng(0).normal(size=(2, 9, 5, 4)).astype(np.float32)
    step = np.diff(predicted - truth, axis=0)
    expected = ((step**2).sum() / (np.diff(truth, axis=0) ** 2).sum()) ** 0.5
    for cuts in ((), (4,), (1, 2, 8), (0, 3, 3)):
        assert coherence(predicted, truth, cuts) == pytest.approx(expected, rel=1e-5)


def test_coherence_of_known_predictions():
    time = np.linspace(0, 1, 30)[:, None, None]
    truth = np.sin(3 * time) * np.ones((1, 4, 9))
    assert coherence(np.full_like(truth, 0.7), truth) == pytest.approx(1.0)  # never changes
    assert coherence(truth + 5.0, truth) == pytest.approx(0.0, abs=1e-12)  # wrong, but steadily so
    flicker = truth + 0.2 * (-1.0) ** np.arange(30)[:, None, None]
    assert coherence(flicker, truth) > 1.5
    half = 0.5 * truth
    assert coherence(half, truth) == pytest.approx(0.5)


def test_coherence_of_nothing_that_moves_is_unknown():
    still = np.ones((5, 3, 4))
    assert coherence(still, still) is None
    assert coherence(still[:1], still[:1]) is None
    assert CoherenceSum().value() is None


def test_coherence_of_clips_counts_no_step_between_them():
    truth, predicted = np.random.default_rng(1).normal(size=(2, 8, 5, 4))
    parts = [CoherenceSum(), CoherenceSum()]
    parts[0].add(predicted[:3], truth[:3])
    parts[1].add(predicted[3:], truth[3:])
    total = CoherenceSum()
    for part in parts:
        total.merge(part)
    steps = np.delete(np.diff(predicted - truth, axis=0), 2, axis=0)
    motion = np.delete(np.diff(truth, axis=0), 2, axis=0)
    assert total.value() == pytest.approx(((steps**2).sum() / (motion**2).sum()) ** 0.5)
