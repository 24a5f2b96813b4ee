from __future__ import annotations

import itertools

import numpy as np
import pytest

from prtnet import sh
from prtnet.zh import Lobes
from prtnet.zh_order import aligned, aligned_along, in_order, inner_products


def random_lobes(seed: int, *shape: int, order: int = 5) -> Lobes:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(*shape, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    return Lobes(axes, rng.normal(size=(*shape, order)))


def shuffled(lobes: Lobes, seed: int) -> Lobes:
    """The same sums: lobes in any order, each about its axis or the opposite."""
    rng = np.random.default_rng(seed)
    order = rng.permuted(np.broadcast_to(np.arange(lobes.axes.shape[-2]), lobes.axes.shape[:-1]),
                         axis=-1)[..., None]  # fmt: skip
    sign = rng.choice([-1.0, 1.0], size=order.shape)
    parity = sign ** np.arange(lobes.coefficients.shape[-1])
    return Lobes(
        np.take_along_axis(lobes.axes, order, -2) * sign,
        np.take_along_axis(lobes.coefficients, order, -2) * parity,
    )


def same(one: Lobes, other: Lobes) -> None:
    np.testing.assert_allclose(one.axes, other.axes, atol=1e-12)
    np.testing.assert_allclose(one.coefficients, other.coefficients, atol=1e-12)


def test_alone_a_sum_has_one_form():
    lobes = random_lobes(0, 6, 4)
    one, other = in_order(lobes), in_order(shuffled(lobes, 1))
    same(one, other)
    np.testing.assert_allclose(one.harmonics(), lobes.harmonics(), atol=1e-12)
    assert (one.coefficients[..., 1] >= 0).all()
    energy = one.coefficients**2 @ (2 * np.arange(5) + 1)
    assert (np.diff(energy, axis=-1) <= 0).all()


def test_a_lobe_without_a_linear_band_points_by_its_next_odd_one():
    lobes = random_lobes(1, 20, 3)
    lobes.coefficients[..., 1] = 0.0
    found = in_order(lobes)
    assert (found.coefficients[..., 3] >= 0).all()
    same(found, in_order(shuffled(lobes, 2)))


@pytest.mark.parametrize("count", [1, 2, 4, 7])
def test_a_neighbours_order_and_orientation_are_taken(count):
    lobes = random_lobes(2, 3, 5, count)
    near = Lobes(lobes.axes + 1e-3, lobes.coefficients + 1e-3)
    same(aligned(shuffled(lobes, 3), near), lobes)


def test_pairs_are_made_as_one_by_one():
    one, other = random_lobes(4, 10, 4), random_lobes(5, 10, 4)
    found = aligned(one, other)
    basis = [sh.evaluate(lobes.axes, 5) * lobes.coefficients[..., sh.bands(5)]
             for lobes in (one, other)]  # fmt: skip
    for place in range(10):
        free, places = set(range(4)), set(range(4))
        while free:
            pairs = itertools.product(sorted(places), sorted(free))
            i, j = max(pairs, key=lambda ij: basis[1][place, ij[0]] @ basis[0][place, ij[1]])
            sign = np.sign(found.axes[place, i] @ one.axes[place, j])
            np.testing.assert_allclose(found.axes[place, i], sign * one.axes[place, j])
            assert found.axes[place, i] @ other.axes[place, i] >= 0
            free.remove(j)
            places.remove(i)
    np.testing.assert_allclose(found.harmonics(), one.harmonics(), atol=1e-12)


def test_likeness_is_the_integral_of_the_product():
    one, other = random_lobes(6, 3), random_lobes(7, 2)
    s, weight = sh.quadrature(8)
    values = [
        np.stack([sh.evaluate(s, 5) @ lobes[[i]].harmonics() for i in range(len(lobes.axes))])
        for lobes in (one, other)
    ]
    expected = np.einsum("iq,jq,q->ij", *values, weight)
    np.testing.assert_allclose(inner_products(one, other), expected, atol=1e-12)


def test_a_mesh_takes_the_order_of_its_root():
    steps = np.random.default_rng(8).normal(scale=1e-3, size=(30, 3, 3))
    first = random_lobes(8, 1, 3)
    axes = first.axes + np.cumsum(steps, axis=0)
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    smooth = Lobes(axes, np.repeat(first.coefficients, 30, axis=0))
    mixed = shuffled(smooth, 9)
    mixed.axes[7], mixed.coefficients[7] = smooth.axes[7], smooth.coefficients[7]
    path = np.stack([np.arange(29), np.arange(1, 30)], axis=1)
    edges = np.random.default_rng(0).permutation(path)
    edges[::2] = edges[::2, ::-1]
    same(aligned_along(mixed, edges, root=7), smooth)


def test_pieces_that_hang_together_are_ordered_each_by_itself():
    lobes = random_lobes(10, 5, 2)
    lobes.axes[1:3], lobes.coefficients[1:3] = lobes.axes[:1], lobes.coefficients[:1]
    lobes.axes[4], lobes.coefficients[4] = lobes.axes[3], lobes.coefficients[3]
    mixed = shuffled(lobes, 11)
    found = aligned_along(mixed, np.array([[0, 1], [1, 2], [3, 4]]))
    for piece in ([0, 1, 2], [3, 4]):
        for vertex in piece:
            same(found[vertex], mixed[piece[0]])
    same(aligned_along(mixed, np.empty((0, 2), dtype=int)), mixed)
