from __future__ import annotations

import numpy as np
import pytest

from prtnet.seams import JumpSum, cluster_of_receiver, receiver_edges, seam_ratio

FACES = np.array([[0, 1, 2], [2, 1, 3], [3, 4, 5]])
WELDED = np.array([0, 1, 2, 3, 3, 4])  # vertices 3 and 4 are one receiver


def test_edges_join_receivers_once():
    edges = receiver_edges(FACES, WELDED)
    assert edges.tolist() == [[0, 1], [0, 2], [1, 2], [1, 3], [2, 3], [3, 4]]


def test_owner_is_where_the_slots_say():
    slots = np.array([[4, 0, -1], [2, 1, 3]])
    assert cluster_of_receiver(slots).tolist() == [0, 1, 1, 1, 0]


def test_jumps_equal_a_loop_over_edges():
    rng = np.random.default_rng(0)
    error, owner = rng.normal(size=(7, 5, 4)), np.array([0, 0, 1, 1, 1])
    edges = receiver_edges(FACES, WELDED)
    total = JumpSum(edges)
    total.add(error[:3])
    total.add(error[3:])
    jumps = {True: [], False: []}
    for a, b in edges:
        for pose in error:
            jumps[bool(owner[a] != owner[b])].append(((pose[a] - pose[b]) ** 2).sum())
    expected = [np.mean(jumps[across]) ** 0.5 for across in (True, False)]
    assert total.rms(owner) == pytest.approx(expected)
    assert seam_ratio(error, edges, owner) == pytest.approx(expected[0] / expected[1])


def test_a_step_at_the_border_shows_and_a_smooth_error_does_not():
    edges = np.stack([np.arange(99), np.arange(1, 100)], axis=1)
    owner = np.arange(100) // 50
    smooth = np.sin(np.arange(100) / 5.0)[None, :, None]
    assert seam_ratio(smooth, edges, owner) < 1.5
    assert seam_ratio(smooth + 3.0 * owner[None, :, None], edges, owner) > 10.0
    assert seam_ratio(np.zeros((1, 100, 1)), edges, owner) == 1.0
    assert seam_ratio(3.0 * owner[None, :, None], edges, owner) == np.inf
    assert seam_ratio(smooth, edges, np.zeros(100, dtype=int)) == 0.0
    with pytest.raises(ValueError, match="no poses"):
        JumpSum(edges).rms(owner)
