"""The basis against other libraries and its own identities."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import sph_harm_y

from prtnet import sh

ORDERS = [1, 2, 3, 4, 6, 7, 10, 13]
# Rounding grows with the band: values reach √((2l + 1)/4π) through l steps.
TOLERANCE = {"float64": 1e-13, "float32": 1e-5}
EVALUATORS = [sh.evaluate, sh.evaluate_reference]


def directions(count: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def scipy_basis(unit: np.ndarray, order: int) -> np.ndarray:
    polar, azimuth = np.arccos(unit[:, 2]), np.arctan2(unit[:, 1], unit[:, 0])
    columns = []
    for band in range(order):
        for m in range(-band, band + 1):
            value = sph_harm_y(band, abs(m), polar, azimuth)
            part = value.imag if m < 0 else value.real
            columns.append(part * (math.sqrt(2.0) if m else 1.0))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("evaluate", EVALUATORS)
def test_linear_band_follows_the_convention(evaluate):
    unit = directions(20)
    x, y, z = unit.T
    expected = math.sqrt(3.0 / (4.0 * math.pi)) * np.stack([-y, z, -x], axis=-1)
    np.testing.assert_allclose(evaluate(unit, 2)[:, 1:], expected, atol=1e-15)
    np.testing.assert_allclose(evaluate(unit, 2)[:, 0], math.sqrt(0.25 / math.pi), rtol=1e-15)


@pytest.mark.parametrize("evaluate", EVALUATORS)
@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("order", ORDERS)
def test_agrees_with_scipy_in_both_libraries(evaluate, dtype, order):
    unit = directions(50)
    expected = scipy_basis(unit, order)
    for given_directions in (unit.astype(dtype), torch.tensor(unit.astype(dtype))):
        value = evaluate(given_directions, order)
        assert type(value) is type(given_directions)
        assert value.dtype == given_directions.dtype
        np.testing.assert_allclose(np.asarray(value), expected, atol=TOLERANCE[dtype])


def test_agrees_with_e3nn():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from e3nn import o3
    order = 8
    unit = directions(50)
    # Its polar axis is y, and it has no Condon–Shortley phase.
    permuted = torch.tensor(unit[:, [1, 2, 0]])
    theirs = o3.spherical_harmonics(list(range(order)), permuted, False, "integral").numpy()
    m = np.concatenate([np.arange(-band, band + 1) for band in range(order)])
    np.testing.assert_allclose(sh.evaluate(unit, order), theirs * (-1.0) ** m, atol=1e-6)


def test_leading_axes_are_kept():
    unit = directions(24).reshape(2, 3, 4, 3)
    value = sh.evaluate(unit, 3)
    assert value.shape == (2, 3, 4, 9)
    np.testing.assert_array_equal(value[1, 2, 3], sh.evaluate(unit[1, 2, 3], 3))


def test_integers_and_lists_become_floats():
    assert sh.evaluate(np.array([0, 0, 1]), 2).dtype == np.float64
    assert sh.evaluate(torch.tensor([0, 0, 1]), 2).dtype == torch.float32


@pytest.mark.parametrize(
    ("shape", "order", "message"), [((5, 2), 3, "shape"), ((), 3, "shape"), ((5, 3), 0, "order")]
)
def test_bad_arguments_are_refused(shape, order, message):
    for evaluate in (*EVALUATORS, sh.gradient):
        with pytest.raises(ValueError, match=message):
            evaluate(np.zeros(shape), order)


def test_orthonormal():
    order = 10
    unit, weights = sh.quadrature(2 * order - 2)
    basis = sh.evaluate(unit, order)
    np.testing.assert_allclose(basis.T @ (weights[:, None] * basis), np.eye(100), atol=1e-13)


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 10))
def test_addition_theorem_and_parity(seed, order):
    a, b = directions(2, seed)
    at_a, at_b, opposite = sh.evaluate(np.stack([a, b, -a]), order)
    for band in range(order):
        part = slice(band * band, (band + 1) ** 2)
        legendre = np.polynomial.Legendre.basis(band)(a @ b)
        expected = (2 * band + 1) / (4.0 * math.pi) * legendre
        np.testing.assert_allclose(at_a[part] @ at_b[part], expected, atol=1e-12)
        np.testing.assert_allclose(opposite[part], (-1) ** band * at_a[part], atol=1e-13)


@pytest.mark.parametrize("order", [1, 4, 8])
def test_torch_differentiates_evaluation(order):
    unit = torch.tensor(directions(3), requires_grad=True)
    assert torch.autograd.gradcheck(lambda s: sh.evaluate(s, order), (unit,))


@pytest.mark.parametrize("order", [1, 2, 4, 6, 9])
def test_gradient_is_that_of_the_basis_after_normalisation(order):
    vectors = directions(5) * np.array([[0.1], [0.5], [1.0], [2.0], [30.0]])
    tensor = torch.tensor(vectors)

    def normalised(s):
        return sh.evaluate(s / torch.linalg.vector_norm(s, dim=-1, keepdim=True), order)

    jacobian = torch.autograd.functional.jacobian(lambda s: normalised(s).sum(0), tensor)
    expected = jacobian.permute(1, 0, 2).numpy()
    scale = np.linalg.norm(vectors, axis=-1)[:, None, None]
    value = sh.gradient(vectors, order)
    np.testing.assert_allclose(value * scale, expected * scale, atol=1e-12)
    np.testing.assert_allclose(sh.gradient(tensor, order).numpy(), value, rtol=1e-12, atol=1e-13)
    assert sh.gradient(vectors.astype(np.float32), order).dtype == np.float32


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.integers(1, 9))
def test_gradient_has_no_radial_part_and_the_laplacian_norm(seed, order):
    unit = directions(1, seed)
    value = sh.gradient(unit, order)
    np.testing.assert_allclose(value @ unit[0], 0.0, atol=1e-12)
    # Σ_m |∇y_lm|² = l(l + 1)(2l + 1)/4π, from the Laplacian of the addition theorem.
    band = sh.bands(order)
    expected = [b * (b + 1) * (2 * b + 1) / (4.0 * math.pi) for b in range(order)]
    np.testing.assert_allclose(np.bincount(band, (value[0] ** 2).sum(-1)), expected, rtol=1e-12)


def test_quadrature_is_exact_to_its_degree_and_no_further():
    for degree in (0, 1, 4, 9):
        unit, weights = sh.quadrature(degree)
        integral = weights @ sh.evaluate(unit, degree + 3)
        exact = np.zeros((degree + 3) ** 2)
        exact[0] = math.sqrt(4.0 * math.pi)
        np.testing.assert_allclose(
            integral[: (degree + 1) ** 2], exact[: (degree + 1) ** 2], atol=1e-13
        )
        assert np.abs(integral - exact).max() > 1e-3


@pytest.mark.parametrize("order", [1, 4, 9])
def test_projection_recovers_a_band_limited_function(order):
    coefficients = np.random.default_rng(order).normal(size=(order * order, 2))
    found = sh.project_function(lambda s: sh.evaluate(s, order) @ coefficients, order, 2 * order)
    np.testing.assert_allclose(found, coefficients, atol=1e-12)


def test_projection_of_the_clamped_cosine():
    # ∫ max(z, 0) y_l0: √π/2, √(π/3), √(5π)/8 and 0 for l = 0 … 3; a kink, so not to rounding.
    found = sh.project_function(lambda s: np.maximum(s[:, 2], 0.0), 4)
    expected = np.zeros(16)
    expected[[0, 2, 6]] = math.sqrt(math.pi) / 2, math.sqrt(math.pi / 3), math.sqrt(5 * math.pi) / 8
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_projection_of_samples_in_both_libraries_and_across_blocks():
    count = sh.BLOCK + 1000
    unit = sh.fibonacci_sphere(count)
    coefficients = np.random.default_rng(1).normal(size=(9, 2, 3))
    values = np.tensordot(sh.evaluate(unit, 3), coefficients, axes=1)
    weight = 4.0 * math.pi / count
    found = sh.project_samples(values, unit, weight, 3)
    np.testing.assert_allclose(found, coefficients, atol=1e-4)
    many = sh.project_samples(
        torch.tensor(values), torch.tensor(unit), torch.full((count,), weight).double(), 3
    )
    np.testing.assert_allclose(many.numpy(), found, rtol=1e-6)
    with pytest.raises(ValueError, match="values for"):
        sh.project_samples(values[:5], unit, weight, 3)


def test_triple_product_of_functions():
    rng = np.random.default_rng(2)
    f, g = rng.normal(size=9), rng.normal(size=16)
    product = np.einsum("i,j,ijk->k", f, g, sh.triple_product(3, 4, 6))
    unit = directions(40)
    expected = (sh.evaluate(unit, 3) @ f) * (sh.evaluate(unit, 4) @ g)
    np.testing.assert_allclose(sh.evaluate(unit, 6) @ product, expected, atol=1e-13)


def test_triple_product_is_symmetric_and_sparse_by_the_selection_rules():
    order = 5
    gamma = sh.triple_product(order)
    for permuted in (gamma.transpose(1, 0, 2), gamma.transpose(2, 1, 0)):
        np.testing.assert_allclose(gamma, permuted, atol=1e-14)
    np.testing.assert_allclose(gamma[0], np.eye(25) * math.sqrt(0.25 / math.pi), atol=1e-14)
    band = sh.bands(order)
    a, b, c = band[:, None, None], band[None, :, None], band
    forbidden = ((a + b + c) % 2 == 1) | (c > a + b) | (c < abs(a - b))
    assert not gamma[forbidden].any()
    # Gaunt: ∫ y_10² y_20 = 1/√(5π).
    np.testing.assert_allclose(gamma[2, 2, 6], 1.0 / math.sqrt(5.0 * math.pi), rtol=1e-13)
    with pytest.raises(ValueError, match="read-only"):
        gamma[0, 0, 0] = 1.0


def test_product_matrix_multiplies_functions():
    rng = np.random.default_rng(3)
    f, g = rng.normal(size=(5, 9)), rng.normal(size=16)
    matrix = sh.product_matrix(f, 4, 6)
    assert matrix.shape == (5, 36, 16)
    unit = directions(20)
    expected = (sh.evaluate(unit, 3) @ f.T).T * (sh.evaluate(unit, 4) @ g)
    np.testing.assert_allclose((matrix @ g) @ sh.evaluate(unit, 6).T, expected, atol=1e-13)
    square = sh.product_matrix(f.astype(np.float32))
    assert square.dtype == np.float32
    np.testing.assert_allclose(square, square.swapaxes(1, 2), atol=1e-6)
    tensor = sh.product_matrix(torch.tensor(f), 4, 6)
    np.testing.assert_allclose(tensor.numpy(), matrix, atol=1e-14)


def test_window_damps_by_band():
    np.testing.assert_allclose(sh.window(3, 0.5), [1] + 3 * [1 / 3] + 5 * [1 / 19])
    np.testing.assert_array_equal(sh.window(4, 0.0), np.ones(16))


def test_bands_and_order():
    np.testing.assert_array_equal(sh.bands(3), [0, 1, 1, 1, 2, 2, 2, 2, 2])
    assert sh.order_of(np.zeros((7, 16))) == 4
    for count in (0, 15):
        with pytest.raises(ValueError, match="not a square"):
            sh.order_of(np.zeros(count))


@pytest.mark.parametrize("count", [1, 2, 1000])
def test_fibonacci_directions_are_unit_and_balanced(count):
    whole, half = sh.fibonacci_sphere(count), sh.fibonacci_hemisphere(count)
    for points in (whole, half):
        assert points.shape == (count, 3)
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, atol=1e-15)
    assert (half[:, 2] > 0).all()
    np.testing.assert_allclose(whole[:, 2].mean(), 0.0, atol=1e-12)
    np.testing.assert_allclose(half[:, 2].mean(), 0.5, atol=1e-12)
    if count == 1000:
        # The mean of y y^T is I/4π: nearly uniform, not merely in height.
        gram = sh.evaluate(whole, 4).T @ sh.evaluate(whole, 4) * (4.0 * math.pi / count)
        np.testing.assert_allclose(gram, np.eye(16), atol=0.01)
