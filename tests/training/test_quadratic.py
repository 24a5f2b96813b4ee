from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prtnet.model import Regressor
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training.quadratic import Products, leading_pairs
from training.regression import fit_linear
from training.train import train


def normal(*shape, seed=0):
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def test_pairs_are_squares_and_products_of_the_leading_inputs():
    assert leading_pairs(5, 2).T.tolist() == [[0, 0], [0, 1], [1, 1]]
    assert leading_pairs(3, 12).shape == (2, 6)


def test_a_quadratic_function_is_recovered():
    """Also through the unscaled weights, by the regressor that runs it."""
    x = normal(2, 200, 4) * torch.tensor([6.0, 3.0, 1.0, 0.3])
    exact = 0.2 * x[..., :1] ** 2 - 0.5 * x[..., 1:2] * x[..., 2:3] + x[..., 3:] + 2.0
    products = Products(x, 3)
    fitted = fit_linear(products(x), exact, 1e-9)
    assert torch.allclose(fitted(products(x)), exact, atol=1e-4)
    plain = fit_linear(x, exact, 1e-9)
    assert (plain(x) - exact).square().mean() > 1.0
    weight, bias = products.unscaled(fitted.weight).numpy(), fitted.bias.numpy()
    unscaled = Regressor(weight, bias, pairs=products.pairs)(x.numpy().swapaxes(0, 1))
    assert np.allclose(unscaled.swapaxes(0, 1), exact.numpy(), atol=1e-4)


def test_products_have_the_scale_of_inputs_and_keep_their_relation():
    x = normal(3, 500, 4) * torch.tensor([5.0, 2.0, 1.0, 0.1])
    products = Products(x, 4)
    scaled = products(x)[..., 4:]
    assert torch.allclose(scaled.var(dim=1, unbiased=False).mean(dim=1), torch.ones(3).double())
    assert torch.allclose(scaled[0, :, 0] / scaled[0, :, 4], (x[0, :, 0] / x[0, :, 1]) ** 2)
    still = Products(torch.zeros(1, 5, 2, dtype=torch.float64), 2)
    assert torch.isfinite(still(torch.ones(1, 5, 2, dtype=torch.float64))).all()


def test_a_trained_model_multiplies_what_it_was_told_to():
    data = memory_dataset()
    rows = data.training_poses()
    truth = data.read("visibility", rows)
    errors = {}
    for kind in ("linear", "quadratic"):
        config = dataclasses.replace(SMALL, kind=kind, features="joint_angles", leading=3)
        model = train(data, dataclasses.replace(config, alpha=1e-4))
        errors[kind] = ((model(data.read("pose", rows)) - truth) ** 2).sum()
    assert model.regressor.pairs.shape == (2, 6)
    assert errors["quadratic"] < 0.9 * errors["linear"]


@pytest.mark.parametrize("storage", ["float16", "int8"])
def test_weights_of_products_outlive_their_storage(storage):
    """They are small, and what they multiply is large: 8 bits would lose them."""
    data = memory_dataset(per_clip=20)
    config = dataclasses.replace(SMALL, kind="quadratic", features="occluders", alpha=1e-4)
    model = train(data, config)
    poses = data.read("pose", data.training_poses())
    whole, rounded = model(poses), model.stored_as(storage)(poses)
    change = np.linalg.norm(rounded - whole) / np.linalg.norm(whole - whole.mean(axis=0))
    assert change < 0.05
    assert model.stored_as("int8").stored("regressor.weight").values.dtype == np.float16
