from __future__ import annotations

import numpy as np

from training.clusters import subdivide
from training.reduction import reduce_output
from training.signal_groups import regroup


def two_kinds(poses=30, receivers=24, seed=0):
    """Visibility of two kinds of receivers, mixed, each kind moving with one moment of its own."""
    rng = np.random.default_rng(seed)
    kind = rng.permutation(receivers) % 2
    time = rng.normal(size=(poses, 2))
    mix = rng.normal(size=(receivers, 4))
    return kind, (2.0 + time[:, kind, None] * mix).astype(np.float32)


def test_receivers_that_move_alike_come_together():
    kind, visibility = two_kinds()
    start = np.arange(24, dtype=np.int32).reshape(2, 12)
    groups = regroup(visibility, start, parts=2, count=1)
    assert sorted(groups.ravel()) == list(range(24))
    for own in groups:
        assert len(set(kind[own])) == 1
    assert reduce_output(visibility, groups, 0.9999, step=1).latents.tolist() == [1, 1]
    assert (reduce_output(visibility, start, 0.9999, step=1).latents > 1).all()


def test_clusters_keep_their_receivers_and_groups_their_size():
    rng = np.random.default_rng(1)
    visibility = rng.normal(size=(10, 26, 4)).astype(np.float32)
    slots = np.full((2, 14), -1, dtype=np.int32)
    slots[0], slots[1, :12] = np.arange(14), np.arange(14, 26)
    start = subdivide(slots, rng.normal(size=(26, 3)), 3)
    groups = regroup(visibility, start, parts=3, count=2)
    assert start.shape == groups.shape == (6, 5)
    for cluster, members in enumerate((set(range(14)), set(range(14, 26)))):
        for each in (start, groups):
            own = each[3 * cluster : 3 * cluster + 3]
            assert sorted(own[own >= 0]) == sorted(members)


def test_regrouping_never_loses_more_of_the_signal():
    rng = np.random.default_rng(2)
    for seed in range(5):
        basis = rng.normal(size=(40, 6)) * 0.5 ** np.arange(6)
        visibility = (basis @ rng.normal(size=(6, 30 * 4))).reshape(40, 30, 4).astype(np.float32)
        start = rng.permutation(30).astype(np.int32).reshape(3, 10)
        kept = []
        for groups in (start, regroup(visibility, start, parts=3, count=2)):
            targets = reduce_output(visibility, groups, 1.0, step=1).targets
            kept.append(np.square(targets[..., :2]).sum())
        assert kept[1] > kept[0], seed


def test_one_part_or_no_components_change_nothing():
    _, visibility = two_kinds()
    start = np.arange(24, dtype=np.int32).reshape(2, 12)
    assert regroup(visibility, start, parts=1, count=3) is start
    assert regroup(visibility, start, parts=2, count=0) is start
    assert subdivide(start, np.zeros((24, 3)), 1) is start
