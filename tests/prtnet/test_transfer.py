from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import safetensors.numpy

from prtnet.array_file import TRANSFER
from prtnet.errors import PrtnetError
from prtnet.transfer import Patch, Surface, TransferField

RANDOM = np.random.default_rng(3)


def numbers(*shape: int) -> np.ndarray:
    return RANDOM.normal(size=shape).astype(np.float32)


def patch(rows: int = 1, glossy: bool = False) -> TransferField:
    layout = Patch(numbers(2, 3), numbers(2, 3, 3), (0.3, 0.2), (True, False))
    return TransferField(
        numbers(6, rows, 9), layout, numbers(rows, 16, 3) if glossy else None, {"rays": 7}
    )


def mesh() -> TransferField:
    faces = np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32)
    layout = Surface(numbers(4, 3), numbers(4, 3), numbers(4, 3), faces)
    return TransferField(numbers(4, 1, 16), layout)


@pytest.mark.parametrize("field", [patch(), patch(3, glossy=True), mesh()])
def test_round_trip(field: TransferField, tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    field.save(path)
    again = TransferField.load(path)
    np.testing.assert_array_equal(again.transfer, field.transfer)
    assert type(again.layout) is type(field.layout)
    for one in dataclasses.fields(field.layout):
        np.testing.assert_array_equal(
            getattr(again.layout, one.name), getattr(field.layout, one.name)
        )
    assert (again.view is None) == (field.view is None)
    if field.view is not None:
        np.testing.assert_array_equal(again.view, field.view)
    assert again.metadata == field.metadata
    assert json.loads(json.dumps(again.facts())) == field.facts()


def test_vectors_are_of_matte_transfer() -> None:
    field = patch()
    assert field.vectors.shape == (6, 9)
    assert (field.order, field.rows, len(field)) == (3, 1, 6)
    with pytest.raises(ValueError, match="matrices"):
        _ = patch(2, glossy=True).vectors


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"transfer": numbers(6, 9)}, "shape"),
        ({"transfer": numbers(6, 1, 8)}, "square"),
        ({"transfer": numbers(5, 1, 9)}, "layout does not fit"),
        ({"transfer": numbers(6, 2, 9)}, "rows without view"),
        ({"transfer": np.full((6, 1, 9), np.nan, dtype=np.float32)}, "not finite"),
        ({"transfer": np.zeros((6, 1, 9))}, "float64"),
        ({"view": numbers(1, 15, 3)}, "view factors"),
        ({"view": numbers(2, 16, 3)}, "view factors"),
    ],
)
def test_arrays_that_do_not_fit(change: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        dataclasses.replace(patch(), **change)


def test_layouts_that_do_not_fit() -> None:
    good = mesh()
    assert isinstance(good.layout, Surface)
    for change in (
        {"faces": np.array([[0, 1, 4]], dtype=np.int32)},
        {"faces": np.array([[0, 1, -1]], dtype=np.int32)},
        {"normals": numbers(3, 3)},
    ):
        with pytest.raises(ValueError, match=r"fit|not there"):
            dataclasses.replace(good, layout=dataclasses.replace(good.layout, **change))
    flat = patch()
    assert isinstance(flat.layout, Patch)
    for bad in ((0.0, 1.0), (np.inf, 1.0), (np.nan, 1.0)):
        with pytest.raises(ValueError, match="size"):
            dataclasses.replace(flat, layout=dataclasses.replace(flat.layout, size=bad))


def spoiled(path: Path, header: dict[str, Any], drop: str | None = None) -> str:
    """What is said about a file whose header or arrays were changed."""
    patch().save(path)
    with safetensors.safe_open(path, framework="numpy") as file:
        old = json.loads(file.metadata()[TRANSFER])
    arrays = safetensors.numpy.load_file(path)
    arrays.pop(drop or "", None)
    path.write_bytes(safetensors.numpy.save(arrays, {TRANSFER: json.dumps(old | header)}))
    with pytest.raises(PrtnetError) as caught:
        TransferField.load(path)
    assert "\n" not in str(caught.value)
    return caught.value.message


def test_spoiled_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    assert "format version 2" in spoiled(path, {"format_version": 2})
    for header in (
        {"layout": "torus"}, {"layout": ["patch"]}, {"size": [1.0]}, {"size": "ab"}, {"size": None},
        {"tiles": 3}, {"layout": "mesh"}, {"metadata": 4}, {"size": [1.0, -1.0]},
    ):  # fmt: skip
        assert "not a whole prtnet transfer field" in spoiled(path, header), header
    for name in ("transfer", "heights", "normals"):
        assert name in spoiled(path, {}, name)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e13, 3e38])
def test_numbers_that_pictures_cannot_hold(bad: float) -> None:
    for name, good in (("transfer", patch()), ("transfer", mesh()), ("view", patch(3, True))):
        array = getattr(good, name).copy()
        array.flat[-1] = bad
        with pytest.raises(ValueError, match=f"{name} holds values that are not finite, or above"):
            dataclasses.replace(good, **{name: array})
    layout = dataclasses.replace(patch().layout, heights=np.full((2, 3), bad, dtype=np.float32))
    with pytest.raises(ValueError, match="heights holds"):
        dataclasses.replace(patch(), layout=layout)
    for size in ((0.3, bad), (1e-300, 0.2)):
        with pytest.raises(ValueError, match="size is no length"):
            dataclasses.replace(patch(), layout=dataclasses.replace(patch().layout, size=size))
