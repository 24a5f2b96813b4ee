"""Rotations of the basis: equivariance, the group, other libraries, the paper's count."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from prtnet import sh
from prtnet.sh_rotation import rotate, rotate_zxzxz, rotation_matrix, zxzxz_multiplications

TOLERANCE = {"float64": 1e-12, "float32": 3e-5}


def rotations(count: int, seed: int = 0) -> np.ndarray:
    return Rotation.random(count, random_state=seed).as_matrix()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 8, 11])
def test_equivariance_in_both_libraries(order, dtype):
    turns = rotations(7)
    points = sh.fibonacci_sphere(50)
    turned = sh.evaluate(points @ turns.swapaxes(1, 2), order)
    for given_turns in (turns.astype(dtype), torch.tensor(turns.astype(dtype))):
        matrix = rotation_matrix(given_turns, order)
        assert type(matrix) is type(given_turns)
        assert matrix.dtype == given_turns.dtype
        value = sh.evaluate(points, order) @ np.asarray(matrix).swapaxes(1, 2)
        np.testing.assert_allclose(value, turned, atol=TOLERANCE[dtype])


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.integers(1, 8))
def test_matrices_are_an_orthogonal_representation(seed, order):
    a, b = rotations(2, seed)
    of_a, of_b, of_both, of_inverse = rotation_matrix(np.stack([a, b, a @ b, a.T]), order)
    np.testing.assert_allclose(of_a @ of_a.T, np.eye(order * order), atol=1e-12)
    np.testing.assert_allclose(of_a @ of_b, of_both, atol=1e-12)
    np.testing.assert_allclose(of_inverse, of_a.T, atol=1e-12)


def test_bands_do_not_mix_and_the_identity_does_nothing():
    band = sh.bands(5)
    matrix = rotation_matrix(rotations(1)[0], 5)
    assert not matrix[band[:, None] != band].any()
    np.testing.assert_allclose(rotation_matrix(np.eye(3), 5), np.eye(25), atol=1e-13)


def test_agrees_with_e3nn():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from e3nn import o3
    # Its axes are ours permuted (polar axis y), and it has no Condon–Shortley phase.
    axes = np.eye(3)[[1, 2, 0]]
    turns = rotations(5)
    matrix = rotation_matrix(turns, 6)
    for band in range(6):
        part = slice(band * band, (band + 1) ** 2)
        theirs = o3.Irrep(band, 1).D_from_matrix(torch.tensor(axes @ turns @ axes.T)).numpy()
        phase = (-1.0) ** np.arange(-band, band + 1)
        expected = phase[:, None] * theirs * phase
        # Its Euler angles pass through float32.
        np.testing.assert_allclose(matrix[:, part, part], expected, atol=1e-5)


@pytest.mark.parametrize("method", [rotate, rotate_zxzxz])
@pytest.mark.parametrize("order", [1, 2, 3, 4, 6, 9])
def test_rotating_a_vector_is_multiplying_by_its_matrix(method, order):
    turns = rotations(6).reshape(3, 2, 3, 3)
    vectors = np.random.default_rng(order).normal(size=(3, 2, order * order))
    expected = np.einsum("...ij,...j->...i", rotation_matrix(turns, order), vectors)
    np.testing.assert_allclose(method(vectors, turns), expected, atol=1e-12)
    tensor = method(torch.tensor(vectors), torch.tensor(turns))
    np.testing.assert_allclose(tensor.numpy(), expected, atol=1e-12)
    single = method(vectors.astype(np.float32), turns.astype(np.float32))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, expected, atol=1e-4)


@pytest.mark.parametrize("method", [rotate, rotate_zxzxz])
def test_leading_axes_broadcast(method):
    turns = rotations(4)
    colours = np.random.default_rng(0).normal(size=(3, 16))
    value = method(colours, turns[:, None])
    assert value.shape == (4, 3, 16)
    np.testing.assert_allclose(value[2, 1], method(colours[1], turns[2]), atol=1e-13)
    np.testing.assert_allclose(method(colours, turns[0]), value[0], atol=1e-13)


def test_rotation_carries_a_lobe_along():
    # f'(s) = f(R⁻¹ s): a lobe about d becomes one about R d, not R⁻¹ d.
    turn = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    about_x = sh.evaluate(np.array([1.0, 0.0, 0.0]), 4)
    about_y = sh.evaluate(np.array([0.0, 1.0, 0.0]), 4)
    for method in (rotate, rotate_zxzxz):
        np.testing.assert_allclose(method(about_x, turn), about_y, atol=1e-13)


def test_torch_differentiates_rotation():
    vector = torch.linspace(-1.0, 1.0, 16, dtype=torch.float64, requires_grad=True)
    angles = torch.tensor([0.3, -0.8, 1.1], dtype=torch.float64, requires_grad=True)

    def turned(f, w):
        zero = w[0] * 0
        skew = torch.stack([zero, -w[2], w[1], w[2], zero, -w[0], -w[1], w[0], zero])
        turn = torch.linalg.matrix_exp(skew.reshape(3, 3))
        return rotate(f, turn), rotate_zxzxz(f, turn), rotation_matrix(turn, 3)

    assert torch.autograd.gradcheck(turned, (vector, angles))


def test_multiplications_of_the_paper():
    table = {3: 53, 4: 121, 5: 217, 6: 345, 7: 509, 8: 713, 9: 961}
    assert {order: zxzxz_multiplications(order) for order in table} == table
    # The constant is left alone, the linear band is one 3×3 matrix times a vector.
    assert [zxzxz_multiplications(order) for order in (1, 2)] == [0, 9]


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 1.0, -1.0]), "reflection"),
        (-np.eye(3), "reflection"),
        (np.diag([1.0, 1.0, 1.1]), "orthonormal"),
        (np.zeros((3, 3)), "orthonormal"),
        (np.full((3, 3), math.nan), "orthonormal"),
        (np.eye(4), "shape"),
        (np.ones(3), "shape"),
    ],
)
def test_what_is_not_a_rotation_is_refused(matrix, message):
    for wrap in (np.asarray, torch.tensor):
        with pytest.raises(ValueError, match=message):
            rotation_matrix(wrap(matrix), 3)
        with pytest.raises(ValueError, match=message):
            rotate(wrap(np.ones(9)), wrap(matrix))
        with pytest.raises(ValueError, match=message):
            rotate_zxzxz(wrap(np.ones(9)), wrap(matrix))
