"""The Phong operator."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
import torch

from prtnet import sh
from prtnet.errors import PrtnetError
from prtnet.phong import blocks, integrals, phong_matrix, phong_transfer, phong_zonal

EXPONENTS = (0.0, 0.5, 1.0, 2.0, 3.7, 20.0, 1e3, 1e5)


def derivative(band: int, m: int) -> list[Fraction]:
    """The m-th derivative of the Legendre polynomial, by powers of z from the lowest."""
    rows = [[Fraction(1)], [Fraction(0), Fraction(1)]]
    for degree in range(1, band):
        up = [Fraction(0), *(Fraction(2 * degree + 1, degree + 1) * c for c in rows[-1])]
        for power, c in enumerate(rows[-2]):
            up[power] -= Fraction(degree, degree + 1) * c
        rows.append(up)
    row = rows[band]
    for _ in range(m):
        row = [power * c for power, c in enumerate(row)][1:]
    return row


def times(a: list[Fraction], b: list[Fraction]) -> list[Fraction]:
    product = [Fraction(0)] * (len(a) + len(b) - 1)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            product[i + j] += x * y
    return product


def exact_entry(one: int, other: int, m: int, alpha: float) -> float:
    """M^α of two bands and m, in powers of z and fractions: ∫₀¹ z^(α + k) = 1/(α + k + 1)."""
    product = times(derivative(one, m), derivative(other, m))
    for _ in range(m):
        product = times(product, [Fraction(1), Fraction(0), Fraction(-1)])
    integral = sum(c / (Fraction(alpha) + k + 1) for k, c in enumerate(product))
    size = Fraction((2 * one + 1) * (2 * other + 1))
    for band in (one, other):
        size *= Fraction(math.factorial(band - m), math.factorial(band + m))
    return 0.5 * math.sqrt(size) * float(integral)


def exact_matrix(alpha: float, order: int) -> np.ndarray:
    """The whole matrix, entry by entry: slow and obvious."""
    matrix = np.zeros((order**2, order**2))
    for m in range(order):
        for one in range(m, order):
            for other in range(m, order):
                value = exact_entry(one, other, m, alpha)
                for sign in (m, -m):
                    matrix[one * (one + 1) + sign, other * (other + 1) + sign] = value
    return matrix


def sampled_matrix(alpha: float, order: int, rings: int = 200) -> np.ndarray:
    """By quadrature over the hemisphere: Gauss–Legendre in √z, which smooths half powers."""
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    root = (nodes + 1.0) / 2.0
    z, count = root * root, 2 * order
    azimuth = 2.0 * math.pi / count * np.arange(count)
    sine = np.sqrt(1.0 - z * z)[:, None]
    points = np.stack(
        np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), z[:, None]), axis=-1
    )
    basis = sh.evaluate_reference(points.reshape(-1, 3), order)
    weight = np.repeat(weights * root * z**alpha * 2.0 * math.pi / count, count)
    return basis.T @ (weight[:, None] * basis)


def scale_of(matrix: np.ndarray) -> np.ndarray:
    """√(M_ii M_jj), which bounds the entry of i and j."""
    size = np.sqrt(np.diagonal(matrix, axis1=-2, axis2=-1))
    return size[..., :, None] * size[..., None, :]


@pytest.mark.parametrize("alpha", EXPONENTS)
@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_every_entry_is_that_of_exact_fractions(order, alpha):
    expected = exact_matrix(alpha, order)
    for kind, digits in ((np.float64, 1e-14), (np.float32, 5e-7)):
        got = phong_matrix(kind(alpha), order)
        assert got.dtype == kind
        assert (np.abs(got - expected) <= digits * order * scale_of(expected)).all()
        assert np.array_equal(got, got.T)


@pytest.mark.parametrize("alpha", [0.0, 0.5, 1.0, 2.5, 40.0])
@pytest.mark.parametrize("order", [1, 3, 4, 6])
def test_it_is_the_integral_over_the_hemisphere(order, alpha):
    np.testing.assert_allclose(phong_matrix(alpha, order), sampled_matrix(alpha, order), atol=3e-13)


@pytest.mark.parametrize("alpha", EXPONENTS)
def test_it_is_the_product_with_the_lobe(alpha):
    """Σ over the 2n − 1 bands that a product reaches: the operator of any zonal function."""
    order = 4
    reached = 2 * order - 1
    lobe, band = np.zeros(reached**2), np.arange(reached)
    lobe[band * (band + 1)] = phong_zonal(alpha, reached) * np.sqrt((2 * band + 1) / (4 * math.pi))
    expected = sh.product_matrix(lobe, order, order) * 2.0 * math.pi / (alpha + 1.0)
    np.testing.assert_allclose(phong_matrix(alpha, order), expected, atol=1e-14)


@pytest.mark.parametrize("order", [1, 2, 4, 7])
def test_the_matrix_is_sparse_and_its_sums_have_one_sign(order):
    matrix = phong_matrix(3.7, order)
    assert np.count_nonzero(matrix) == sum((2 - (m == 0)) * (order - m) ** 2 for m in range(order))
    distinct = order * (order + 1) * (order + 2) // 6
    assert sum(len(row) for row in integrals(np.float64(2.0), order)) == order**2
    for block in blocks(order):
        band = np.arange(block.m, order)
        for degree, weights in enumerate(block.weights[:, block.place]):
            total, apart = band[:, None] + band, np.abs(band[:, None] - band)
            reached = (degree >= apart) & (degree <= total - 2 * block.m)
            assert np.array_equal(weights > 0, reached & ((degree + total) % 2 == 0))
    assert sum(block.weights.shape[1] for block in blocks(order)) == distinct


def test_as_sparse_as_the_paper_says():
    assert np.count_nonzero(phong_matrix(20.0, 4)) / 256 == pytest.approx(0.171, abs=1e-3)


@pytest.mark.parametrize("order", [1, 3, 4])
def test_transfer_is_the_matrix_and_its_factor(order):
    rng = np.random.default_rng(order)
    alpha, vector = rng.uniform(0, 30, size=(5, 1)), rng.normal(size=(7, order**2))
    got = phong_transfer(alpha, vector)
    factor = (alpha + 1.0) / (2.0 * math.pi)
    expected = factor[..., None] * np.einsum(
        "aij,vj->avi", phong_matrix(alpha[:, 0], order), vector
    )
    np.testing.assert_allclose(got, expected, atol=1e-14)
    assert phong_transfer(2, vector.astype(np.float32)).dtype == np.float32


def test_known_exponents():
    order = 5
    vector = np.random.default_rng(0).normal(size=order**2)
    white = np.zeros(order**2)
    white[0] = math.sqrt(4.0 * math.pi)
    for alpha in EXPONENTS:  # the lobe's integral is 1
        assert white @ phong_transfer(alpha, white) == pytest.approx(1.0, rel=1e-14)
    # α = 0: the mean over the hemisphere.
    upper = white - sh.lower_hemisphere(order)
    np.testing.assert_allclose(phong_transfer(0.0, white), upper / (2 * math.pi), atol=1e-14)
    # α → ∞: what is seen in the mirror.
    up = sh.evaluate(np.array([0.0, 0.0, 1.0]), order)
    np.testing.assert_allclose(phong_transfer(1e12, vector), (up @ vector) * up, atol=1e-9)


@pytest.mark.parametrize("alpha", EXPONENTS)
def test_unshadowed_transfer_is_zonal(alpha):
    order = 6
    white = np.zeros(order**2)
    white[0] = math.sqrt(4.0 * math.pi)
    band = np.arange(order)
    zonal = phong_transfer(alpha, white)[band * (band + 1)]
    expected = phong_zonal(alpha, order) * np.sqrt((2 * band + 1) / (4.0 * math.pi))
    np.testing.assert_allclose(zonal, expected, atol=1e-14)
    np.testing.assert_allclose(phong_zonal(1.0, 5), [1, 2 / 3, 1 / 4, 0, -1 / 24], atol=1e-15)


def test_torch_agrees_and_is_differentiable():
    alpha = torch.tensor([0.0, 0.5, 3.0, 900.0], dtype=torch.float64, requires_grad=True)
    vector = torch.randn(4, 16, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    plain = alpha.detach().numpy()
    np.testing.assert_allclose(phong_matrix(alpha, 4).detach(), phong_matrix(plain, 4), atol=1e-15)
    np.testing.assert_allclose(phong_zonal(alpha, 4).detach(), phong_zonal(plain, 4), atol=1e-15)
    got = phong_transfer(alpha, vector)
    np.testing.assert_allclose(got.detach(), phong_transfer(plain, vector.numpy()), atol=1e-14)
    assert phong_transfer(2.0, vector.float()).dtype == torch.float32
    inner = (alpha.detach() + 0.1).requires_grad_()
    vector.requires_grad_()
    assert torch.autograd.gradcheck(phong_transfer, (inner, vector))
    assert torch.autograd.gradcheck(lambda a: phong_matrix(a, 3), (inner,))


@pytest.mark.parametrize("alpha", [-0.1, math.nan, math.inf, [1.0, -1.0]])
def test_no_exponent_is_refused(alpha):
    for call in (
        lambda: phong_matrix(alpha, 3),
        lambda: phong_zonal(alpha, 3),
        lambda: phong_transfer(alpha, np.zeros((2, 9))),
        lambda: phong_transfer(torch.tensor(alpha), torch.zeros(2, 9)),
    ):
        with pytest.raises(PrtnetError, match="Phong exponent: must be finite, at least 0"):
            call()


# Appendix A of the paper, in its hexadecimal indices, a[x] = α + x.
RIGHT = {
    "00": lambda a: 0.5 / a[1],
    "02": lambda a: math.sqrt(3) / (2 * a[2]),
    "06": lambda a: math.sqrt(5) * a[0] / (2 * a[1] * a[3]),
    "11": lambda a: 1.5 / (a[1] * a[3]),
    "15": lambda a: 3 * math.sqrt(5) / (2 * a[2] * a[4]),
    "1B": lambda a: 3 * math.sqrt(7) * a[0] / (math.sqrt(2) * a[1] * a[3] * a[5]),
    "2C": lambda a: math.sqrt(21) * a[0] / (2 * a[3] * a[5]),
    "44": lambda a: 7.5 / (a[1] * a[3] * a[5]),
    "4A": lambda a: 7.5 * math.sqrt(7) / (a[2] * a[4] * a[6]),
    "5B": lambda a: 3 * math.sqrt(35) * a[1] / (math.sqrt(2) * a[2] * a[4] * a[6]),
    "99": lambda a: 52.5 / (a[1] * a[3] * a[5] * a[7]),
    "22": lambda a: 1.5 / a[3],
    "26": lambda a: math.sqrt(15) * a[1] / (2 * a[2] * a[4]),
    "55": lambda a: 7.5 / (a[3] * a[5]),
    "AA": lambda a: 52.5 / (a[3] * a[5] * a[7]),
    "CC": lambda a: 7 * (a[0] ** 2 + 2 * a[0] + 15) / (2 * a[3] * a[5] * a[7]),
}
MISPRINTED = {
    "0B": lambda a: math.sqrt(7) * a[-1] / (2 * a[2] * a[4]),
    "BB": lambda a: 21 * (2 * a[0] ** 2 + 4 * a[0] + 5) / (2 * a[1] * a[3] * a[4] * a[7]),
    "6C": lambda a: math.sqrt(35) * (a[0] ** 2 + 2 * a[0] + 6) / (2 * a[1] * a[2] * a[6]),
}
MEANT = {
    "0C": MISPRINTED["0B"],
    "BB": lambda a: 21 * (2 * a[0] ** 2 + 4 * a[0] + 5) / (2 * a[1] * a[3] * a[5] * a[7]),
    "6C": lambda a: math.sqrt(35) * (a[0] ** 2 + 2 * a[0] + 6) / (2 * a[2] * a[4] * a[6]),
    "66": lambda a: 5 * (a[0] ** 2 + 2 * a[0] + 3) / (2 * a[1] * a[3] * a[5]),
}


def appendix(formula, alpha: float) -> float:
    return formula({x: alpha + x for x in range(-1, 8)})


def entry(matrix: np.ndarray, name: str) -> float:
    return matrix[int(name[0], 16), int(name[1], 16)]


@pytest.mark.parametrize("alpha", [0.0, 0.5, 2.0, 6.3, 40.0])
def test_the_papers_appendix_against_quadrature(alpha):
    matrix = sampled_matrix(alpha, 4)
    wrong = [
        name for name, formula in {**RIGHT, **MISPRINTED}.items()
        if abs(appendix(formula, alpha) / entry(matrix, name) - 1.0 if entry(matrix, name) > 1e-12
               else appendix(formula, alpha)) > 1e-9
    ]  # fmt: skip
    assert wrong == list(MISPRINTED)
    # With the corrections they are all the distinct entries there are.
    formulas = {**RIGHT, **MEANT}
    assert len(formulas) == 20
    for name, formula in formulas.items():
        assert appendix(formula, alpha) == pytest.approx(entry(matrix, name), abs=1e-12)
