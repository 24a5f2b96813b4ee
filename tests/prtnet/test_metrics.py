from __future__ import annotations

import numpy as np
import pytest

from prtnet.metrics import ErrorSum, relative_rms


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
