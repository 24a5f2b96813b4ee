"""Squares and products of the leading inputs: linear regression on them is a quadratic model.

"Arbitrary BRDFs" section 5.3, "linear models with higher-order feature vectors".
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from prtnet.arrays import IntArray

__all__ = ["Products", "leading_pairs"]


def leading_pairs(inputs: int, leading: int) -> IntArray:
    """Pairs (2, Q) of the first ``leading`` of so many inputs, each with itself and every later."""
    return np.stack(np.triu_indices(min(inputs, leading))).astype(np.int32)


class Products:
    """Inputs with their products behind them, the products at the scale of the inputs.

    Unscaled, a weight on the square of a large input would hardly be held by weight decay. One
    factor a cluster keeps the products' sizes in relation to each other.

    Args:
        inputs: reduced inputs of all training poses, (C, P, K).
        leading: so many of the leading inputs are multiplied with each other.

    Attributes:
        pairs: which inputs are multiplied, (2, Q).
        scale: products are divided by it, (C, 1, 1); their root mean variance.
    """

    def __init__(self, inputs: Tensor, leading: int) -> None:
        self.pairs = leading_pairs(inputs.shape[2], leading)
        variance = self.products(inputs).var(dim=1, unbiased=False).mean(dim=1)
        self.scale = torch.where(variance > 1e-20, variance, 1.0).sqrt()[:, None, None]

    def products(self, inputs: Tensor) -> Tensor:
        """Unscaled products (C, P, Q) of inputs (C, P, K)."""
        first, second = (torch.from_numpy(k).long().to(inputs.device) for k in self.pairs)
        return inputs[..., first] * inputs[..., second]

    def __call__(self, inputs: Tensor) -> Tensor:
        """(C, P, K + Q)."""
        return torch.cat([inputs, self.products(inputs) / self.scale], dim=2)

    def unscaled(self, weight: Tensor) -> Tensor:
        """Weights (C, K + Q, L) of the unscaled products, from those of the scaled ones."""
        plain = weight.shape[1] - self.pairs.shape[1]
        return torch.cat([weight[:, :plain], weight[:, plain:] / self.scale], dim=1)
