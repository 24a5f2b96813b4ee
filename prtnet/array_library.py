"""One code for NumPy arrays and torch tensors: both libraries name the same operations alike."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    import torch

    from prtnet.arrays import FloatArray

__all__ = ["Array", "as_floating", "constant_like", "library"]

Array = TypeVar("Array", "FloatArray", "torch.Tensor")


def library(array: Any) -> Any:
    """``torch`` for a tensor, what an object names as its library itself, else ``numpy``.

    Does not import torch: a tensor's owner has.
    """
    torch_module = sys.modules.get("torch")
    if torch_module is not None and isinstance(array, torch_module.Tensor):
        return torch_module
    if not isinstance(array, np.ndarray) and hasattr(array, "__array_namespace__"):
        return array.__array_namespace__()
    return np


def as_floating(array: Any) -> Any:
    """The array itself; lists and integers become float64 NumPy, integer tensors float32."""
    xp = library(array)
    if xp is np:
        array = np.asarray(array)
        return array if np.issubdtype(array.dtype, np.floating) else array.astype(np.float64)
    return array if array.is_floating_point() else array.to(xp.get_default_dtype())


def constant_like(table: FloatArray, example: Any) -> Any:
    """A float64 table in the library, dtype and device of ``example``."""
    if library(example) is np:
        return table.astype(example.dtype, copy=False)
    return example.new_tensor(table)
