from __future__ import annotations

import numpy as np
import pytest
from sklearn.decomposition import PCA

from training.reduction import choose_counts, input_reduction, reduce_output


def signal(poses=12, receivers=20, seed=0):
    return np.random.default_rng(seed).normal(size=(poses, receivers, 4)).astype(np.float32)


def slots_of(receivers, clusters):
    capacity = -(-receivers // clusters)
    slots = np.full(clusters * capacity, -1, dtype=np.int32)
    slots[:receivers] = np.random.default_rng(0).permutation(receivers)
    return slots.reshape(clusters, capacity)


@pytest.mark.parametrize("poses", [12, 60])  # fewer and more than values
def test_components_equal_scikit_learn(poses):
    visibility, slots = signal(poses), slots_of(20, 4)
    output = reduce_output(visibility, slots, variance=1.0)
    for cluster, own in enumerate(slots):
        block = visibility[:, own].reshape(len(visibility), -1).astype(np.float64)
        peer = PCA(int(output.latents[cluster])).fit(block)
        assert np.allclose(output.mean[cluster], peer.mean_, atol=1e-6)
        for ours, theirs in zip(output.basis[cluster], peer.components_, strict=True):
            assert abs(ours @ theirs) == pytest.approx(1.0, abs=1e-3)


def test_all_components_reproduce_the_training_poses():
    visibility, slots = signal(receivers=18), slots_of(18, 4)  # with empty slots
    output = reduce_output(visibility, slots, variance=1.0, step=1)
    for cluster, own in enumerate(slots):
        count = output.latents[cluster]
        rebuilt = (
            output.mean[cluster] + output.targets[cluster, :, :count] @ output.basis[cluster]
        ).reshape(len(visibility), -1, 4)
        assert np.allclose(rebuilt[:, own >= 0], visibility[:, own[own >= 0]], atol=1e-5)
        assert (rebuilt[:, own < 0] == 0).all()


def test_retained_variance_is_reached_with_the_fewest():
    eigenvalues = np.array([[8.0, 1.0, 0.5], [4.0, 2.0, 0.1]])
    assert choose_counts(eigenvalues, 0.76, None, 1).tolist() == [1, 1]
    assert choose_counts(eigenvalues, 0.8, None, 1).tolist() == [1, 2]
    assert choose_counts(eigenvalues, 1.0, None, 1).tolist() == [3, 3]
    assert choose_counts(eigenvalues, 1.0, 1.5, 1).tolist() == [1, 2]


def test_components_go_where_the_variance_is():
    visibility = signal(receivers=20)
    slots = np.arange(20, dtype=np.int32).reshape(2, 10)
    visibility[:, 10:] *= 0.01
    output = reduce_output(visibility, slots, variance=0.95)
    assert output.latents[0] > 4
    assert output.latents[1] == 0


def test_constant_clusters_cost_a_mean_and_nothing_else():
    visibility = np.repeat(signal(poses=1), 6, axis=0)
    output = reduce_output(visibility, slots_of(20, 4), variance=0.99)
    assert output.latents.tolist() == [0] * 4
    assert output.targets.shape == (4, 6, 0)


@pytest.mark.parametrize("poses", [1, 2])
def test_fewer_poses_than_components(poses):
    output = reduce_output(signal(poses=poses), slots_of(20, 4), variance=1.0)
    assert output.latents.max() <= poses - 1
    assert np.isfinite(output.targets).all()


def test_inputs_are_decorrelated_and_of_unit_scale():
    rng = np.random.default_rng(0)
    features = rng.normal(size=(50, 3, 6)).astype(np.float32) * np.array([9, 3, 1, 0.5, 0.1, 0.0])
    features = features.astype(np.float32)
    mean, basis = input_reduction(features, 0.9999, 4)
    reduced = (np.swapaxes(features, 0, 1) - mean[:, None]) @ basis
    assert basis.shape == (3, 6, 4)
    for own in reduced:
        covariance = np.cov(own.T, bias=True)
        assert np.allclose(covariance, np.diag(np.diag(covariance)), atol=1e-4)
        assert np.trace(covariance) == pytest.approx(4.0, rel=1e-3)


def test_constant_features_give_zero_inputs():
    features = np.ones((5, 2, 3), dtype=np.float32)
    mean, basis = input_reduction(features, 0.99, 8)
    assert (np.abs((features[:, 0] - mean[0]) @ basis[0]) == 0).all()
    assert np.isfinite(basis).all()
